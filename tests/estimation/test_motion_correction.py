"""Corrected motions in a window: how they share the images with its features, and consistency."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest

import probevo as pv
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_correction import (
    MIN_WEIGHT,
    CovarianceIntersection,
    covariance_intersection,
)
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.window.estimator import WindowEstimator
from probevo.estimation.window.further_measurements import with_measurements
from probevo.estimation.window.window import Window
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.correction import MotionCorrection
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.sensor import NoMeasurement
from probevo.measurements.variables import pose_of
from probevo.noise import Fixed, StereoNoise
from probevo.sequences.frame import Frame
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, drive, motion_error

SIGMA_PX = 0.2
FRAMES = 14
DRIVES = 12
SPAN = 8
"""Frames that the motions within a window span."""
SETTINGS = {"estimator": "window", "self_calibration": False}
LONG_LENS = replace(CAMERA, fu_px=1.03 * CAMERA.fu_px, fv_px=1.03 * CAMERA.fv_px)
"""What a calibration says whose focal length is 3 % too long."""


def motion_of(T_curr_prev: FloatArray, cov: FloatArray) -> MotionEstimate:
    return MotionEstimate(T_curr_prev, cov, Status.OK, num_tracks=100)


def random_cov(rng: np.random.Generator, size: int = 6) -> FloatArray:
    root = rng.normal(size=(size, size))
    cov: FloatArray = root @ root.T + 0.1 * np.eye(size)
    return cov


def test_equal_motions_count_half_each_and_a_contradicted_one_counts_nothing() -> None:
    cov = random_cov(np.random.default_rng(0))
    same = covariance_intersection(motion_of(FORWARD, cov), motion_of(FORWARD, cov), 10)
    np.testing.assert_allclose(same, (2.0, 2.0), rtol=1e-9)
    moved = se3.exp(1000.0 * np.linalg.cholesky(cov)[:, 0] / np.linalg.norm(cov)) @ FORWARD
    other = covariance_intersection(motion_of(FORWARD, cov), motion_of(moved, cov), 10)
    assert other.motion == pytest.approx(1.0, abs=1e-3)
    assert other.features > 1e6


def test_features_that_two_frames_distrust_are_inflated_more() -> None:
    weights = np.array([1.0, 0.5, 0.0])
    factors = CovarianceIntersection(features=5.0, motion=2.0).feature_factors(weights)
    np.testing.assert_allclose(factors, [5.0, 9.0, 1.0 + 4.0 / MIN_WEIGHT])
    np.testing.assert_array_equal(CovarianceIntersection(1.0, 1.0).feature_factors(weights), 1.0)


@pytest.mark.parametrize("seed", range(20))
def test_the_shares_are_consistent_whatever_the_cross_covariance(seed: int) -> None:
    """What is claimed of the combination is no smaller than its covariance."""
    rng = np.random.default_rng(seed)
    joint = random_cov(rng, 12)
    image_cov = joint[:6, :6]
    of_motion = joint[6:, 6:]
    shares = covariance_intersection(
        motion_of(FORWARD, image_cov), motion_of(FORWARD, of_motion), 10
    )
    assert 1.0 / shares.features + 1.0 / shares.motion == pytest.approx(1.0)
    information = np.linalg.inv(shares.features * image_cov)
    claimed = np.linalg.inv(information + np.linalg.inv(shares.motion * of_motion))
    gain = np.hstack([claimed @ information, np.eye(6) - claimed @ information])
    assert np.linalg.eigvalsh(claimed - gain @ joint @ gain.T).min() > -1e-9


class KnownCorrection(MotionCorrection):
    """A correction that is the same in all steps, with the covariance of what remains."""

    name = "known"

    def __init__(self, xi: FloatArray, covariance: FloatArray) -> None:
        self.xi = xi
        self.covariance = covariance

    def correct(
        self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
    ) -> RelativePose:
        """Return the corrected motion."""
        return RelativePose(
            se3.exp(self.xi) @ T_curr_prev,
            self.covariance,
            curr=pose_of(frame.index),
            prev=pose_of(prev_frame.index),
        )


class Recorder(MotionCorrection):
    """Notes the motions of the images, and corrects nothing."""

    name = "recorder"

    def __init__(self) -> None:
        self.motions: list[FloatArray] = []

    def correct(
        self, prev_frame: Frame, frame: Frame, T_curr_prev: FloatArray, *, cov: FloatArray
    ) -> NoMeasurement:
        """Note the motion."""
        self.motions.append(T_curr_prev)
        return NoMeasurement("recorded")


@dataclass(frozen=True)
class Driven:
    """What an odometry made of a drive."""

    window: Window
    """At its end."""
    steps: list[MotionEstimate]

    @property
    def nees_of_span(self) -> float:
        """That of the motion over the last frames of the window, over its 6 dimensions."""
        last = len(self.window) - 1
        T, cov = self.window.relative(last, last - SPAN)
        return nees(T, np.linalg.matrix_power(FORWARD, SPAN), cov)

    @property
    def nees_of_path(self) -> float:
        """That of the last pose."""
        T_cam_world = se3.inverse(self.steps[-1].T_world_cam)
        truth = np.linalg.matrix_power(FORWARD, len(self.steps))
        return nees(T_cam_world, truth, self.steps[-1].cov_cam_world)

    @property
    def nees_of_steps(self) -> float:
        """The mean of that of all steps."""
        return float(np.mean([nees(step.T_curr_prev, FORWARD, step.cov) for step in self.steps]))


def nees(T: FloatArray, truth: FloatArray, cov: FloatArray) -> float:
    """Return the normalised squared error over its 6 dimensions."""
    return float(normalized_error_squared(T[None], truth[None], cov[None])[0]) / 6.0


@cache
def driven(seed: int, camera: StereoCamera, *sensors: MotionCorrection) -> Driven:
    frames = drive(np.random.default_rng(seed), FRAMES, sigma_px=SIGMA_PX)
    odometry = pv.StereoOdometry(camera, Fixed(), config=SETTINGS, sensors=sensors)
    steps = [odometry.step(frame) for frame in frames]
    assert odometry.window is not None
    return Driven(odometry.window, steps[1:])


@cache
def learned(camera: StereoCamera) -> KnownCorrection:
    """Return the correction that other drives show, with the covariance of what remains."""
    recorder = Recorder()
    for seed in range(100, 100 + DRIVES):
        driven(seed, camera, recorder)
    errors = np.array([motion_error(motion) for motion in recorder.motions])
    return KnownCorrection(errors.mean(axis=0), np.cov(errors, rowvar=False))


@pytest.mark.parametrize("camera", [CAMERA, LONG_LENS], ids=["right", "wrong"])
def test_a_corrected_window_is_consistent(camera: StereoCamera) -> None:
    """Whether there is something to correct or not, it claims neither too much nor far too little.

    Without the shares, steps have a NEES of 1.6 with the right calibration (the images count
    twice), and motions over eight frames one of 290 with the wrong one.
    """
    correction = learned(camera)
    found = [driven(seed, camera, correction) for seed in range(DRIVES)]
    _, high = np.array(chi2_interval(6, DRIVES)) / 6.0
    assert 0.3 < np.mean([one.nees_of_span for one in found]) < high
    assert 0.3 < np.mean([one.nees_of_path for one in found]) < high
    assert 0.5 < np.mean([one.nees_of_steps for one in found]) < 1.1
    assert {step.sensors[0].state for one in found for step in one.steps} == {"used"}


def test_a_correction_takes_back_what_a_wrong_focal_length_does_to_the_window() -> None:
    correction = learned(LONG_LENS)
    errors = []
    for sensors in ((), (correction,)):
        found = [driven(seed, LONG_LENS, *sensors) for seed in range(3)]
        truth = np.linalg.matrix_power(FORWARD, FRAMES - 1)
        ends = [se3.inverse(one.steps[-1].T_world_cam) for one in found]
        errors.append(np.mean([np.linalg.norm(motion_error(T, truth)[:3]) for T in ends]))
        assert (found[0].nees_of_span > 100.0) is (not sensors)
    assert errors[1] < 0.05 * errors[0]


def test_a_window_that_is_corrected_by_nothing_is_the_same_to_the_byte() -> None:
    plain = driven(0, CAMERA)
    asked = driven(0, CAMERA, Recorder())
    np.testing.assert_array_equal(plain.window.T_cam_world, asked.window.T_cam_world)
    np.testing.assert_array_equal(plain.window.cov, asked.window.cov)
    assert asked.steps[-1].sensors[0].reason == "recorded"


def test_where_the_features_fix_no_motion_the_corrected_one_counts_once() -> None:
    """The window falls back on the motion that is one of its measurements."""
    window = driven(0, CAMERA).window
    by = WindowEstimator(CAMERA, pv.OdometryConfig.model_validate(SETTINGS))
    frame = int(window.frames[-1]) + 1
    cov = np.diag([1e-4, 1e-4, 1e-4, 1e-8, 1e-8, 1e-8])
    motion = RelativePose(FORWARD, cov, curr=pose_of(frame), prev=pose_of(frame - 1))
    after = by.add_unobserved_frame(window, frame, motion, [motion], motion_is_measured=True)
    _, found = after.relative(len(after) - 1, len(after) - 2)
    np.testing.assert_allclose(found, cov, rtol=1e-3, atol=1e-10)


def test_a_corrected_motion_that_stands_for_the_features_counts_in_full() -> None:
    """Beside them, its covariance would be inflated, for its share of their information."""
    window = driven(0, CAMERA).window
    by = WindowEstimator(CAMERA, pv.OdometryConfig.model_validate(SETTINGS))
    frame = int(window.frames[-1]) + 1
    cov = np.diag([1e-4, 1e-4, 1e-4, 1e-8, 1e-8, 1e-8])
    motion = RelativePose(FORWARD, cov, curr=pose_of(frame), prev=pose_of(frame - 1))
    none = StereoNoise(scale=np.zeros((0, 4, 4)), dof=np.zeros(0), bias=np.zeros((0, 4)))
    # The pose before is not connected with it either, so that the adjustment fixes no motion.
    after = by.add_observed_frame(window, Tracks.none(), none, motion=motion, motion_factor=1e9)
    _, found = after.relative(len(after) - 1, len(after) - 2)
    np.testing.assert_allclose(found, cov, rtol=1e-3, atol=1e-10)


def test_the_equations_of_a_measured_motion_are_those_of_its_cost() -> None:
    """Gradient and Hessian that the window's prior takes, against central differences, where the
    poses are at their linearisation points."""
    window = driven(1, CAMERA).window
    window = replace(window, T_linear=window.T_cam_world)
    cov = 1e-4 * random_cov(np.random.default_rng(2))
    T = window.T_cam_world[-1] @ se3.inverse(window.T_cam_world[-3])
    measured = se3.exp(np.array([0.01, -0.02, 0.03, 0.001, 0.002, -0.001])) @ T
    frames = window.frames
    motion = RelativePose(measured, cov, curr=pose_of(frames[-1]), prev=pose_of(frames[-3]))
    after = with_measurements(window, [motion])
    x = window.offsets()
    information = after.prior.information - window.prior.information
    gradient = after.prior.vector - window.prior.vector - information @ x

    def residual(step: FloatArray) -> FloatArray:
        """Return that of moved poses."""
        moved = se3.exp(step.reshape(-1, 6)) @ window.T_cam_world
        values = {pose_of(frame): T for frame, T in zip(frames, moved, strict=True)}
        return motion.residual(values)

    size = 6 * len(window)
    units = 1e-6 * np.eye(size)
    jacobian = np.array([(residual(unit) - residual(-unit)) / 2e-6 for unit in units]).T
    expected = jacobian.T @ np.linalg.inv(cov)
    np.testing.assert_allclose(gradient[:size], -expected @ residual(np.zeros(size)), atol=1e-3)
    np.testing.assert_allclose(information[:size, :size], expected @ jacobian, atol=1e-2)
