"""The effect ``traffic``: vehicles in the other lanes and ahead, and people who walk and cross."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

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
"""A function that builds one object in its own frame."""

LANE_M = 3.5
"""Width of a lane of a motorway."""
_CAMERA_HALF_WIDTH_M = 1.5
"""Half the width of the zone around the camera that nothing may enter."""
_CLEAR_AHEAD_M = 6.0
"""Length of that zone before the camera."""
_CLEAR_BEHIND_M = 4.0
"""Length of that zone behind the camera."""
_TIME_STEP_S = 0.1
"""Step in which the drive is checked for that."""
_SIGHT_M = 80.0
"""Movers that are farther ahead than this all through the drive are left out."""
_GOLDEN_FRACTION = 0.6180339887498949
"""Fractional part of the golden ratio."""


@dataclass(frozen=True)
class Stream:
    """Movers one after another in a lane of their own, all at one speed, so that none collide."""

    lateral_m: float
    """Distance of the lane to the left of the centre line."""
    speed_m_s: tuple[float, float]
    """Lowest and highest speed; negative towards the start of the road."""
    gap_m: tuple[float, float]
    """Smallest and largest gap from one to the next."""
    makers: tuple[Maker, ...]
    """What moves there; one named twice is twice as frequent."""


@dataclass(frozen=True)
class Street:
    """Everything that moves in a street when the effect is at full strength."""

    streams: tuple[Stream, ...]
    """The lanes beside the camera's."""
    ahead: tuple[Maker, ...]
    """The convoy ahead of the camera in its own lane, one after another."""
    gap_ahead_m: float
    """Gap from the camera to the first of them, and about that from one to the next."""
    crossers_per_s: float
    """Rate of those who cross the road ahead of the camera."""
    crossers: tuple[Maker, ...]
    """Who crosses; one named twice is twice as frequent."""
    crossing_m_s: tuple[float, float]
    """Lowest and highest speed of crossing."""


@dataclass(frozen=True)
class _Path:
    """The planned path of the camera at J times, common to all drives through a place."""

    t_s: FloatArray
    """[J]."""
    s_m: FloatArray
    """Place along the route, [J]."""
    T_world_body: FloatArray
    """Pose of the vehicle, x forward, y left, on the ground, [J, 4, 4], m."""


@dataclass(frozen=True)
class _Mover:
    """A candidate for a moving object, of a full street."""

    solids: Solids
    s_m: float
    """This and the others but ``rank`` as in ``Movers``."""
    lateral_m: float
    rank: float
    """Strength of the traffic, 0 … 1, above which it is present."""
    speed_m_s: float = 0.0
    lateral_speed_m_s: float = 0.0
    ahead: bool = False


def traffic(
    route: Route, plan: DrivePlan, strength: float, rng: np.random.Generator, *, kind: PresetName
) -> tuple[Solids, Movers]:
    """Return moving vehicles and people around the drive, objects 1 to G as in ``Movers``.

    Everything is drawn for a full street and thinned out to ``strength``, so that stronger traffic
    contains weaker traffic. Objects that would come within 6 m before the camera in its own lane,
    at any time of the drive, are left out.

    Args:
        route: the road.
        plan: the drive; in a street the opposite lane is as far to the left of the centre line as
            the camera's is to the right.
        strength: 0 for nobody, 1 for a full street.
        rng: source of what differs from place to place, the same for all drives.
        kind: the preset, which decides what kind of street it is.
    """
    if strength <= 0.0:
        return Solids.none(), Movers.none()

    # Draw a full street, and thin it out.
    street = _STREETS[kind](plan)
    path = _path(route, plan)
    crowd: list[_Mover] = []
    for stream in street.streams:
        crowd += _stream_movers(stream, route, path, rng=rng)
    crowd += _ahead(street, plan, rng)
    crowd += _crossing(street, path, rng)
    crowd = [mover for mover in crowd if mover.rank < strength]

    # Leave out what would come too near to the camera.
    movers = _as_movers(crowd)
    half_size_m = np.array([_half_size(mover.solids) for mover in crowd]).reshape(-1, 2)
    is_clear = _keeps_clear(movers, half_size_m, route, path=path)
    chosen = [mover for mover, clear in zip(crowd, is_clear, strict=True) if clear]
    solids = [mover.solids.of_object(1 + g) for g, mover in enumerate(chosen)]
    return join([Solids.none(), *solids]), _as_movers(chosen)


