"""A rolling shutter that nobody has told of is found in the images, and what it moves corrected."""

from dataclasses import replace

import numpy as np
import pytest

import probevo as pv
from probevo.camera.image_errors import ImageErrors
from probevo.camera.rolling_shutter import ReadoutTime
from probevo.geometry import se3
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig
from probevo_sim.scene.recording import SceneRecording, open_scene
from probevo_sim.scene.renderer import FULL_READOUT_S

RIG = RigConfig(width_px=400, height_px=160, focal_px=230.0, baseline_m=0.54)
READOUT_S = 0.8 * FULL_READOUT_S

Drive = tuple[SceneRecording, list[pv.Frame]]


def street(rolling_shutter: float) -> Drive:
    """Twenty metres along a street."""
    effects = Effects(rolling_shutter=rolling_shutter)
    config = SceneConfig(preset="residential", seed=3, distance_m=20.0, rig=RIG, effects=effects)
    recording = open_scene(config)
    return recording, list(recording)


@pytest.fixture(scope="module")
def rolling() -> Drive:
    return street(0.8)


def driven(drive: Drive, estimator: str) -> tuple[ImageErrors, list[pv.MotionEstimate]]:
    """Return what is known of the images at the end, and the steps, all of which are solved."""
    recording, frames = drive
    odometry = pv.StereoOdometry(recording.camera, config={"estimator": estimator})
    steps = [odometry.step(frame) for frame in frames]
    assert all(step.status is pv.Status.OK for step in steps[1:])
    assert odometry.rig is not None
    return odometry.rig.image, steps


def second_half_error_m(drive: Drive, steps: list[pv.MotionEstimate]) -> float:
    """Return by how much the last position is off, seen from the frame in the middle."""
    truth = drive[0].truth
    assert truth is not None
    half = len(steps) // 2
    T_true = truth.T_world_cam
    found = se3.inverse(steps[half].T_world_cam) @ steps[-1].T_world_cam
    expected = se3.inverse(T_true[half]) @ T_true[len(steps) - 1]
    return float(np.linalg.norm(found[:3, 3] - expected[:3, 3]))


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_a_readout_of_48_ms_is_found_and_corrected(
    rolling: Drive, estimator: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, steps = driven(rolling, estimator)
    assert abs(image.readout.mean_s - READOUT_S) < 3.0 * image.readout.sigma_s
    assert image.readout_s == image.readout.mean_s
    monkeypatch.setattr(ReadoutTime, "noticeable_s", 0.0)
    uncorrected, as_if_global = driven(rolling, estimator)
    assert uncorrected.readout_s == 0.0
    error_m = second_half_error_m(rolling, steps)
    assert error_m < 0.5 * second_half_error_m(rolling, as_if_global)


def test_a_readout_that_is_known_is_corrected_from_the_start(rolling: Drive) -> None:
    """The whole way is then as exact as what comes behind the frame in which it is found
    otherwise."""
    recording, frames = rolling
    camera = replace(recording.camera, readout_s=READOUT_S)
    image, steps = driven((replace(recording, camera=camera), frames), "window")
    assert image.readout.mean_s == pytest.approx(READOUT_S, rel=0.05)
    assert recording.truth is not None
    end = se3.inverse(recording.truth.T_world_cam[0]) @ recording.truth.T_world_cam[-1]
    assert np.linalg.norm(steps[-1].T_world_cam[:3, 3] - end[:3, 3]) < 0.05


def test_a_global_shutter_is_left_alone() -> None:
    image, _ = driven(street(0.0), "window")
    assert image.readout_s == 0.0
    assert abs(image.readout.mean_s) < 3.0 * image.readout.sigma_s
