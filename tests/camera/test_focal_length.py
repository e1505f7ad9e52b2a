"""The focal length: its Jacobian, what turns show of it, and that its σ holds."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.focal_length import MAX_BLOCKS, PRIOR_SIGMA, FocalLengthEstimate
from probevo.camera.focal_length_numba import focal_sensitivity
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rolling_shutter import Twists
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import Intrinsics
from probevo.estimation.reprojection import solve_reprojection
from probevo.estimation.rig_update import update_rig
from probevo.geometry import se3
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import StudentT
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, random_pixels, seen_twice

TURN = se3.exp(np.array([0.1, 0.0, -0.8, 0.004, 0.03, -0.002]))


def scaled(ratio: float) -> StereoCamera:
    return replace(CAMERA, fu_px=ratio * CAMERA.fu_px, fv_px=ratio * CAMERA.fv_px)


def test_the_jacobian_is_that_of_central_differences() -> None:
    pixels = random_pixels(np.random.default_rng(0), 50)
    refined = np.column_stack([pixels[:, :2], pixels[:, 0] - pixels[:, 2]])
    sensitivity = np.empty((50, 4))
    focal_sensitivity(TURN, Intrinsics.of(CAMERA), refined, sensitivity)

    def predicted(log_ratio: float) -> FloatArray:
        camera = scaled(np.exp(log_ratio))
        return camera.project(se3.transform(TURN, camera.triangulate(pixels)))

    step = 1e-5
    numeric = -(predicted(step) - predicted(-step)) / (2.0 * step)
    np.testing.assert_allclose(sensitivity, numeric, atol=1e-6)


def learned(
    rng: np.random.Generator,
    ratio: float,
    turn: Callable[[int], FloatArray],
    frames: int = 60,
    sigma_px: float = 0.2,
) -> FocalLengthEstimate:
    """What steps teach if the calibration says ``ratio`` times the true focal length."""
    wrong = scaled(ratio)
    rig = RigCalibration.initial()
    for k in range(frames):
        seen = seen_twice(rng, 200, turn(k), sigma_px=sigma_px)
        tracks = Tracks(seen.prev_px, seen.curr_px, seen.ids, age=seen.age).corrected(rig, wrong)
        noise = StudentT().predict(np.zeros((len(tracks), 0)))
        solution = solve_reprojection(
            StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=wrong),
            guess=turn(k),
        )
        twist_s = 10.0 * se3.log(turn(k))
        rig, _ = update_rig(rig, tracks, solution, wrong, Twists(twist_s, twist_s))
    return rig.focal


def winding(k: int) -> FloatArray:
    """Drive a winding road."""
    yaw_rad = 0.03 * np.sin(0.4 * k)
    return se3.exp(np.array([0.0, 0.0, -1.0, 0.0, yaw_rad, 0.0]))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("ratio", [0.97, 1.0, 1.03])
def test_a_winding_drive_shows_the_focal_length(seed: int, ratio: float) -> None:
    error = learned(np.random.default_rng(seed), ratio, winding).error()
    assert abs(error.log_ratio + np.log(ratio)) < 3.0 * error.sigma
    assert error.sigma < 0.006
    assert error.is_noticeable == (ratio != 1.0)


def test_what_the_distortion_field_has_taken_up_still_shows() -> None:
    """It looks like a wrong focal length, and the tracks are corrected by it: a step tells the same
    with any field, to first order."""
    rng = np.random.default_rng(4)
    wrong = scaled(1.03)
    raw = seen_twice(rng, 400, TURN, sigma_px=0.1)
    moments = []
    for size_px in (0.0, 0.1, 0.2):
        rig = RigCalibration.initial()
        mean = rig.image.mean.copy()
        mean[2:] = size_px * np.random.default_rng(5).normal(size=len(mean) - 2)
        rig = replace(rig, image=replace(rig.image, mean=mean))
        tracks = Tracks(raw.prev_px, raw.curr_px, raw.ids, age=raw.age).corrected(rig, wrong)
        noise = StudentT(np.inf, 0.01 * np.eye(4)).predict(np.zeros((len(tracks), 0)))
        solution = solve_reprojection(
            StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=wrong), guess=TURN
        )
        twist_s = 10.0 * se3.log(TURN)
        updated, _ = update_rig(rig, tracks, solution, wrong, Twists(twist_s, twist_s))
        moments.append(updated.focal.moment[0, 2])
    np.testing.assert_allclose(moments[1:], moments[0], rtol=0.1)


def test_a_straight_drive_shows_nothing_and_says_so() -> None:
    straight = se3.exp(se3.log(FORWARD) * np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]))
    error = learned(np.random.default_rng(0), 1.03, lambda k: straight).error()
    assert error.sigma > 0.03
    assert not error.is_noticeable


def test_the_mean_over_drives_is_the_truth_within_a_tenth() -> None:
    found = [
        learned(np.random.default_rng(seed), 1.02, winding, frames=30).error().log_ratio
        for seed in range(10)
    ]
    assert np.mean(found) == pytest.approx(-np.log(1.02), rel=0.1)


def test_errors_that_last_over_frames_enlarge_sigma() -> None:
    """Gradients with the same sum, but a scatter far beyond the information."""
    rng = np.random.default_rng(0)
    calm = FocalLengthEstimate.initial()
    restless = FocalLengthEstimate.initial()
    information = np.diag([1e4, 1e4, 1e8])
    errors = np.repeat(rng.normal(0.0, 0.02, 12), 5)
    errors -= errors.mean()
    for error in errors:
        calm = calm.with_step(information, np.zeros(3), np.zeros(3))
        restless = restless.with_step(information, np.array([0.0, 0.0, 1e8 * error]), np.zeros(3))
    assert restless.error().sigma > 3.0 * calm.error().sigma
    # The σ of a mean of twelve blocks.
    expected = np.std(errors, ddof=0) / np.sqrt(11.0)
    assert restless.error().sigma == pytest.approx(expected, rel=0.1)


def test_joining_blocks_keeps_the_estimate() -> None:
    rng = np.random.default_rng(1)
    estimate = FocalLengthEstimate.initial()
    total = np.zeros((3, 3))
    moment = np.zeros(3)
    for _ in range(1000):
        information = np.diag(rng.uniform(1.0, 2.0, 3)) * 1e4
        gradient = rng.normal(size=3) * 100.0
        by = np.array([0.1, 0.2, 0.0])
        estimate = estimate.with_step(information, gradient, by)
        total += information
        moment += gradient + information @ by
    assert len(estimate.moment) <= MAX_BLOCKS
    assert (estimate.block_frames * (len(estimate.moment) - 1) + estimate.last_frames) == 1000
    np.testing.assert_allclose(estimate.information.sum(axis=0), total)
    np.testing.assert_allclose(estimate.moment.sum(axis=0), moment)


def test_without_a_frame_it_is_the_prior() -> None:
    error = FocalLengthEstimate.initial().error()
    assert error.log_ratio == 0.0
    assert error.sigma == pytest.approx(PRIOR_SIGMA[2])
