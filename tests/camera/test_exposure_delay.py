"""The delay of the right image is found from the rows of one frame's stereo matches, and taken
off."""

from dataclasses import replace

import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray
from probevo.camera.exposure_delay import (
    ExposureDelay,
    is_noticeable,
    right_velocity,
    without_delay,
)
from probevo.camera.rig_calibration import ROW_SIGMA_PX, RigCalibration
from probevo.camera.rig_jitter import RigJitter, jitter_offsets
from probevo.geometry import se3
from probevo.sequences.frame import StereoFeatures
from worlds import CAMERA, FORWARD, TWO_FRAMES, drive, misrectified, motion_error, random_pixels

STEP_S = 0.1
TWIST_S = se3.log(FORWARD) / STEP_S
DELAY_S = 0.005


def seen_later(pixels: FloatArray, delay_s: float, twist: FloatArray = TWIST_S) -> FloatArray:
    """Return the observations [N, 4], px, with right images of so much later."""
    moved_m = se3.transform(se3.exp(delay_s * twist), CAMERA.triangulate(pixels))
    seen = pixels.copy()
    seen[:, 2:] = CAMERA.project(moved_m)[:, 2:]
    return seen


def test_velocity_against_central_differences() -> None:
    pixels = random_pixels(np.random.default_rng(0), 50)
    h = 1e-6
    change = (seen_later(pixels, h) - seen_later(pixels, -h))[:, 2:] / (2.0 * h)
    np.testing.assert_allclose(
        right_velocity(pixels, TWIST_S, CAMERA, 0.0), change, rtol=1e-5, atol=1e-4
    )


@pytest.mark.parametrize("delay_s", [DELAY_S, -DELAY_S])
def test_a_delay_is_found_beside_the_errors_of_the_rows(delay_s: float) -> None:
    """Within 0.3 ms in five frames of 300 matches with noise of 0.2 px."""
    rng = np.random.default_rng(1)
    rig = RigCalibration.initial()
    for _ in range(5):
        pixels = seen_later(random_pixels(rng, 300), delay_s)
        seen = misrectified(pixels, disparity_px=np.zeros(2))
        rig = rig.with_delay(seen + 0.2 * rng.normal(size=seen.shape), TWIST_S, CAMERA)
    assert abs(rig.delay.estimate_s - delay_s) < 3e-4
    assert abs(rig.delay.delay_s - delay_s) < 3e-4
    assert is_noticeable(rig.delay.delay_s)


@pytest.mark.parametrize("twist", [TWIST_S, 2.0 * TWIST_S])
def test_correction_undoes_the_delay(twist: FloatArray) -> None:
    """At 12 and 24 m/s, within what turns of the camera add, of second order in the delay."""
    rng = np.random.default_rng(2)
    delay = ExposureDelay(
        ROW_SIGMA_PX, coefficients=np.r_[np.zeros(7), DELAY_S], learned=1e12 * np.eye(8)
    )
    pixels = random_pixels(rng, 100)
    seen = seen_later(pixels, delay.delay_s, twist)
    assert np.abs(seen - pixels).max() > 0.5
    assert np.abs(without_delay(seen, delay.delay_s, twist, CAMERA) - pixels).max() < 0.02


def test_a_camera_at_rest_shows_no_delay() -> None:
    rng = np.random.default_rng(3)
    rig = RigCalibration.initial()
    rig = rig.with_delay(misrectified(random_pixels(rng, 300)), np.zeros(6), CAMERA)
    assert rig.delay.estimate_s == 0.0
    np.testing.assert_allclose(rig.delay.sigma_s, 0.02, rtol=1e-6)


def test_what_a_rectification_feigns_is_not_taken_off() -> None:
    delay = ExposureDelay(
        ROW_SIGMA_PX, coefficients=np.r_[np.zeros(7), 3e-4], learned=1e12 * np.eye(8)
    )
    assert abs(delay.delay_s) < 5e-6
    assert not delay.differs_from(0.0)


def test_the_odometry_is_that_of_cameras_that_are_exposed_together() -> None:
    """At 12 m/s, a delay of 5 ms moves near points by pixels, and makes the errors of the motion
    sixteen times as large. From the fifth step on, they are less than a quarter larger."""

    def rms_m(delay_s: float) -> float:
        """Return the RMS error of the translation of the later steps."""
        squares = []
        for seed in range(4):
            odometry = pv.StereoOdometry(CAMERA, config=TWO_FRAMES)
            for frame in drive(np.random.default_rng(seed), 12):
                features = frame.features
                assert features is not None
                seen = StereoFeatures(features.ids, seen_later(features.pixels, delay_s))
                step = odometry.step(replace(frame, features=seen))
                assert step.status in (pv.Status.FIRST, pv.Status.OK)
                if frame.index >= 5:
                    squares.append(np.sum(motion_error(step.T_curr_prev)[:3] ** 2))
        return float(np.sqrt(np.mean(squares)))

    assert rms_m(DELAY_S) < 1.25 * rms_m(0.0)


def with_jitter(pixels: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Return the observations [N, 4], px, of a right camera that has turned by small angles."""
    moved = pixels.copy()
    moved[:, 2:] += jitter_offsets(pixels, CAMERA) @ angle_rad
    return moved


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("delay_s", [0.0, DELAY_S])
def test_a_rig_that_flexes_is_not_taken_for_a_late_one(seed: int, delay_s: float) -> None:
    """With 0.05° about each axis, anew in each of 40 frames: within 3σ, and what is taken off is
    the delay, if there is one."""
    rng = np.random.default_rng(seed)
    sigma_rad = np.deg2rad(0.05)
    rig = RigCalibration.initial(RigJitter.initial(sigma_rad**2 * np.eye(3)))
    for _ in range(40):
        seen = with_jitter(
            seen_later(random_pixels(rng, 100), delay_s), sigma_rad * rng.normal(size=3)
        )
        rig = rig.with_delay(seen + 0.2 * rng.normal(size=seen.shape), TWIST_S, CAMERA)
        assert abs(rig.delay.estimate_s - delay_s) < 3.5 * rig.delay.sigma_s
    assert abs(rig.delay.delay_s - delay_s) < 5e-4
