"""The presets: a free road, determined by the seed, with their effects, and well exposed."""

from dataclasses import fields
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.spatial import KDTree

from probevo.camera.stereo import StereoCamera
from probevo_sim.scene.config import Daylight, Effects, PresetName, SceneConfig
from probevo_sim.scene.drive import Trajectory
from probevo_sim.scene.presets import PRESETS
from probevo_sim.scene.presets.foliage import foliage
from probevo_sim.scene.presets.place import Place, clear_of_road, stations
from probevo_sim.scene.recording import open_scene
from probevo_sim.scene.renderer import Renderer
from probevo_sim.scene.route import Route
from probevo_sim.scene.sensor import expose
from probevo_sim.scene.solids import BOX, Solids, join, solid
from probevo_sim.scene.textures import Texture

every_preset = pytest.mark.parametrize("preset", list(PRESETS))
SMALL = StereoCamera(90.0, 90.0, 77.5, cv_px=23.0, baseline_m=0.54, size_px=(156, 47))


def place(
    preset: PresetName,
    seed: int = 0,
    drive: int = 0,
    distance_m: float | None = None,
    **effects: float,
) -> Place:
    config = SceneConfig(
        preset=preset, seed=seed, drive=drive, distance_m=distance_m, effects=Effects(**effects)
    )
    return built(config.model_dump_json())


SHORT_M = 30.0
"""Length of places whose length does not matter."""


@cache
def built(config: str) -> Place:
    return rebuilt(SceneConfig.model_validate_json(config))


def rebuilt(config: SceneConfig) -> Place:
    """Build a place anew, where ``place`` would return the one that it has built before."""
    return PRESETS[config.preset](config)


def solids_equal(one: Solids, other: Solids) -> bool:
    return all(np.array_equal(getattr(one, f.name), getattr(other, f.name)) for f in fields(Solids))


def driven(preset: PresetName, distance_m: float | None = None, **effects: float) -> Trajectory:
    here = place(preset, distance_m=distance_m, **effects)
    return Trajectory.along(here.world.ground.route, here.plan, np.random.default_rng(0))


def intrusions(solids: Solids, path_m: np.ndarray, above_m: float = 0.02) -> np.ndarray:
    """Return the solids that reach within 1.2 m of a path, from ``above_m`` to 2.5 m high.

    Their surfaces are sampled at points about 0.4 m apart.
    """
    path = KDTree(path_m)
    radius_m = np.linalg.norm(solids.half_size_m, axis=1)
    near = path.query(solids.T_object_solid[:, :2, 3])[0] < 1.2 + radius_m
    hits = []
    for k in np.flatnonzero(near):
        T = solids.T_object_solid[k]
        half = np.minimum(solids.half_size_m[k], 30.0)
        sides = [np.linspace(-1.0, 1.0, 5 + int(5.0 * h)) for h in half]
        points = np.stack(np.meshgrid(*sides, indexing="ij"), axis=-1).reshape(-1, 3)
        points = points[np.abs(points).max(axis=1) == 1.0]
        if solids.shape[k] != BOX:
            points /= np.linalg.norm(points, axis=1)[:, None]
        world = points * solids.half_size_m[k] @ T[:3, :3].T + T[:3, 3]
        low = world[(world[:, 2] > above_m) & (world[:, 2] < 2.5)]
        if len(low) and path.query(low[:, :2])[0].min() < 1.2:
            hits.append(k)
    return np.array(hits, dtype=int)


@every_preset
def test_nothing_stands_on_the_driven_road(preset: PresetName) -> None:
    """Nor do hedges, which foliage adds to all else."""
    trajectory = driven(preset, foliage=1.0)
    path_m = trajectory.T_world_cam(np.arange(0.0, trajectory.duration_s, 0.1))[:, :2, 3]
    clearance_m = 0.1 if preset == "rover" else 0.02  # a rover drives over pebbles
    assert intrusions(place(preset, foliage=1.0).world.solids, path_m, clearance_m).size == 0


def test_an_obstacle_on_the_road_would_be_found() -> None:
    """The check above finds what it looks for."""
    obstacle = solid(BOX, (0.4, 0.4, 1.0), (5.0, 1.0, 0.5), texture=Texture.PLAIN, tile_m=1.0)
    path_m = np.column_stack([np.arange(0.0, 10.0, 0.5), np.zeros(20)])
    assert intrusions(obstacle, path_m).tolist() == [0]


