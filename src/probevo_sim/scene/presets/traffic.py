"""What moves in a street: cars in the other lanes and ahead, people on the pavement and across the
road."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.geometry import se3
from probevo_sim.scene.config import PresetName
from probevo_sim.scene.drive import DrivePlan, Trajectory
from probevo_sim.scene.presets import furniture, vehicles
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import Solids, join
from probevo_sim.scene.world import Movers

Maker = Callable[[np.random.Generator], Solids]

LANE_M = 3.5
"""Width of a lane of a motorway."""
_CAMERA_HALF_WIDTH_M = 1.5
"""Half the width of the lane that nothing may enter just before or behind the camera."""
_CLEAR_AHEAD_M = 6.0
_CLEAR_BEHIND_M = 4.0
_TIME_STEP_S = 0.1
_SIGHT_M = 80.0
"""Movers further ahead than this, all through the drive, are left out."""


@dataclass(frozen=True)
class Stream:
    """Movers one after another in a lane of their own, all at one speed, so that none runs into the
    next."""

    lateral_m: float
    """Of the lane, to the left of the centre line."""
    speed_m_s: tuple[float, float]
    """Least and most; negative towards the start of the road."""
    gap_m: tuple[float, float]
    """Least and most from one to the next."""
    makers: tuple[Maker, ...]
    """What goes there, each as often as it is named."""


@dataclass(frozen=True)
class Street:
    """Everything that moves at full strength."""

    streams: tuple[Stream, ...]
    ahead: tuple[Maker, ...]
    """What goes ahead of the camera in its own lane, one after another."""
    gap_ahead_m: float
    """Least gap to it."""
    crossers_per_s: float
    crossers: tuple[Maker, ...]
    crossing_m_s: tuple[float, float]


@dataclass(frozen=True)
class _Path:
    """The camera's way along the route as planned, without what each drive does differently; J
    times."""

    t_s: FloatArray
    s_m: FloatArray
    T_world_body: FloatArray
    """[J, 4, 4], x forward, y left, on the ground."""


@dataclass(frozen=True)
class _Mover:
    """One of a full street."""

    solids: Solids
    state: tuple[float, float, float, float]
    """(s, lateral, speed, lateral speed) as in ``Movers``."""
    rank: float
    """Strength of the traffic, 0 … 1, from which on it is there."""
    ahead: bool = False
    """As in ``Movers``."""


def traffic(
    route: Route, plan: DrivePlan, strength: float, rng: np.random.Generator, *, kind: PresetName
) -> tuple[Solids, Movers]:
    """Moving cars and people around the drive, objects 1 to G as in ``Movers``.

    Everything is drawn for a full street and thinned out to ``strength``, so a stronger traffic
    contains a weaker one. What would come within 6 m before the camera in its own lane, at any time
    of the drive, is left out.

    Args:
        route: the road.
        plan: the drive; in a street the other lane is as far to the left of the centre line as the
            camera's is right.
        strength: 0 for nobody, 1 for a full street.
        rng: of the place, not of the drive.
        kind: what street it is.
    """
    if strength <= 0.0:
        return Solids.none(), Movers.none()
    street = _STREETS[kind](plan)
    path = _path(route, plan)
    crowd = [
        mover for stream in street.streams for mover in _in_stream(stream, route, path, rng=rng)
    ]
    crowd += _ahead(street, plan, rng) + _crossing(street, path, rng)
    crowd = [mover for mover in crowd if mover.rank < strength]
    s_m, lateral_m, speed, lateral_speed = (
        np.array([mover.state for mover in crowd]).reshape(-1, 4).T
    )
    movers = Movers(
        s_m,
        lateral_m,
        speed,
        lateral_speed_m_s=lateral_speed,
        ahead=np.array([mover.ahead for mover in crowd], dtype=np.bool_),
    )
    half_size_m = np.array([_half_size(mover.solids) for mover in crowd]).reshape(-1, 2)
    chosen = np.flatnonzero(_keeps_clear(movers, half_size_m, route, path=path))
    solids = [crowd[index].solids.of_object(1 + g) for g, index in enumerate(chosen)]
    return join([Solids.none(), *solids]), Movers(
        *(getattr(movers, f.name)[chosen] for f in fields(Movers))
    )


def _town(plan: DrivePlan) -> Street:
    lane_m = abs(plan.lateral_m)
    people = (furniture.person,)
    cars = (*3 * (furniture.car,), furniture.van, vehicles.bus)
    walks = [
        Stream(side * (lane_m + across), (pace, pace + 0.15), (0.8, 6.0), makers=people)
        for side in (-1.0, 1.0)
        for across, pace in ((4.2, 1.3), (5.0, -1.35))
    ]
    oncoming = Stream(lane_m, (-9.0, -6.0), (4.0, 14.0), makers=cars)
    return Street(
        (oncoming, *walks),
        (furniture.van, furniture.car, vehicles.bus),
        8.5,
        crossers_per_s=2.0,
        crossers=people,
        crossing_m_s=(1.2, 1.6),
    )


def _motorway(plan: DrivePlan) -> Street:
    inner_m = abs(plan.lateral_m) - LANE_M
    outer_m = abs(plan.lateral_m)
    heavy = (vehicles.lorry, furniture.car, furniture.van)
    mixed = (furniture.car, *heavy)
    streams = (
        Stream(inner_m, (-28.0, -24.0), (12.0, 40.0), makers=mixed),
        Stream(outer_m, (-23.0, -20.0), (12.0, 30.0), makers=heavy),
        Stream(-inner_m, (plan.speed_m_s + 2.0, plan.speed_m_s + 3.0), (6.0, 16.0), makers=mixed),
    )
    return Street(
        streams,
        (furniture.van, vehicles.lorry, furniture.car),
        12.0,
        crossers_per_s=0.0,
        crossers=(),
        crossing_m_s=(0.0, 0.0),
    )


def _field(plan: DrivePlan) -> Street:
    people = (furniture.person,)
    machines = (vehicles.field_rover, furniture.car)
    streams = tuple(
        Stream(lateral, (pace, pace + 0.2), gap, makers=makers)
        for lateral, pace, gap, makers in (
            (2.2, 1.3, (2.0, 14.0), people),
            (-2.2, -1.3, (2.0, 14.0), people),
            (4.4, -1.2, (5.0, 20.0), machines),
            (-4.4, 1.4, (5.0, 20.0), machines),
        )
    )
    return Street(
        streams,
        (vehicles.field_rover,),
        6.5,
        crossers_per_s=0.8,
        crossers=(furniture.person, vehicles.field_rover),
        crossing_m_s=(1.0, 1.6),
    )


_STREETS: dict[PresetName, Callable[[DrivePlan], Street]] = {
    "city": _town,
    "residential": _town,
    "road": _motorway,
    "rover": _field,
}


def _path(route: Route, plan: DrivePlan) -> _Path:
    trajectory = Trajectory.along(route, plan, np.random.default_rng(0))
    t_s = np.arange(0.0, trajectory.duration_s + _TIME_STEP_S, _TIME_STEP_S)
    s_m = route.nearest(trajectory.T_world_cam(t_s)[:, :2, 3])[0]
    if route.closed:
        s_m = np.unwrap(s_m, period=route.length_m)
    return _Path(t_s, s_m, route.place(s_m, plan.lateral_m))


def _in_stream(stream: Stream, route: Route, path: _Path, rng: np.random.Generator) -> list[_Mover]:
    """As many as ever come into sight."""
    speed = rng.uniform(*stream.speed_m_s)
    at_start_m = (
        path.s_m - speed * path.t_s
    )  # where one starts that is beside the camera at each time
    s = at_start_m.min() - 10.0
    end = at_start_m.max() + _SIGHT_M
    if route.closed:
        end = min(end, s + route.length_m - stream.gap_m[1] - 10.0)
    movers = []
    ranks = _ranks(rng)
    while s < end:
        solids = stream.makers[rng.integers(len(stream.makers))](rng)
        half_length = _half_size(solids)[0]
        s += rng.uniform(*stream.gap_m) + half_length
        movers.append(
            _Mover(
                solids, (s, stream.lateral_m + rng.uniform(-0.15, 0.15), speed, 0.0), next(ranks)
            )
        )
        s += half_length
    return movers


def _ahead(street: Street, plan: DrivePlan, rng: np.random.Generator) -> list[_Mover]:
    """A convoy in the own lane that slows down, halts and goes on as the camera does."""
    s = street.gap_ahead_m
    movers = []
    for place, maker in enumerate(street.ahead):
        solids = maker(rng)
        half_length = _half_size(solids)[0]
        movers.append(
            _Mover(
                solids, (s + half_length, plan.lateral_m, 0.0, 0.0), 0.3 * (1 + place), ahead=True
            )
        )
        s += 2.0 * half_length + rng.uniform(0.5, 1.0) * street.gap_ahead_m
    return movers


def _crossing(street: Street, path: _Path, rng: np.random.Generator) -> list[_Mover]:
    """Those who cross the road some way before the camera."""
    movers = []
    ranks = _ranks(rng)
    for _ in range(round(street.crossers_per_s * path.t_s[-1])):
        when = int(rng.integers(len(path.t_s)))
        speed = rng.choice([-1.0, 1.0]) * rng.uniform(*street.crossing_m_s)
        s = path.s_m[when] + rng.uniform(8.0, 18.0)
        lateral = rng.uniform(-4.0, 4.0)
        solids = street.crossers[rng.integers(len(street.crossers))](rng)
        movers.append(
            _Mover(solids, (s, lateral - speed * path.t_s[when], 0.0, speed), next(ranks))
        )
    return movers


def _ranks(rng: np.random.Generator) -> Iterator[float]:
    """Ranks evenly spread over 0 … 1 in each stretch of the sequence: the golden ratio's steps."""
    rank = rng.random()
    while True:
        yield rank
        rank = (rank + 0.6180339887498949) % 1.0