def _as_movers(crowd: list[_Mover]) -> Movers:
    """Return the movers as one struct of arrays."""
    return Movers(
        s_m=np.array([mover.s_m for mover in crowd], dtype=np.float64),
        lateral_m=np.array([mover.lateral_m for mover in crowd], dtype=np.float64),
        speed_m_s=np.array([mover.speed_m_s for mover in crowd], dtype=np.float64),
        lateral_speed_m_s=np.array([mover.lateral_speed_m_s for mover in crowd], dtype=np.float64),
        ahead=np.array([mover.ahead for mover in crowd], dtype=np.bool_),
    )


def _town(plan: DrivePlan) -> Street:
    """Return a street in town: an opposite lane, and people on both pavements and across."""
    lane_m = abs(plan.lateral_m)
    people = (furniture.person,)
    cars = (furniture.car, furniture.car, furniture.car, furniture.van, vehicles.bus)

    # On each pavement people walk both ways, a little apart.
    walks = [
        Stream(
            lateral_m=side * (lane_m + across_m),
            speed_m_s=(pace_m_s, pace_m_s + 0.15),
            gap_m=(0.8, 6.0),
            makers=people,
        )
        for side in (-1.0, 1.0)
        for across_m, pace_m_s in ((4.2, 1.3), (5.0, -1.35))
    ]
    oncoming = Stream(lateral_m=lane_m, speed_m_s=(-9.0, -6.0), gap_m=(4.0, 14.0), makers=cars)
    return Street(
        streams=(oncoming, *walks),
        ahead=(furniture.van, furniture.car, vehicles.bus),
        gap_ahead_m=8.5,
        crossers_per_s=2.0,
        crossers=people,
        crossing_m_s=(1.2, 1.6),
    )


def _motorway(plan: DrivePlan) -> Street:
    """Return a motorway: two opposite lanes, and a faster lane beside the camera's."""
    inner_m = abs(plan.lateral_m) - LANE_M
    outer_m = abs(plan.lateral_m)
    heavy = (vehicles.lorry, furniture.car, furniture.van)
    mixed = (furniture.car, *heavy)
    streams = (
        Stream(lateral_m=inner_m, speed_m_s=(-28.0, -24.0), gap_m=(12.0, 40.0), makers=mixed),
        Stream(lateral_m=outer_m, speed_m_s=(-23.0, -20.0), gap_m=(12.0, 30.0), makers=heavy),
        Stream(
            lateral_m=-inner_m,
            speed_m_s=(plan.speed_m_s + 2.0, plan.speed_m_s + 3.0),
            gap_m=(6.0, 16.0),
            makers=mixed,
        ),
    )
    return Street(
        streams=streams,
        ahead=(furniture.van, vehicles.lorry, furniture.car),
        gap_ahead_m=12.0,
        crossers_per_s=0.0,
        crossers=(),
        crossing_m_s=(0.0, 0.0),
    )