@every_preset
def test_the_same_seed_gives_the_same_place(preset: PresetName) -> None:
    again = rebuilt(SceneConfig(preset=preset, distance_m=SHORT_M))
    assert solids_equal(again.world.solids, place(preset, distance_m=SHORT_M).world.solids)


@every_preset
def test_another_seed_gives_another_place(preset: PresetName) -> None:
    assert not solids_equal(
        place(preset, distance_m=SHORT_M).world.solids,
        place(preset, seed=1, distance_m=SHORT_M).world.solids,
    )


@every_preset
def test_another_drive_is_through_the_same_place(preset: PresetName) -> None:
    busy = place(preset, traffic=1.0, distance_m=SHORT_M).world.solids
    assert solids_equal(busy, place(preset, drive=3, traffic=1.0, distance_m=SHORT_M).world.solids)


@every_preset
def test_a_textureless_road_has_no_contrast(preset: PresetName) -> None:
    before, after = (
        place(preset, distance_m=SHORT_M, textureless=strength).world for strength in (0.0, 1.0)
    )
    road = int(np.flatnonzero(after.ground.contrast != before.ground.contrast)[0])
    assert after.ground.contrast[road] == 0.0


@pytest.mark.parametrize("preset", ["city", "residential", "road"])
def test_a_textureless_road_has_no_marks(preset: PresetName) -> None:
    before, after = (
        place(preset, distance_m=SHORT_M, textureless=strength).world for strength in (0.0, 1.0)
    )
    assert len(after.solids) < len(before.solids)


@pytest.mark.parametrize("preset", ["city", "residential", "road"])
def test_a_half_textureless_road_has_half_the_contrast(preset: PresetName) -> None:
    places = (place(preset, distance_m=SHORT_M, textureless=strength) for strength in (0.0, 0.5))
    before, after = (each.world.ground.contrast for each in places)
    np.testing.assert_allclose(after[after != before], 0.5 * before[after != before])


@every_preset
def test_foliage_adds_leaves_that_repeat(preset: PresetName) -> None:
    before = place(preset, distance_m=60.0).world.solids
    after = place(preset, distance_m=60.0, foliage=1.0).world.solids
    assert not np.any(before.texture == Texture.HEDGE_REPEATED)
    assert np.sum(after.texture[:, 1] == Texture.HEDGE_REPEATED) > 50


def test_the_strength_of_foliage_is_the_share_of_the_road_with_hedges() -> None:
    route = Route.from_turns([(1000.0, 0.0)])
    hedges = {}
    for strength in (0.5, 1.0):
        plants = foliage(route, strength, 6.0, rng=np.random.default_rng(0))
        hedges[strength] = sum(len(plant) == 1 for plant in plants)
    assert hedges[0.5] / hedges[1.0] == pytest.approx(0.5, abs=0.05)


@every_preset
def test_traffic_moves_and_leaves_the_rest_as_it_is(preset: PresetName) -> None:
    without, busy = (
        place(preset, distance_m=SHORT_M, traffic=strength).world for strength in (0.0, 1.0)
    )
    at_rest = np.flatnonzero(busy.solids.object_index == 0)
    np.testing.assert_array_equal(
        busy.solids.T_object_solid[at_rest], without.solids.T_object_solid
    )
    assert len(busy.movers) > 0


@every_preset
def test_shadows_add_the_own_vehicle_unseen(preset: PresetName) -> None:
    world = place(preset, traffic=0.5, shadows=1.0, distance_m=SHORT_M).world
    unseen = ~world.solids.seen
    assert unseen.any()
    assert np.all(world.solids.object_index[unseen] == world.own_vehicle)


@every_preset
def test_the_distance_can_be_set(preset: PresetName) -> None:
    here = PRESETS[preset](SceneConfig(preset=preset, distance_m=150.0))
    trajectory = Trajectory.along(here.world.ground.route, here.plan, np.random.default_rng(0))
    path_m = trajectory.T_world_cam(np.arange(0.0, trajectory.duration_s, 0.05))[:, :2, 3]
    assert np.linalg.norm(np.diff(path_m, axis=0), axis=1).sum() == pytest.approx(150.0, rel=0.05)


@pytest.mark.parametrize("preset", ["city", "residential"])
def test_the_road_of_a_long_drive_reaches_far_enough(preset: PresetName) -> None:
    here = PRESETS[preset](SceneConfig(preset=preset, distance_m=500.0))
    assert here.world.ground.route.length_m >= 500.0


