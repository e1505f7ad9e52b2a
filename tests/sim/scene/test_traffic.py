"""Traffic: a free lane around the camera, objects that agree with movers, and nested strengths."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache
from itertools import product

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo_sim.scene.config import Effects, PresetName
from probevo_sim.scene.drive import DrivePlan, Trajectory
from probevo_sim.scene.presets.traffic import traffic
from probevo_sim.scene.presets.vehicles import own_vehicle
from probevo_sim.scene.renderer import Renderer
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import Solids
from probevo_sim.scene.textures import Texture
from probevo_sim.scene.world import Ground, Movers, World

STREET = Route.from_turns(
    [(50.0, 0.0), (26.0, -1.5), (40.0, 0.0), (30.0, 1.2), (40.0, 0.0)], lead_m=80.0
)
MOTORWAY = Route.from_turns([(60.0, 0.0), (100.0, 0.2), (100.0, -0.2)], lead_m=200.0)
LOOP = Route.loop(120.0)
DRIVES: dict[PresetName, tuple[Route, DrivePlan]] = {
    "city": (STREET, DrivePlan(0.0, 140.0, 8.0, lateral_m=-1.6, stops_m=(40.0,))),
    "residential": (STREET, DrivePlan(0.0, 140.0, 8.0, lateral_m=-1.5, stops_m=(80.0,))),
    "road": (MOTORWAY, DrivePlan(0.0, 200.0, 21.0, lateral_m=-6.65)),
    "rover": (
        LOOP,
        DrivePlan(0.0, 120.0, 2.0, height_m=0.9, pitch_down_rad=0.14, from_rest=True, to_rest=True),
    ),
}
HALF_WIDTH_M = 1.2
AHEAD_M = 5.0
BEHIND_M = 3.0
CORNERS = np.array(list(product((-1.0, 1.0), repeat=3)))

every_kind = pytest.mark.parametrize("kind", list(DRIVES))


@cache
def busy(kind: PresetName, strength: float = 1.0, seed: int = 0) -> tuple[Solids, Movers]:
    route, plan = DRIVES[kind]
    return traffic(route, plan, strength, rng=np.random.default_rng(seed), kind=kind)


def states(movers: Movers) -> FloatArray:
    """Return all fields of the movers, [G, 5]."""
    return np.stack([getattr(movers, f.name) for f in fields(Movers)], axis=1)


@every_kind
def test_objects_are_those_of_the_movers(kind: PresetName) -> None:
    solids, movers = busy(kind)
    np.testing.assert_array_equal(np.unique(solids.object_index), 1 + np.arange(len(movers)))


@every_kind
@pytest.mark.parametrize("seed", [0, 1])
def test_nothing_enters_the_lane_around_the_camera(kind: PresetName, seed: int) -> None:
    """No solid reaches within 1.2 m to the side while it is within 5 m ahead or 3 m behind.

    This holds for every drive through the place.
    """
    route, plan = DRIVES[kind]
    solids, movers = busy(kind, seed=seed)
    corners = np.einsum(
        "nij,nkj->nki", solids.T_object_solid[:, :2, :3], CORNERS * solids.half_size_m[:, None]
    )
    corners = np.dstack(
        [
            corners + solids.T_object_solid[:, None, :2, 3],
            np.zeros((len(solids), 8)),
            np.ones((len(solids), 8)),
        ]
    )
    trajectory = Trajectory.along(route, plan, np.random.default_rng([seed, 7]))
    for t_s in np.arange(0.0, trajectory.duration_s, 0.23):
        T_world_cam = trajectory.T_world_cam(t_s)
        forward = T_world_cam[:2, 2] / np.linalg.norm(T_world_cam[:2, 2])
        camera_s_m, _ = route.nearest(T_world_cam[:2, 3])
        T_world_object = movers.poses(route, t_s, camera_s_m)[solids.object_index - 1]
        away = np.einsum("nij,nkj->nki", T_world_object, corners)[..., :2] - T_world_cam[:2, 3]
        ahead = away @ forward
        left = away @ [-forward[1], forward[0]]
        in_lane = (left.min(axis=1) < HALF_WIDTH_M) & (left.max(axis=1) > -HALF_WIDTH_M)
        is_near = (ahead.min(axis=1) < AHEAD_M) & (ahead.max(axis=1) > -BEHIND_M)
        assert not np.any(in_lane & is_near), t_s


@every_kind
def test_stronger_traffic_contains_the_weaker(kind: PresetName) -> None:
    weak = states(busy(kind, 0.5)[1])
    strong = states(busy(kind)[1])
    assert 0.3 * len(strong) < len(weak) < 0.7 * len(strong)
    assert np.isin(weak, strong).all()


@pytest.mark.parametrize("kind", ["city", "road", "rover"])
def test_moving_share_of_the_image_grows_with_the_strength(kind: PresetName) -> None:
    """On an empty, straight road: mean of 10 times in two streets; at full strength a tenth to a
    half of the image."""
    shares = np.mean(
        [[moving_share(kind, strength, seed) for strength in (0.25, 0.5, 1.0)] for seed in (0, 1)],
        axis=0,
    )
    assert 0.0 < shares[0] < shares[1] < shares[2]
    assert 0.1 < shares[2] < 0.5


def moving_share(kind: PresetName, strength: float, seed: int) -> float:
    route = Route.from_turns([(60.0, 0.0)], lead_m=20.0)
    plan = replace(DRIVES[kind][1], distance_m=60.0)
    solids, movers = traffic(route, plan, strength, rng=np.random.default_rng(seed), kind=kind)
    ground = Ground(
        route,
        edge_m=np.array([np.inf]),
        texture=np.array([int(Texture.ASPHALT)]),
        tile_m=np.array([4.0]),
        albedo=np.array([0.3]),
        contrast=np.array([0.5]),
    )
    world = World(solids, movers, ground, to_sun=np.array([0.6, 0.0, 0.8]))
    camera = StereoCamera(60.0, 60.0, 51.0, cv_px=15.5, baseline_m=0.5, size_px=(103, 32))
    trajectory = Trajectory.along(route, plan, np.random.default_rng(0))
    renderer = Renderer(world, trajectory, camera, effects=Effects())
    times_s = np.linspace(0.0, trajectory.duration_s - 0.1, 10)
    return float(np.mean([renderer.pixel_truth(t, t + 0.1).moving.mean() for t in times_s]))


@every_kind
def test_same_seed_gives_the_same_traffic(kind: PresetName) -> None:
    route, plan = DRIVES[kind]
    again = traffic(route, plan, 1.0, rng=np.random.default_rng(0), kind=kind)
    np.testing.assert_array_equal(states(again[1]), states(busy(kind)[1]))
    for f in fields(Solids):
        np.testing.assert_array_equal(getattr(again[0], f.name), getattr(busy(kind)[0], f.name))


def test_other_seed_gives_other_traffic() -> None:
    assert not np.isin(states(busy("city", seed=1)[1]), states(busy("city")[1])).all()


def test_those_in_one_lane_keep_apart() -> None:
    """Oncoming cars have one speed, and no two of them overlap."""
    solids, movers = busy("city")
    oncoming = np.flatnonzero(
        np.isclose(movers.lateral_m, 1.6, atol=0.2) & (movers.speed_m_s < 0.0)
    )
    assert len(oncoming) > 5
    assert np.ptp(movers.speed_m_s[oncoming]) == 0.0
    reach_m = np.abs(solids.T_object_solid[:, 0, :3] * solids.half_size_m).sum(axis=1)
    ends_m = []
    for g in np.array(oncoming)[np.argsort(movers.s_m[oncoming])]:
        own = solids.object_index == g + 1
        x_m = solids.T_object_solid[:, 0, 3]
        # They face against the road: the front lies at the lower s.
        ends_m += [
            movers.s_m[g] - (x_m + reach_m)[own].max(),
            movers.s_m[g] - (x_m - reach_m)[own].min(),
        ]
    assert np.all(np.diff(ends_m) > 0.0)


def test_no_strength_is_no_traffic() -> None:
    solids, movers = busy("city", 0.0)
    assert len(solids) == len(movers) == 0


def test_own_vehicle_is_not_seen() -> None:
    vehicle = own_vehicle()
    assert not vehicle.seen.any()
    assert len(vehicle) > 1