def _keeps_clear(movers: Movers, half_size_m: FloatArray, route: Route, path: _Path) -> BoolArray:
    """Whether each mover, half its size [G, 2], stays out of the lane just around the camera at all
    times, [G]."""
    clear = np.ones(len(movers), dtype=np.bool_)
    for t_s, s_m, T_body_world in zip(
        path.t_s, path.s_m, se3.inverse(path.T_world_body), strict=True
    ):
        T_body_mover = T_body_world @ movers.poses(route, float(t_s), float(s_m))
        center = T_body_mover[:, :2, 3]
        half = (np.abs(T_body_mover[:, :2, :2]) @ half_size_m[..., None])[..., 0]
        beside = np.abs(center[:, 1]) > half[:, 1] + _CAMERA_HALF_WIDTH_M
        clear &= (
            beside
            | (center[:, 0] > half[:, 0] + _CLEAR_AHEAD_M)
            | (center[:, 0] < -half[:, 0] - _CLEAR_BEHIND_M)
        )
    return clear


def _half_size(solids: Solids) -> FloatArray:
    """Half the length and half the width of an object, [2], m, about its origin."""
    reach = np.abs(solids.T_object_solid[:, :2, :3]) @ solids.half_size_m[..., None]
    half: FloatArray = (reach[..., 0] + np.abs(solids.T_object_solid[:, :2, 3])).max(axis=0)
    return half