@every_preset
def test_the_sun_stands_behind_the_camera_and_high(preset: PresetName) -> None:
    here = place(preset, distance_m=SHORT_M)
    assert np.linalg.norm(here.world.to_sun) == pytest.approx(1.0)
    assert here.world.to_sun[2] > 0.4


@every_preset
@pytest.mark.parametrize("shadows", [0.0, 1.0])
def test_a_picture_is_well_exposed(preset: PresetName, shadows: float) -> None:
    trajectory = driven(preset, SHORT_M, shadows=shadows)
    world = place(preset, distance_m=SHORT_M, shadows=shadows).world
    renderer = Renderer(world, trajectory, SMALL, effects=Effects(shadows=shadows))
    left, _ = renderer.pair(0.6 * trajectory.duration_s)
    assert 60.0 < expose(left, 1.0, 0.0, rng=np.random.default_rng(0)).mean() < 170.0


def test_an_object_that_reaches_into_the_road_is_removed_whole() -> None:
    route = Route.from_turns([(50.0, 0.0)])
    wall = solid(BOX, (4.0, 1.0, 2.0), (20.0, 6.0, 1.0), texture=Texture.PLAIN, tile_m=1.0)
    beam = solid(BOX, (1.0, 8.0, 1.0), (20.0, 4.0, 1.0), texture=Texture.PLAIN, tile_m=1.0)
    assert len(clear_of_road([wall, join([wall, beam])], route, 3.0)) == 1


@pytest.mark.parametrize(("height_m", "stays"), [(3.0, 0), (5.0, 1)])
def test_what_hangs_above_the_road_may_stay(height_m: float, stays: int) -> None:
    branch = solid(
        BOX, (1.0, 1.0, 1.0), (20.0, 0.0, height_m + 0.5), texture=Texture.PLAIN, tile_m=1.0
    )
    assert len(clear_of_road([branch], Route.from_turns([(50.0, 0.0)]), 3.0)) == stays


def test_stations_are_evenly_spaced_beside_the_road() -> None:
    """On the outer side of a bend of 90°, 20 m from the centre line."""
    route = Route.from_turns([(30.0, 0.0), (60.0, -0.5 * np.pi), (30.0, 0.0)])
    s = stations(route, 20.0, 0.0, end_m=120.0, spacing_m=5.0)
    apart_m = np.linalg.norm(np.diff(route.place(s, 20.0)[:, :2, 3], axis=0), axis=1)
    np.testing.assert_allclose(apart_m, 5.0, atol=0.6)


@pytest.mark.parametrize("azimuth_deg", [0.0, -120.0])
def test_the_sun_stands_where_it_is_asked_for(azimuth_deg: float) -> None:
    """Clockwise from the start of the drive; the camera sees it there, but for its own noise."""
    daylight = Daylight(azimuth_deg=azimuth_deg, elevation_deg=30.0)
    scene = open_scene(SceneConfig(distance_m=SHORT_M, daylight=daylight))
    x, y, z = scene.to_sun
    assert np.degrees(np.arcsin(-y)) == pytest.approx(30.0, abs=3.0)
    off_deg = np.degrees(np.arctan2(x, z)) - azimuth_deg
    assert (off_deg + 180.0) % 360.0 - 180.0 == pytest.approx(0.0, abs=3.0)
    assert np.linalg.norm(scene.to_sun) == pytest.approx(1.0)


def test_without_an_azimuth_the_sun_is_behind_the_camera() -> None:
    assert open_scene(SceneConfig(distance_m=SHORT_M)).to_sun[2] < -0.3


def test_glow_makes_the_sky_brighter_towards_the_sun_and_nothing_else() -> None:
    config = SceneConfig(distance_m=SHORT_M, daylight=Daylight(azimuth_deg=0.0, elevation_deg=20.0))
    trajectory = driven("city", SHORT_M)
    daylight = Daylight(azimuth_deg=0.0, elevation_deg=20.0, glow=1.0)
    glowing = config.model_copy(update={"daylight": daylight})
    without, with_glow = (
        Renderer(rebuilt(each).world, trajectory, SMALL, Effects()) for each in (config, glowing)
    )
    depth = without.pixel_truth(1.0, 1.1).depth_m
    more = with_glow.pair(1.0)[0] - without.pair(1.0)[0]
    sky = np.isinf(depth)
    assert 0.01 < sky.mean() < 0.9
    assert (more[sky] >= 0.0).all()
    assert more[sky].max() > 0.3
    near_sky = cv2.dilate(sky.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    assert np.abs(more[~near_sky]).max() == 0.0
