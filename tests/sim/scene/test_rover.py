"""The rover's loop: runs through one place, on different paths, that end where they began."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo_sim.scene.config import RigConfig, SceneConfig
from probevo_sim.scene.presets.rover import rover
from probevo_sim.scene.recording import SceneRecording, open_scene

RUNS = (0, 1, 4)
every_run = pytest.mark.parametrize("run", RUNS)


@cache
def opened(run: int) -> SceneRecording:
    return open_scene(SceneConfig(preset="rover", drive=run))


def path(run: int) -> FloatArray:
    """Return camera poses at equally spaced times of a run, [K, 4, 4], m."""
    trajectory = opened(run).renderer.trajectory
    return trajectory.T_world_cam(np.linspace(0.0, trajectory.duration_s, 1000))


@every_run
def test_last_frame_has_the_pose_of_the_first(run: int) -> None:
    truth = opened(run).truth
    assert truth is not None
    np.testing.assert_allclose(truth.T_world_cam[-1], np.eye(4), atol=1e-9)
    np.testing.assert_allclose(path(run)[-1], path(0)[0], atol=1e-9)


@every_run
def test_loop_is_250_m_long(run: int) -> None:
    """The lateral deviation from the planned path changes the length a little."""
    length_m = np.linalg.norm(np.diff(path(run)[:, :3, 3], axis=0), axis=1).sum()
    assert length_m == pytest.approx(250.0, rel=0.01)


@pytest.mark.parametrize("run", RUNS[1:])
def test_another_run_takes_another_path(run: int) -> None:
    assert np.linalg.norm(path(run)[:, :3, 3] - path(0)[:, :3, 3], axis=1).max() > 0.05


def test_place_is_the_same_for_every_run() -> None:
    first = opened(0).renderer.world.solids
    other = opened(4).renderer.world.solids
    np.testing.assert_array_equal(first.T_object_solid, other.T_object_solid)
    np.testing.assert_array_equal(first.albedo, other.albedo)


def test_truth_of_the_loop_is_its_two_ends() -> None:
    truth = open_scene(SceneConfig(preset="rover", distance_m=60.0, truth="loop")).truth
    assert truth is not None
    assert truth.known[[0, -1]].all()
    assert np.isnan(truth.T_world_cam[1:-1]).all()


def test_truth_can_be_withheld() -> None:
    config = SceneConfig(preset="rover", distance_m=60.0, truth="none")
    assert open_scene(config).truth is None


def test_nothing_stands_in_the_way() -> None:
    """Along the loop no surface is nearer ahead than 1 m, so the path leads through no rock."""
    rig = RigConfig(width_px=64, height_px=48, focal_px=60.0)
    recording = open_scene(SceneConfig(preset="rover", seed=2, rig=rig))
    for index in np.linspace(0, len(recording) - 2, 60).astype(int):
        assert recording.pixel_truth(int(index)).depth_m.min() > 1.0


def test_another_seed_is_another_field() -> None:
    config = SceneConfig(preset="rover", distance_m=60.0)
    first = rover(config).world.solids.albedo
    other = rover(config.model_copy(update={"seed": 1})).world.solids.albedo
    assert len(first) != len(other) or not np.array_equal(first, other)