def _field(plan: DrivePlan) -> Street:
    """Return a track in a field: people and machines on both sides, and some that cross it."""
    people = (furniture.person,)
    machines = (vehicles.field_rover, furniture.car)
    streams = tuple(
        Stream(
            lateral_m=lateral_m,
            speed_m_s=(pace_m_s, pace_m_s + 0.2),
            gap_m=gap_m,
            makers=makers,
        )
        for lateral_m, pace_m_s, gap_m, makers in (
            (2.2, 1.3, (2.0, 14.0), people),
            (-2.2, -1.3, (2.0, 14.0), people),
            (4.4, -1.2, (5.0, 20.0), machines),
            (-4.4, 1.4, (5.0, 20.0), machines),
        )
    )
    return Street(
        streams=streams,
        ahead=(vehicles.field_rover,),
        gap_ahead_m=6.5,
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
    """Return the planned path: one drive's path, projected onto the planned lane."""
    trajectory = Trajectory.along(route, plan, np.random.default_rng(0))
    t_s = np.arange(0.0, trajectory.duration_s + _TIME_STEP_S, _TIME_STEP_S)
    s_m = route.nearest(trajectory.T_world_cam(t_s)[:, :2, 3])[0]
    if route.closed:
        s_m = np.unwrap(s_m, period=route.length_m)
    return _Path(t_s, s_m, route.place(s_m, plan.lateral_m))


def _stream_movers(
    stream: Stream, route: Route, path: _Path, rng: np.random.Generator
) -> list[_Mover]:
    """Draw the movers of a stream, as many as ever come into sight."""
    # At each time the mover beside the camera started here; in sight are those around and ahead.
    slowest_m_s, fastest_m_s = stream.speed_m_s
    least_gap_m, most_gap_m = stream.gap_m
    speed = rng.uniform(slowest_m_s, fastest_m_s)
    start_m = path.s_m - speed * path.t_s
    s = start_m.min() - 10.0
    end = start_m.max() + _SIGHT_M
    if route.closed:  # the last must not run into the first
        end = min(end, s + route.length_m - most_gap_m - 10.0)
    movers = []
    ranks = _ranks(rng)
    # One after another, each half its length and a gap beyond the end of the one before.
    while s < end:
        solids = stream.makers[rng.integers(len(stream.makers))](rng)
        half_length = _half_size(solids)[0]
        s += rng.uniform(least_gap_m, most_gap_m) + half_length
        lateral_m = stream.lateral_m + rng.uniform(-0.15, 0.15)
        movers.append(_Mover(solids, s, lateral_m, rank=next(ranks), speed_m_s=speed))
        s += half_length
    return movers


def _ahead(street: Street, plan: DrivePlan, rng: np.random.Generator) -> list[_Mover]:
    """Draw a convoy in the camera's lane that slows down, halts and goes on as the camera does."""
    s = street.gap_ahead_m
    movers = []
    for place, maker in enumerate(street.ahead):
        solids = maker(rng)
        half_length = _half_size(solids)[0]
        rank = 0.3 * (1 + place)
        movers.append(_Mover(solids, s + half_length, plan.lateral_m, rank=rank, ahead=True))
        s += 2.0 * half_length + rng.uniform(0.5, 1.0) * street.gap_ahead_m
    return movers


def _crossing(street: Street, path: _Path, rng: np.random.Generator) -> list[_Mover]:
    """Draw those who cross the road ahead of the camera."""
    slowest_m_s, fastest_m_s = street.crossing_m_s
    movers = []
    ranks = _ranks(rng)
    for _ in range(round(street.crossers_per_s * path.t_s[-1])):
        when = int(rng.integers(len(path.t_s)))
        speed = rng.choice([-1.0, 1.0]) * rng.uniform(slowest_m_s, fastest_m_s)
        s = path.s_m[when] + rng.uniform(8.0, 18.0)
        lateral = rng.uniform(-4.0, 4.0)
        solids = street.crossers[rng.integers(len(street.crossers))](rng)
        # It crosses the road at this time, and so was this far to the left at time 0.
        start_lateral_m = lateral - speed * path.t_s[when]
        movers.append(_Mover(solids, s, start_lateral_m, rank=next(ranks), lateral_speed_m_s=speed))
    return movers


def _ranks(rng: np.random.Generator) -> Iterator[float]:
    """Yield ranks that any stretch of the sequence spreads evenly over 0 … 1.

    Such a low-discrepancy sequence makes steps of the golden ratio.
    """
    rank = rng.random()
    while True:
        yield rank
        rank = (rank + _GOLDEN_FRACTION) % 1.0


def _keeps_clear(movers: Movers, half_size_m: FloatArray, route: Route, path: _Path) -> BoolArray:
    """Return whether each mover stays out of the zone around the camera at all times, [G].

    Args:
        movers: G movers.
        half_size_m: half the length and width of each, [G, 2].
        route: the road.
        path: the camera's path.
    """
    clear = np.ones(len(movers), dtype=np.bool_)
    for t_s, s_m, T_body_world in zip(
        path.t_s, path.s_m, se3.inverse(path.T_world_body), strict=True
    ):
        # The rectangle around each mover in the axes of the camera's vehicle.
        T_body_mover = T_body_world @ movers.poses(route, float(t_s), float(s_m))
        center = T_body_mover[:, :2, 3]
        half = (np.abs(T_body_mover[:, :2, :2]) @ half_size_m[..., None])[..., 0]
        beside = np.abs(center[:, 1]) > half[:, 1] + _CAMERA_HALF_WIDTH_M
        ahead = center[:, 0] > half[:, 0] + _CLEAR_AHEAD_M
        behind = center[:, 0] < -half[:, 0] - _CLEAR_BEHIND_M
        clear &= beside | ahead | behind
    return clear


def _half_size(solids: Solids) -> FloatArray:
    """Return half the length and half the width of an object about its origin, [2], m."""
    reach = np.abs(solids.T_object_solid[:, :2, :3]) @ solids.half_size_m[..., None]
    half: FloatArray = (reach[..., 0] + np.abs(solids.T_object_solid[:, :2, 3])).max(axis=0)
    return half
