"""The whole flow: simulated drives whose truth is known, blind frames among them, and the real
recordings."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import probevo as pv
from cli.rendering import write_wall
from inertial_worlds import CALIBRATION, SmoothPath, inertial_drive
from intervals import chi2_interval
from probevo.arrays import FloatArray, Image
from probevo.config import GyroConfig, SolverConfig, TrackingConfig
from probevo.errors import InputError
from probevo.estimation.recovery import DeadReckonedPath, OutageVelocity
from probevo.estimation.window.estimator import WindowEstimator
from probevo.evaluation.consistency import drift_covariances
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements import NoMeasurement
from probevo.noise import Fixed, NearestNeighbors, StudentT
from probevo.noise.metric import Metric
from probevo.predictors import PREDICTORS, prediction_space
from probevo.sequences.frame import Frame, ImuSamples, StereoFeatures
from probevo.sequences.frame_checks import check_frame
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.missing_data import Defect, MissingData
from probevo.state import Outage
from probevo.tracking import preparation
from probevo.tracking.preparation import high_pass
from worlds import (
    CAMERA,
    FORWARD,
    FRAME_NS,
    HEIGHT_PX,
    TWO_FRAMES,
    WIDTH_PX,
    Homesick,
    blind_frame,
    drive,
    motion_error,
    with_features,
)

OK = pv.Status.OK
FIRST = pv.Status.FIRST
GAP = pv.Status.GAP
PLAIN = pv.OdometryConfig(self_calibration=False)


def run(
    frames: Sequence[Frame],
    config: pv.OdometryConfig | None = None,
    noise: pv.noise.NoiseModel | None = None,
) -> list[pv.MotionEstimate]:
    odometry = pv.StereoOdometry(CAMERA, noise, config=config)
    return [odometry.step(frame) for frame in frames]


def volume(motion: pv.MotionEstimate) -> float:
    """Return the log determinant of the covariance."""
    return float(np.linalg.slogdet(motion.cov)[1])


def is_proper(motion: pv.MotionEstimate) -> bool:
    """Return whether it is a finite rigid motion with a finite, positive definite covariance."""
    C = motion.T_curr_prev[:3, :3]
    orthonormal = np.allclose(C @ C.T, np.eye(3), atol=1e-9) and np.linalg.det(C) > 0.0
    return bool(
        orthonormal
        and np.isfinite(motion.T_curr_prev).all()
        and (np.linalg.eigvalsh(motion.cov) > 0.0).all()
    )


def test_the_first_frame_is_the_origin() -> None:
    (first,) = run(drive(np.random.default_rng(0), 1))
    assert first.status is FIRST
    np.testing.assert_array_equal(first.T_curr_prev, np.eye(4))
    np.testing.assert_array_equal(first.cov, np.zeros((6, 6)))


def test_motions_on_a_circle_agree_with_the_truth() -> None:
    motions = run(drive(np.random.default_rng(1), 60))[1:]
    assert all(motion.status is OK for motion in motions)
    errors = np.array([motion_error(motion.T_curr_prev) for motion in motions])
    assert np.linalg.norm(errors[:, :3], axis=1).max() < 0.05
    assert np.linalg.norm(errors[:, 3:], axis=1).max() < 0.002


@pytest.mark.parametrize("noise", [None, Fixed()], ids=["student-t", "fixed"])
def test_covariance_of_two_frames_is_consistent(noise: Fixed | None) -> None:
    """ANEES of 120 motions lies in the 99.9 % interval of χ²(6)/120: the noise of 0.2 px is that of
    the models."""
    config = PLAIN.model_copy(update=TWO_FRAMES)
    odometry = pv.StereoOdometry(CAMERA, noise, config=config)
    motions = [odometry.step(frame) for frame in drive(np.random.default_rng(2), 121)][1:]
    nees = [normalized_error_squared(FORWARD, motion.T_curr_prev, motion.cov) for motion in motions]
    low, high = chi2_interval(6, len(nees))
    assert low < np.mean(nees) < high


@pytest.mark.parametrize("sigma_px", [0.06, 0.5])
def test_covariance_is_consistent_where_the_noise_model_is_not(sigma_px: float) -> None:
    """Errors a third or three times as large as the noise model says: once the odometry has learned
    that, ANEES of 200 motions lies in the 99.9 % interval of χ²(6)/200."""
    frames = drive(np.random.default_rng(2), 221, sigma_px=sigma_px)
    motions = run(frames, PLAIN.model_copy(update=TWO_FRAMES))[21:]
    nees = [normalized_error_squared(FORWARD, motion.T_curr_prev, motion.cov) for motion in motions]
    low, high = chi2_interval(6, len(nees))
    assert low < np.mean(nees) < high
    # A Gaussian of 0.2 px fits the Student-t of the model: its σ is 0.17 px.
    assert np.sqrt(motions[-1].noise_factor) == pytest.approx(sigma_px / 0.2, rel=0.1)


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_ten_features_are_enough_if_their_noise_is_as_predicted(estimator: str) -> None:
    """Too few of them seemed usual; and six numbers fitted to the residuals of eight features made
    the noise seem smaller than it was, so that ever fewer did. Seven of ten steps were refused."""
    config = PLAIN.model_copy(update={"estimator": estimator})
    statuses = []
    factors = []
    nees = []
    for seed in range(3):
        frames = drive(
            np.random.default_rng(seed), 41, points=12, sigma_px=0.17, depth_m=(5.0, 30.0)
        )
        motions = run(frames, config)[1:]
        statuses += [motion.status for motion in motions]
        factors.append(motions[-1].noise_factor)
        nees += [
            normalized_error_squared(FORWARD, motion.T_curr_prev, motion.cov)
            for motion in motions
            if motion.status is OK
        ]
    assert statuses.count(OK) > 0.95 * len(statuses)
    # A Gaussian of 0.17 px fits the model's Student-t with two thirds of its variance.
    assert np.exp(np.mean(np.log(factors))) == pytest.approx(0.65, abs=0.2)
    # Of so few features, steps are a little overconfident (docs/accuracy.md).
    assert np.mean(nees) < 1.5 * 6.0


def test_noise_is_learned_to_be_small_although_the_motion_seems_undetermined() -> None:
    """Points at 500 m and more, observed to 0.02 px: with the 0.17 px that the model expects, they
    tell no translation. Such steps taught nothing, and so it was for ever."""
    frames = drive(np.random.default_rng(0), 8, sigma_px=0.02, depth_m=(500.0, 3000.0))
    motions = run(frames)[1:]
    assert all(motion.status is OK for motion in motions)
    nees = [normalized_error_squared(FORWARD, motion.T_curr_prev, motion.cov) for motion in motions]
    _, high = chi2_interval(6, len(nees))
    assert np.mean(nees) < high


def test_the_running_scale_of_the_noise_learns_nothing_at_rest() -> None:
    """What does not move has the same errors in both frames."""
    frames = drive(np.random.default_rng(2), 40, np.eye(4), sigma_px=0.02)
    assert [motion.noise_factor for motion in run(frames)] == [1.0] * 40


def test_only_solved_single_steps_show_the_size_of_the_noise() -> None:
    """Neither those of blind frames, nor the one that leads back over them."""
    frames = drive(np.random.default_rng(4), 20)
    frames[10:13] = [with_features(frame, 5) for frame in frames[10:13]]
    motions = run(frames)
    assert motions[13].status is pv.Status.RECOVERED
    # Each has the factor from the steps before it.
    factors = [motion.noise_factor for motion in motions]
    assert factors[9] != factors[10]
    assert len(set(factors[10:15])) == 1
    assert factors[15] != factors[14]


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_a_vehicle_that_stops_learns_no_smaller_noise(estimator: str) -> None:
    frames = drive(
        np.random.default_rng(5), 60, np.array([FORWARD] * 30 + [np.eye(4)] * 30), sigma_px=0.2
    )
    factors = [
        motion.noise_factor
        for motion in run(frames, PLAIN.model_copy(update={"estimator": estimator}))
    ]
    assert factors[-1] == pytest.approx(factors[30], rel=0.05)


def test_the_noise_of_the_model_is_taken_as_it_is_on_request() -> None:
    config = PLAIN.model_copy(update={"solver": SolverConfig(noise_scale="model")})
    motions = run(drive(np.random.default_rng(2), 20, sigma_px=0.06), config)
    assert {motion.noise_factor for motion in motions} == {1.0}


def test_the_doubt_of_the_calibration_makes_the_covariance_no_smaller_than_the_error() -> None:
    """With a perfect rig it is conservative, as it cannot know that; yet not by orders of
    magnitude."""
    motions = run(drive(np.random.default_rng(3), 121))[1:]
    nees = [normalized_error_squared(FORWARD, motion.T_curr_prev, motion.cov) for motion in motions]
    # The uncertainty of the calibration is included although it is exact here: conservative.
    _, high = chi2_interval(6, len(nees))
    assert 1.0 < np.mean(nees) < high


@pytest.mark.parametrize("count", [0, 1, 5])
def test_blind_frames_are_dead_reckoned(count: int) -> None:
    """Three frames in a row with hardly a feature: two steps between them and one before are blind,
    and the one after leads back to the features before."""
    frames = drive(np.random.default_rng(4), 20)
    frames[10:13] = [with_features(frame, count) for frame in frames[10:13]]
    motions = run(frames)
    statuses = [motion.status for motion in motions[10:14]]
    assert statuses == [pv.Status.TOO_FEW_TRACKS] * 3 + [pv.Status.RECOVERED]
    for motion in motions[10:14]:
        assert is_proper(motion)
        assert volume(motion) > volume(motions[9]) + 6.0
        assert np.linalg.norm(motion_error(motion.T_curr_prev)[:3]) < 0.1


@pytest.mark.parametrize("steps", [5, 20, 60])
def test_the_covariance_of_blind_motions_holds_their_error(steps: int) -> None:
    """A vehicle brakes with 5 m/s² while nothing is seen: steps and path are within 1.1σ."""
    frames = drive(np.random.default_rng(5), 12)
    twist = se3.log(FORWARD)
    braking = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    motions = run([*frames, *(blind_frame(12 + k) for k in range(steps))])[12:]
    truth = [se3.exp(twist + (k + 1) * braking) for k in range(steps)]
    for motion, T_true in zip(motions, truth, strict=True):
        assert (
            np.abs(motion_error(motion.T_curr_prev, T_true))
            < 1.1 * np.sqrt(np.diagonal(motion.cov))
        ).all()
    T_true = se3.chain_motions(np.array([*[FORWARD] * 11, *truth]))[-1]
    error = se3.log(se3.inverse(motions[-1].T_world_cam) @ T_true)
    assert (np.abs(error) < 1.1 * np.sqrt(np.diagonal(motions[-1].cov_cam_world))).all()


def test_images_are_accepted_again_at_once() -> None:
    frames = drive(np.random.default_rng(6), 20)
    frames[10:13] = [with_features(frame, 0) for frame in frames[10:13]]
    motions = run(frames)
    assert all(motion.status is OK for motion in motions[14:])
    assert np.abs(motion_error(motions[14].T_curr_prev)).max() < 0.05


def test_a_recording_without_any_feature_runs_to_the_end() -> None:
    """Nothing is ever known: no motion is claimed, but no certainty either."""
    for motion in run([blind_frame(k) for k in range(10)])[1:]:
        assert motion.status is pv.Status.TOO_FEW_TRACKS
        assert is_proper(motion)
        assert motion.cov[2, 2] > 1.0


def test_a_gap_in_time_is_said_and_bridged() -> None:
    """Two seconds are missing, and no point is seen on both sides: the velocity goes on, far less
    certain."""
    before = drive(np.random.default_rng(7), 10)
    after = drive(np.random.default_rng(8), 10)
    late_ns = before[-1].stamp_ns + 20 * FRAME_NS - after[0].stamp_ns
    moved = [
        replace(frame, index=10 + frame.index, stamp_ns=frame.stamp_ns + late_ns) for frame in after
    ]
    renamed = [
        replace(f, features=replace(f.features, ids=f.features.ids + 10**6))
        for f in moved
        if f.features
    ]
    motions = run([*before, *renamed])
    assert [motion.status for motion in motions] == [FIRST, *9 * [OK], GAP, *9 * [OK]]
    assert is_proper(motions[10])
    travelled = motions[10].T_curr_prev @ se3.inverse(se3.exp(20.0 * se3.log(FORWARD)))
    assert np.linalg.norm(se3.log(travelled)[:3]) < 1.0
    assert motions[10].cov[2, 2] > 100.0


@pytest.mark.parametrize("pause_s", [100, 10_000])
@pytest.mark.parametrize("first", [2, 5, 11])
def test_after_a_long_pause_the_window_goes_on(first: int, pause_s: int) -> None:
    """The motion over the pause is so uncertain that rounding would lose it beside the others."""
    frames = [
        replace(frame, stamp_ns=frame.stamp_ns + (frame.index >= first) * pause_s * 1_000_000_000)
        for frame in drive(np.random.default_rng(0), 16)
    ]
    for motion in run(frames)[1:]:
        assert is_proper(motion)
        assert np.isfinite(motion.cov_cam_world).all()
        assert (np.diag(motion.cov_cam_world) >= 0.0).all()


@pytest.mark.parametrize("pause_s", [3, 10, 100])
def test_behind_a_long_pause_steps_claim_what_the_images_show(pause_s: int) -> None:
    """Before, they claimed up to hundreds of metres, a share of the error of the position in the
    world; and motions within the window up to decimetres. While the pause is within the window,
    rounding still adds centimetres."""
    first = 15
    frames = [
        replace(frame, stamp_ns=frame.stamp_ns + (frame.index >= first) * pause_s * 1_000_000_000)
        for frame in drive(np.random.default_rng(4), 45)
    ]
    odometry = pv.StereoOdometry(CAMERA)
    motions = []
    relative = []
    for frame in frames:
        motions.append(odometry.step(frame))
        if frame.index > 0:
            relative.append(odometry.relative(frame.index, frame.index - 1)[1])
    usual_m = max(np.sqrt(motion.cov[2, 2]) for motion in motions[1:first])
    assert all(motion.status is OK for motion in motions[first + 1 :])
    steps_m = np.sqrt([motion.cov[2, 2] for motion in motions[first + 1 :]])
    relative_m = np.sqrt([cov[2, 2] for cov in relative[first:]])
    assert max(steps_m.max(), relative_m.max()) < 0.05
    has_left = odometry.config.window.frames
    assert max(steps_m[has_left:].max(), relative_m[has_left:].max()) < 1.5 * usual_m


@pytest.mark.parametrize("window_frames", [3, 10])
@pytest.mark.parametrize("kind", ["pauses", "instants", "both"])
def test_stamps_of_any_distance_leave_covariances(kind: str, window_frames: int) -> None:
    """Pauses of ten seconds leave nearly nothing known across them, and frames within a microsecond
    of each other so much that rounding loses the rest."""
    seconds = {"pauses": [10.0], "instants": [1e-6], "both": [10.0, 1e-6]}[kind]
    rng = np.random.default_rng(3)
    is_odd = rng.random(60) < 0.4
    steps_ns = np.where(is_odd, 1e9 * rng.choice(seconds, size=60), float(FRAME_NS)).astype(int)
    stamps_ns = 10**18 + np.cumsum(steps_ns)
    frames = [
        replace(frame, stamp_ns=int(stamp_ns))
        for frame, stamp_ns in zip(drive(rng, 60), stamps_ns, strict=True)
    ]
    config = pv.OdometryConfig.model_validate({"window": {"frames": window_frames}})
    for motion in run(frames, config)[1:]:
        assert is_proper(motion)
        sigma = np.sqrt(np.diag(motion.cov_cam_world))
        assert np.linalg.eigvalsh(motion.cov_cam_world / sigma[:, None] / sigma)[0] > -1e-6


def test_outlier_frames_are_refused() -> None:
    """All features of one frame swap places: no motion explains them, and the frame is
    dead-reckoned."""
    frames = drive(np.random.default_rng(9), 15)
    features = frames[10].features
    assert features is not None
    order = np.random.default_rng(0).permutation(len(features.ids))
    frames[10] = replace(frames[10], features=replace(features, pixels=features.pixels[order]))
    for motion in run(frames)[10:12]:
        assert motion.status is not OK
        assert np.linalg.norm(motion_error(motion.T_curr_prev)[:3]) < 0.1


def test_the_same_seed_gives_the_same_bytes() -> None:
    frames = drive(np.random.default_rng(10), 15)
    first = run(frames)
    second = run(frames)
    for one, other in zip(first, second, strict=True):
        assert one.T_curr_prev.tobytes() == other.T_curr_prev.tobytes()
        assert one.cov.tobytes() == other.cov.tobytes()


def test_a_frame_s_randomness_does_not_depend_on_those_before() -> None:
    """Seeded by its index, a run that starts at frame 5 draws the same samples there. Its noise has
    no time-correlated part, or tracks would remember the frames before, as a window does."""
    frames = drive(np.random.default_rng(11), 12)
    noise = pv.noise.StudentT(time_correlation_ratio=0.0)
    config = PLAIN.model_copy(update=TWO_FRAMES)
    whole = run(frames, config, noise)
    late = run(frames[5:], config, noise)
    np.testing.assert_allclose(whole[-1].T_curr_prev, late[-1].T_curr_prev, atol=1e-6)


def turning(
    frames: list[Frame], bias_rad_s: FloatArray, C_cam_imu: FloatArray, rng: np.random.Generator
) -> list[Frame]:
    """Return the frames with a gyro at 200 Hz that measures the turn of FORWARD, and its bias."""
    rate = C_cam_imu.T @ (-so3.log(FORWARD[:3, :3]) / 0.1) + bias_rad_s
    with_imu = frames[:1]
    for frame in frames[1:]:
        stamps_ns = np.arange(frame.stamp_ns - FRAME_NS, frame.stamp_ns + 1, 5_000_000)
        gyro = rate + GYRO_NOISE / np.sqrt(0.005) * rng.normal(size=(len(stamps_ns), 3))
        with_imu.append(replace(frame, imu=ImuSamples(stamps_ns, gyro, np.full_like(gyro, np.nan))))
    return with_imu


GYRO_NOISE = 2e-4


@pytest.mark.parametrize("prior", [False, True])
def test_the_gyro_s_bias_is_learned(prior: bool) -> None:
    """Off by 0.05 rad/s at start, within 3σ of the truth after five seconds, whether it enters the
    solve or not."""
    bias = np.array([0.05, -0.03, 0.04])
    C_cam_imu = so3.exp(np.array([1.2, -1.2, 1.2]))
    rng = np.random.default_rng(12)
    frames = turning(drive(rng, 50), bias, C_cam_imu, rng)
    imu = ImuCalibration(se3.from_parts(C_cam_imu, np.zeros(3)), GYRO_NOISE, 0.05)
    odometry = pv.StereoOdometry(
        CAMERA, imu=imu, config=pv.OdometryConfig(gyro=GyroConfig(prior=prior))
    )
    statuses = [odometry.step(frame).status for frame in frames]
    assert all(status is OK for status in statuses[1:])
    assert odometry.gyro_bias is not None
    sigma = np.sqrt(np.diagonal(odometry.gyro_bias.cov))
    assert (np.abs(odometry.gyro_bias.mean - bias) < 3.0 * sigma).all()
    assert (sigma < 0.002).all()


def test_a_gyro_that_was_not_there_all_the_time_is_not_asked() -> None:
    """Whoever leaves out frames, and their samples with them, gets what the images say."""
    rng = np.random.default_rng(15)
    plain = drive(rng, 21)[::2]
    # A wrong gyro, and samples of the last tenth of a second only.
    half = turning(plain, np.array([0.5, 0.5, 0.5]), np.eye(3), rng)
    imu = ImuCalibration(np.eye(4), GYRO_NOISE, 1e-3)
    config = pv.OdometryConfig(gyro=GyroConfig(prior=True))
    odometry = pv.StereoOdometry(CAMERA, imu=imu, config=config)
    for frame, motion in zip(half, run(plain), strict=True):
        np.testing.assert_array_equal(odometry.step(frame).T_curr_prev, motion.T_curr_prev)


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_a_gyro_whose_signs_are_wrong_does_not_refuse_every_solve(estimator: str) -> None:
    """It has no accelerometer, so that a window cannot test it, and claims 1 mrad/s/√Hz."""
    turn = se3.exp(np.array([0.0, 0.0, -1.0, 0.0, -0.03, 0.0]))
    frames = drive(np.random.default_rng(1), 30, turn)
    for k in range(1, len(frames)):
        stamps_ns = np.arange(
            frames[k - 1].stamp_ns - 10_000_000, frames[k].stamp_ns + 10_000_000, 5_000_000
        )
        rates = np.tile([0.0, -0.3, 0.0], (len(stamps_ns), 1))  # it turns by +0.3 rad/s
        samples = ImuSamples(stamps_ns, rates, np.full((len(stamps_ns), 3), np.nan))
        frames[k] = replace(frames[k], imu=samples)
    imu = ImuCalibration(np.eye(4), 1e-3, 0.01)
    odometry = pv.StereoOdometry(CAMERA, imu=imu, config={"estimator": estimator})
    statuses = [odometry.step(frame).status for frame in frames]
    assert sum(status is OK for status in statuses) >= 24


def test_a_gyro_without_noise_and_bias_fixes_the_rotation() -> None:
    rng = np.random.default_rng(17)
    frames = turning(drive(rng, 6), np.zeros(3), np.eye(3), rng)
    config = pv.OdometryConfig(gyro=GyroConfig(prior=True), self_calibration=False)
    odometry = pv.StereoOdometry(CAMERA, imu=ImuCalibration(np.eye(4), 0.0, 0.0), config=config)
    for k, motion in enumerate([odometry.step(frame) for frame in frames]):
        assert motion.status is (OK if k else pv.Status.FIRST)
        assert np.sqrt(motion.cov[3:, 3:].trace()) < 1e-5


def test_while_the_gyro_is_not_asked_its_bias_walks_on() -> None:
    rng = np.random.default_rng(16)
    frames = turning(drive(rng, 12), np.zeros(3), np.eye(3), rng)
    imu = ImuCalibration(np.eye(4), GYRO_NOISE, 1e-3, gyro_bias_walk_rad_s2_sqrt_hz=1e-3)
    odometry = pv.StereoOdometry(CAMERA, imu=imu)
    variances = []
    for frame in [*frames[:10], *(replace(frame, imu=None) for frame in frames[10:])]:
        odometry.step(frame)
        assert odometry.gyro_bias is not None
        variances.append(np.diagonal(odometry.gyro_bias.cov).copy())
    np.testing.assert_allclose(variances[-1] - variances[-2], 0.1 * 1e-6, rtol=1e-6)


def test_duplicate_images_are_treated_as_dropped_frames(tmp_path: Path) -> None:
    """A frozen driver repeats a pair three times, and a fourth time the left image only: the motion
    is dead-reckoned, with an inflated covariance, until the features before are seen again."""
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 12))
    frames = list(sequence)
    for k in (6, 7, 8, 9):
        left = frames[5].left
        right = frames[5 if k < 9 else 9].right
        assert left is not None
        assert right is not None
        frames[k] = replace(frames[k], left=left.copy(), right=right.copy())
    has_images = []

    def sensor(prev_frame: Frame, frame: Frame) -> NoMeasurement:
        """Note whether there are images of the times of the previous and the current frame."""
        has_images.append((prev_frame.left is not None, frame.left is not None))
        return NoMeasurement("noted")

    odometry = pv.StereoOdometry(sequence.camera, sensors=[sensor])
    motions = [odometry.step(frame) for frame in frames]
    true = relative_motions(sequence.truth.T_world_cam)
    assert {motion.status for motion in motions[6:10]} == {pv.Status.TOO_FEW_TRACKS}
    assert motions[10].status is pv.Status.RECOVERED
    is_seen = [True] * 6 + [False] * 4 + [True] * 2
    assert has_images == list(pairwise(is_seen))
    for motion, T_true in zip(motions[6:11], true[5:10], strict=True):
        assert normalized_error_squared(T_true, motion.T_curr_prev, motion.cov) < 22.5
    assert motions[11].status is OK


def test_frozen_images_with_noise_are_bridged(tmp_path: Path) -> None:
    """For as long as the camera can hardly have come to rest since the last image before them."""
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 12))
    frames = [replace(frame, stamp_ns=20_000_000 * frame.index) for frame in sequence]
    rng = np.random.default_rng(0)

    def again(image: Image | None) -> Image:
        assert image is not None
        noise = rng.integers(-1, 2, image.shape)
        return np.clip(image.astype(int) + noise, 0, 255).astype(np.uint8)

    for k in (6, 7, 8):
        left = again(frames[5].left)
        frames[k] = replace(frames[k], left=left, right=again(frames[5].right))
    odometry = pv.StereoOdometry(sequence.camera)
    motions = [odometry.step(frame) for frame in frames]
    assert {motion.status for motion in motions[6:9]} == {pv.Status.TOO_FEW_TRACKS}
    assert {motion.missing for motion in motions[6:9]} == {
        (MissingData(Defect.REPEATED_IMAGES, 1, 1),)
    }
    assert motions[9].status is pv.Status.RECOVERED
    assert {motion.status for motion in motions[10:]} == {OK}


@pytest.mark.parametrize("sigma", [0.0, 1.5], ids=["the same bytes", "compressed anew"])
@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_a_video_whose_frames_were_doubled_has_the_same_path(
    tmp_path: Path, estimator: str, sigma: float
) -> None:
    """Not that of a camera at rest, whose every second motion is refused."""
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 12))
    rng = np.random.default_rng(0)

    def again(image: Image | None) -> Image:
        assert image is not None
        noisy = image + rng.normal(0.0, sigma, image.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)

    frames = []
    for frame in sequence:
        frames += [frame, replace(frame, left=again(frame.left), right=again(frame.right))]
    odometry = pv.StereoOdometry(sequence.camera, config={"estimator": estimator})
    motions = [
        odometry.step(replace(frame, index=k, stamp_ns=50_000_000 * k))
        for k, frame in enumerate(frames)
    ]
    true = se3.inverse(sequence.truth.T_world_cam[0]) @ sequence.truth.T_world_cam[-1]
    length = np.linalg.norm(true[:3, 3])
    found = np.linalg.norm(motions[-2].T_world_cam[:3, 3])
    step = length / 11
    assert abs(found - length) < 1.5 * step  # the first repetition looks like rest
    assert motions[-1].missing == (MissingData(Defect.REPEATED_IMAGES, 1, 1),)


def test_black_images_are_not_counted_as_repeated(tmp_path: Path) -> None:
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 8))
    odometry = pv.StereoOdometry(sequence.camera)
    for frame in sequence:
        assert frame.left is not None
        if frame.index >= 5:
            black = np.zeros_like(frame.left)
            frame = replace(frame, left=black, right=black.copy())
        motion = odometry.step(frame)
        assert motion.missing == ()
    assert motion.status is pv.Status.TOO_FEW_TRACKS


def test_in_a_blackout_the_attitude_by_the_gyro_is_consistent() -> None:
    """From the third frame on, when its bias is hardly known, for 15 frames: the mean of the
    squared errors over 20 drives lies in the 99.9 % interval of χ²(3)."""
    squared = []
    for seed in range(20):
        rng = np.random.default_rng([5, seed])
        path = SmoothPath.drawn(rng, swing=0.05)
        frames, truth = inertial_drive(rng, 17, path, points=60)
        odometry = pv.StereoOdometry(
            CAMERA,
            noise=StudentT(dof=np.inf, scale=0.3**2 * np.eye(4)),
            imu=CALIBRATION,
            config={"self_calibration": False, "estimator": "two-frame"},
        )
        for frame in frames:
            seen = frame if frame.index < 2 else replace(blind_frame(frame.index), imu=frame.imu)
            motion = odometry.step(seen)
        error = so3.log(truth[-1][:3, :3].T @ motion.T_world_cam[:3, :3])
        squared.append(error @ np.linalg.solve(motion.cov_cam_world[3:, 3:], error))
    low, high = chi2_interval(dof=3, count=20)
    assert low < np.mean(squared) < high


def test_features_are_found_again_in_images_that_are_prepared_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Behind a black frame, a step searches twice: from the previous frame, and from the last
    usable one."""
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 10))
    frames = list(sequence)
    black = np.zeros_like(frames[6].left)
    frames[6] = replace(frames[6], left=black, right=black.copy())
    prepared = []

    def counted(image: Image, config: TrackingConfig) -> Image:
        prepared.append(image)
        return high_pass(image, config)

    monkeypatch.setattr(preparation, "high_pass", counted)
    odometry = pv.StereoOdometry(sequence.camera)
    motions = [odometry.step(frame) for frame in frames]
    assert motions[7].status is pv.Status.RECOVERED
    assert len(prepared) == 2 * len(frames)


@pytest.mark.parametrize("seed", [0, 1])
def test_images_that_stand_still_but_for_noise_are_treated_as_dropped_frames(
    tmp_path: Path, seed: int
) -> None:
    """An encoder repeats a pair for seven frames, with ±1 grey level of noise: longer than it takes
    to give up a motion model that refuses all solves."""
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 16))
    frames = list(sequence)
    rng = np.random.default_rng(seed)
    for k in range(6, 13):
        noisy = []
        for image in (frames[5].left, frames[5].right):
            assert image is not None
            levels = image.astype(np.int64) + rng.integers(-1, 2, image.shape)
            noisy.append(np.clip(levels, 0, 255).astype(np.uint8))
        frames[k] = replace(frames[k], left=noisy[0], right=noisy[1])
    # A camera that is too heavy to stop within a step.
    heavy = {"acceleration_m_s2": 0.1, "angular_acceleration_rad_s2": 0.1}
    has_images = []

    def sensor(prev_frame: Frame, frame: Frame) -> NoMeasurement:
        """Note whether there is an image of the time of the frame."""
        has_images.append(frame.left is not None)
        return NoMeasurement("noted")

    odometry = pv.StereoOdometry(sequence.camera, config={"motion_model": heavy}, sensors=[sensor])
    motions = [odometry.step(frame) for frame in frames]
    true = relative_motions(sequence.truth.T_world_cam)
    assert {motion.status for motion in motions[6:13]} == {pv.Status.TOO_FEW_TRACKS}
    assert has_images == [True] * 5 + [False] * 7 + [True] * 3
    for motion, T_true in zip(motions[6:13], true[5:12], strict=True):
        assert normalized_error_squared(T_true, motion.T_curr_prev, motion.cov) < 22.5
    assert motions[-1].status is OK


def test_images_of_a_camera_at_rest_may_be_equal(tmp_path: Path) -> None:
    """As a simulator gives them, without noise."""
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 2))
    odometry = pv.StereoOdometry(sequence.camera)
    motions = []
    for k in range(6):
        again = next(iter(sequence))
        motions.append(odometry.step(replace(again, index=k, stamp_ns=k * FRAME_NS)))
    assert {motion.status for motion in motions[1:]} == {OK}
    np.testing.assert_allclose(motions[-1].T_curr_prev, np.eye(4), atol=1e-4)


WHOLE = np.zeros((HEIGHT_PX, WIDTH_PX), np.uint8)
TWICE = StereoFeatures(np.array([4, 7, 4]), np.ones((3, 4)))


def turn_rates(stamps_ns: list[int], rates_rad_s: list[float]) -> ImuSamples:
    """Return samples of a gyro that turns about one axis, without an accelerometer."""
    gyro_rad_s = np.outer(rates_rad_s, [0.0, 1.0, 0.0])
    return ImuSamples(np.array(stamps_ns), gyro_rad_s, np.full((len(stamps_ns), 3), np.nan))


@pytest.mark.parametrize(
    ("frame", "fragment"),
    [
        (
            Frame(5, 0, WHOLE, right=WHOLE.astype(np.uint16)),
            "its right image is uint16 of shape (370, 1226)",
        ),
        (
            Frame(5, 0, np.dstack([WHOLE] * 3), right=WHOLE),
            "its left image is uint8 of shape (370, 1226, 3)",
        ),
        (
            Frame(5, 0, WHOLE[::2, ::2], right=WHOLE[::2, ::2]),
            "its left image is 613×185 px, the camera's are 1226×370",
        ),
        (Frame(5, 0, WHOLE, right=WHOLE[:-1]), "its right image is 1226×369 px"),
        (Frame(5, 0, features=TWICE), "two of its features have the same identity"),
        (Frame(5, 0), "it has neither images nor features"),
        (Frame(5, 0, WHOLE), "its right image is missing"),
        (Frame(5, 0.1, WHOLE, right=WHOLE), "its stamp_ns is 0.1"),  # type: ignore[arg-type]
        (
            Frame(5, 0, WHOLE, right=WHOLE, imu=turn_rates([1, 0], [0.0, 0.0])),
            "its IMU samples are not in the order",
        ),
        (
            Frame(
                5,
                0,
                WHOLE,
                right=WHOLE,
                imu=ImuSamples(np.array([0, 1]), np.zeros((1, 3)), np.zeros((2, 3))),
            ),
            "2 IMU samples have angular rates of shape (1, 3)",
        ),
        (
            Frame(5, 0, features=StereoFeatures(np.arange(3), np.ones((2, 4)))),
            "it has 3 identities and pixels of shape (2, 4)",
        ),
    ],
)
def test_frames_that_no_camera_of_this_kind_gives_are_refused(frame: Frame, fragment: str) -> None:
    """Images of half the size would give motions that look good, and are wrong."""
    with pytest.raises(InputError) as caught:
        pv.StereoOdometry(CAMERA).step(frame)
    assert str(caught.value).startswith(f"frame 5: {fragment}")
    assert caught.value.cure


def test_a_sample_without_a_finite_turn_rate_is_missing_and_refuses_nothing() -> None:
    """The check of a frame refuses it, but a step leaves the sample out and says so."""
    frames = drive(np.random.default_rng(20), 2)
    stamps_ns = [frames[1].stamp_ns - FRAME_NS, frames[1].stamp_ns]
    frames[1] = replace(frames[1], imu=turn_rates(stamps_ns, [0.0, np.nan]))
    with pytest.raises(InputError, match="frame 1: an IMU sample of it has no finite angular rate"):
        check_frame(frames[1], CAMERA)
    motion = run(frames)[1]
    assert motion.status is OK
    assert motion.missing == (MissingData(Defect.RATE_NOT_FINITE, 1, 2),)


def test_images_are_checked_even_if_the_camera_has_no_size() -> None:
    odometry = pv.StereoOdometry(replace(CAMERA, size_px=None))
    with pytest.raises(InputError, match="frame -1: its index is negative"):
        odometry.step(Frame(-1, 0, WHOLE, right=WHOLE))
    with pytest.raises(InputError, match="frame 0: its images are 1226×370 and 1226×369 px"):
        odometry.step(Frame(0, 0, WHOLE, right=WHOLE[:-1]))
    with pytest.raises(InputError, match="frame 0: its images have no pixels"):
        odometry.step(Frame(0, 0, WHOLE[:0], right=WHOLE[:0]))
    odometry.step(Frame(0, 0, WHOLE, right=WHOLE))
    with pytest.raises(
        InputError, match="frame 1: its images are 613×185 px, not 1226×370 px as before"
    ):
        odometry.step(Frame(1, 10**8, WHOLE[::2, ::2], right=WHOLE[::2, ::2]))


def test_images_that_overwrite_those_before_are_refused() -> None:
    """What is compared with itself looks like a camera that froze."""
    odometry = pv.StereoOdometry(CAMERA)
    left = WHOLE.copy()
    right = WHOLE.copy()
    odometry.step(Frame(0, 0, left, right=right))
    with pytest.raises(
        InputError,
        match="frame 1: an image of it is in the same memory as that of frame 0",
    ):
        odometry.step(Frame(1, 10**8, left, right=WHOLE.copy()))
    assert odometry.step(Frame(1, 10**8, left.copy(), right=right.copy())).status is not OK


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_a_pose_that_was_returned_may_be_written_to(estimator: str) -> None:
    """Into millimetres, say."""
    frames = drive(np.random.default_rng(4), 6)
    config = PLAIN.model_copy(update={"estimator": estimator})
    motions = run(frames, config)
    odometry = pv.StereoOdometry(CAMERA, config=config)
    for frame, expected in zip(frames, motions, strict=True):
        motion = odometry.step(frame)
        np.testing.assert_array_equal(motion.T_world_cam, expected.T_world_cam)
        motion.T_world_cam[:3, 3] *= 1000.0
        motion.cov_cam_world[:] = np.nan


def test_images_that_overwrite_those_of_the_last_usable_frame_are_refused(tmp_path: Path) -> None:
    """A driver with two buffers: behind a black frame, features are searched for that are in the
    buffer which it has just filled again."""
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 6))
    frames = list(sequence)
    black = np.zeros_like(frames[4].left)
    frames[4] = replace(frames[4], left=black, right=black.copy())
    frames[5] = replace(frames[5], left=frames[3].left, right=frames[3].right)
    odometry = pv.StereoOdometry(sequence.camera)
    for frame in frames[:5]:
        odometry.step(frame)
    with pytest.raises(InputError, match="in the same memory as that of frame 3"):
        odometry.step(frames[5])


@pytest.mark.parametrize("is_overwritten", [False, True])
def test_images_that_overwrite_those_to_be_connected_give_these_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, is_overwritten: bool
) -> None:
    """Unlike the last usable frame of a dead-reckoned path, that one is not needed any more."""
    sequence = pv.open_sequence(write_wall(tmp_path / "wall", 6))
    frames = list(sequence)
    odometry = pv.StereoOdometry(sequence.camera)
    for frame in frames[:5]:
        odometry.step(frame)
    state = odometry.state
    assert state is not None
    # As if frame 4 had been dead-reckoned, and features of frame 3 not found in it.
    velocity = OutageVelocity(0.1, mean_twist=np.zeros(6), sigma=np.ones(6), T_curr_end=np.eye(4))
    before = replace(state, frame=frames[3])
    odometry._state = replace(state, outage=Outage(before, DeadReckonedPath.none(), velocity))
    found = []
    window_step = WindowEstimator.step

    def spy(*values: Any, reacquired: Any, **keywords: Any) -> Any:
        found.append(reacquired is not None)
        return window_step(*values, reacquired=reacquired, **keywords)

    monkeypatch.setattr(WindowEstimator, "step", spy)
    images = frames[3] if is_overwritten else frames[5]
    odometry.step(replace(frames[5], left=images.left, right=images.right))
    assert found == [not is_overwritten]


@pytest.mark.parametrize("estimator", ["two-frame", "window"])
def test_pixels_may_count_from_the_principal_point(estimator: str) -> None:
    """A front end of one's own may have them so, and no size of its images."""
    camera = replace(CAMERA, cu_px=0.0, cv_px=0.0, size_px=None)
    odometry = pv.StereoOdometry(camera, config={"estimator": estimator})
    origin_px = np.array([CAMERA.cu_px, CAMERA.cv_px, CAMERA.cu_px, CAMERA.cv_px])
    for frame in drive(np.random.default_rng(0), 8):
        assert frame.features is not None
        features = StereoFeatures(frame.features.ids, frame.features.pixels - origin_px)
        motion = odometry.step(replace(frame, features=features))
        assert motion.status in (pv.Status.FIRST, pv.Status.OK)
        assert np.isfinite(motion.cov_cam_world).all()


@pytest.mark.parametrize("seed", range(3))
def test_points_kilometres_away_give_statuses(seed: int) -> None:
    """They fix the rotation and next to nothing else; the disparity filter is then nearly
    singular."""
    rng = np.random.default_rng(seed)
    odometry = pv.StereoOdometry(CAMERA)
    points = rng.uniform([-3000.0, -750.0, 2400.0], [3000.0, 750.0, 3600.0], (100, 3))
    for k in range(20):
        pixels = CAMERA.project(points - [0.0, 0.0, 1.0 * k]) + rng.normal(0.0, 0.5, (100, 4))
        motion = odometry.step(Frame(k, k * 10**8, features=StereoFeatures(np.arange(100), pixels)))
        if k == 0:
            continue
        assert motion.status is not pv.Status.NOT_CONVERGED
        assert np.linalg.eigvalsh(motion.cov)[0] > 0.0
        rotation = so3.log(motion.T_curr_prev[:3, :3])  # the true one is none
        assert rotation @ np.linalg.solve(motion.cov[3:, 3:], rotation) < 5.0**2


def test_frames_that_cannot_follow_the_one_before_are_refused() -> None:
    frames = drive(np.random.default_rng(0), 2)
    odometry = pv.StereoOdometry(CAMERA)
    odometry.step(frames[0])
    with pytest.raises(InputError, match=r"frame 1: its stamp, .*, is 100 ns after"):
        odometry.step(replace(frames[1], stamp_ns=frames[0].stamp_ns + 100))
    with pytest.raises(
        InputError, match="frame 1: one of it and the frame before has images, the other features"
    ):
        odometry.step(Frame(1, frames[1].stamp_ns, WHOLE, right=WHOLE))
    assert odometry.step(frames[1]).status is OK


@pytest.mark.parametrize(
    ("changes", "fragment"),
    [
        ({"fu_px": np.nan}, "fu_px is nan"),
        ({"fv_px": 0.0}, "fv_px is 0 px"),
        ({"baseline_m": -0.5}, "swapped"),
    ],
)
def test_a_camera_that_there_cannot_be_is_refused(changes: dict[str, float], fragment: str) -> None:
    with pytest.raises(InputError, match=fragment):
        pv.StereoOdometry(replace(CAMERA, **changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("C_cam_imu", "noise", "fragment"),
    [
        (2.0 * np.eye(3), 1e-4, "T_cam_imu: this is not a rotation matrix"),
        (np.diag([1.0, 1.0, -1.0]), 1e-4, "T_cam_imu: this is not a rotation matrix"),
        (np.eye(3), np.nan, "gyro_noise_rad_s_sqrt_hz: is nan"),
        (np.eye(3), -1.0, "gyro_noise_rad_s_sqrt_hz: is -1"),
    ],
)
def test_an_imu_that_there_cannot_be_is_refused(
    C_cam_imu: FloatArray, noise: float, fragment: str
) -> None:
    with pytest.raises(InputError, match=fragment):
        ImuCalibration(se3.from_parts(C_cam_imu, np.zeros(3)), noise, 1e-3)


def test_a_model_of_another_camera_is_refused() -> None:
    model = model_of(["x", "y", "row_offset"])
    model.camera = replace(CAMERA, fu_px=100.0)
    with pytest.raises(InputError, match="camera"):
        pv.StereoOdometry(CAMERA, model)


def test_a_gyro_prior_is_refused_for_a_method_that_takes_none() -> None:
    with pytest.raises(ValueError, match="the alignment takes no prior"):
        pv.OdometryConfig(gyro=GyroConfig(prior=True), solver=SolverConfig(method="alignment"))


def model_of(columns: Sequence[str], exponent: float = 4.0) -> NearestNeighbors:
    """A noise model learned from random places and errors."""
    rng = np.random.default_rng(13)
    places = rng.normal(size=(400, len(columns)))
    metric = Metric.fitted(places, tuple(columns))
    return NearestNeighbors(20, exponent).fit(places, np.exp(rng.normal(size=400)), metric=metric)


def test_the_features_of_the_last_step_are_there_to_read() -> None:
    """These are the corrected tracks: their φ, which of them the solve used, and their weights."""
    space = prediction_space(["disparity", "place"])
    odometry = pv.StereoOdometry(CAMERA, predictors=space)
    assert odometry.phi.shape == (0, 3)
    frames = drive(np.random.default_rng(14), 12, sigma_px=0.5)
    for frame in frames:
        odometry.step(frame)
        tracks = odometry.tracks
        count = len(tracks)
        assert odometry.phi.shape == (count, 3)
        assert odometry.used.shape == odometry.weights.shape == (count,)
        np.testing.assert_allclose(
            odometry.phi[:, 0], np.log(tracks.curr_px[:, 0] - tracks.curr_px[:, 2])
        )
        np.testing.assert_allclose(
            odometry.phi[:, 1], (tracks.curr_px[:, 0] - CAMERA.cu_px) / CAMERA.fu_px
        )
        assert (odometry.weights[~odometry.used] == 0.0).all()
    assert 0.5 < odometry.used.mean() <= 1.0
    assert odometry.weights.max() > 0.5


def test_each_step_says_how_many_features_it_used_and_how_many_of_them_are_out_of_domain() -> None:
    odometry = pv.StereoOdometry(CAMERA, Homesick())
    frames = drive(np.random.default_rng(14), 5, sigma_px=0.5)
    for k, motion in enumerate(odometry.step(frame) for frame in frames):
        assert motion.num_used == odometry.used.sum()
        assert motion.num_out_of_domain == (-(-motion.num_used // 3) if k else None)


def test_mismatches_that_ransac_rejects_are_not_used() -> None:
    frames = drive(np.random.default_rng(15), 3)
    odometry = pv.StereoOdometry(CAMERA)
    for frame in frames[:2]:
        odometry.step(frame)
    features = frames[2].features
    assert features is not None
    pixels = features.pixels.copy()
    pixels[:30, 1::2] += 40.0
    assert odometry.step(replace(frames[2], features=replace(features, pixels=pixels))).status is OK
    assert not odometry.used[np.isin(odometry.tracks.ids, features.ids[:30])].any()
    assert odometry.phi.shape == (len(odometry.tracks), 0)


def test_predictors_change_no_motion_under_static_noise() -> None:
    """They are computed for whoever reads them."""
    frames = drive(np.random.default_rng(16), 6)
    space = prediction_space(["residual_flow", "age"])
    plain = pv.StereoOdometry(CAMERA)
    with_predictors = pv.StereoOdometry(CAMERA, predictors=space)
    for frame in frames:
        motion = plain.step(frame)
        other = with_predictors.step(frame)
        assert motion.T_curr_prev.tobytes() == other.T_curr_prev.tobytes()


def last_residuals_of(frames: Sequence[Frame]) -> list[tuple[pv.Status, FloatArray, FloatArray]]:
    """Return status, predicted and expected ``last_residual`` [N] of every step; the expected one
    is computed feature by feature."""
    odometry = pv.StereoOdometry(
        CAMERA, config=TWO_FRAMES, predictors=prediction_space(["last_residual"])
    )
    steps = []
    left: dict[int, float] = {}
    for frame in frames:
        motion = odometry.step(frame)
        tracks = odometry.tracks
        T_curr_prev = motion.T_curr_prev
        expected = [np.log(0.1 + left[k]) if k in left else np.nan for k in tracks.ids.tolist()]
        steps.append((motion.status, odometry.phi[:, 0], np.array(expected)))
        left = {}
        if motion.status is OK:
            for k, prev, curr in zip(
                tracks.ids.tolist(), tracks.prev_px, tracks.curr_px, strict=True
            ):
                point = se3.transform(T_curr_prev, CAMERA.triangulate(prev))
                left[k] = float(np.linalg.norm(curr - CAMERA.project(point)))
    return steps


def test_features_come_with_the_residual_of_the_step_before() -> None:
    """Outliers of RANSAC have one, too; new features have none, nor has any in the first step."""
    frames = drive(np.random.default_rng(18), 10)
    features = frames[5].features
    assert features is not None
    pixels = features.pixels.copy()
    pixels[:30, 1::2] += 40.0
    frames[5] = replace(frames[5], features=replace(features, pixels=pixels))
    steps = last_residuals_of(frames)[1:]
    for status, predicted, expected in steps:
        assert status is OK
        np.testing.assert_allclose(predicted, expected, rtol=1e-9, atol=1e-12)
    assert np.isnan(steps[0][1]).all()
    for _, predicted, _ in steps[1:]:
        assert 0.0 < np.isnan(predicted).mean() < 0.5
    assert (steps[5][1] > np.log(40.0)).sum() > 20


def test_after_a_refused_step_no_residual_is_known() -> None:
    """Features swap places in frame 6, and all but five are missing in frame 12. The frames
    behind them lead back to those before, and have their residuals."""
    frames = drive(np.random.default_rng(19), 18)
    features = frames[6].features
    assert features is not None
    order = np.random.default_rng(0).permutation(len(features.ids))
    frames[6] = replace(frames[6], features=replace(features, pixels=features.pixels[order]))
    frames[12] = with_features(frames[12], 5)
    steps = last_residuals_of(frames)
    refused = [k for k, (status, _, _) in enumerate(steps) if status not in (OK, FIRST)]
    assert refused == [6, 7, 12, 13]
    for k in (7, 13):
        assert steps[k][0] is pv.Status.RECOVERED
        assert np.isfinite(steps[k][1]).any()
    for k, (_, predicted, expected) in enumerate(steps):
        if k in (7, 13):
            continue
        np.testing.assert_allclose(predicted, expected, rtol=1e-9)
        assert np.isnan(predicted).all() == (k <= 1 or k - 1 in refused)


@pytest.mark.parametrize(("exponent", "same"), [(0.0, True), (4.0, False)])
def test_a_learned_model_gets_its_columns(exponent: float, same: bool) -> None:
    """It chooses the predictors; with γ = 0 it is the Student-t that it scales, to the last bit."""
    frames = drive(np.random.default_rng(17), 8)
    learned = pv.StereoOdometry(CAMERA, model_of(["x", "y", "row_offset"], exponent))
    static = pv.StereoOdometry(CAMERA, StudentT())
    assert learned.predictors.names == ("place", "row_offset")
    pairs = [(learned.step(frame), static.step(frame)) for frame in frames]
    assert all(motion.status is OK for motion, _ in pairs[1:])
    assert all((a.T_curr_prev.tobytes() == b.T_curr_prev.tobytes()) is same for a, b in pairs[1:])


@pytest.mark.parametrize(
    "names", [["row_offset", "place"], ["place"], ["place", "row_offset", "age"], []]
)
def test_predictors_unlike_those_of_the_model_are_refused(names: list[str]) -> None:
    """Other ones, or the same in another order: the model would take one for the other."""
    with pytest.raises(
        InputError, match="columns are x, y, row_offset, in this order, but it gets"
    ):
        pv.StereoOdometry(
            CAMERA, model_of(["x", "y", "row_offset"]), predictors=prediction_space(names)
        )


def test_a_list_of_predictors_is_refused() -> None:
    given: Any = [PREDICTORS["age"]]
    with pytest.raises(InputError, match=r"^predictors: is \[(?s:.*)Give a PredictionSpace"):
        pv.StereoOdometry(CAMERA, predictors=given)


@pytest.mark.parametrize("given", [lambda prev, curr: None, None])
def test_sensors_are_given_as_a_list(given: Any) -> None:
    with pytest.raises(InputError, match=r"^sensors: is (?s:.*)Give a list, such as sensors="):
        pv.StereoOdometry(CAMERA, sensors=given)


def test_a_predictor_that_nobody_knows_is_refused() -> None:
    with pytest.raises(InputError, match="its predictor speed is not known"):
        pv.StereoOdometry(CAMERA, model_of(["x", "y", "speed"]))


def walk(
    path: Path, estimator: Literal["two-frame", "window"] = "window"
) -> tuple[list[pv.MotionEstimate], FloatArray]:
    """Return the motions of a recording, and its true poses."""
    sequence = pv.open_sequence(path)
    odometry = pv.StereoOdometry(sequence.camera, imu=sequence.imu, config={"estimator": estimator})
    motions = [odometry.step(frame) for frame in sequence]
    assert sequence.truth is not None
    return motions, sequence.truth.T_world_cam


FIRST_OF_ALL = pv.MotionEstimate(np.eye(4), np.zeros((6, 6)), FIRST, 0)


def trajectory(motions: list[pv.MotionEstimate]) -> tuple[FloatArray, FloatArray]:
    """Return T_world_cam, and the covariance of the left perturbation of T_cam_world, of a first
    frame and those after it."""
    T_curr_prev = np.array([motion.T_curr_prev for motion in motions[1:]])
    covariances = drift_covariances(
        T_curr_prev,
        np.array([motion.cov for motion in motions[1:]]),
        common_mode=np.array([motion.common_mode for motion in motions[1:]]),
        path_cross_cov=np.array([motion.path_cross_cov for motion in motions[1:]]),
    )
    return se3.chain_motions(T_curr_prev), covariances


def metrics_of(path: Path, estimator: Literal["two-frame", "window"] = "window") -> Metrics:
    motions, truth = walk(path, estimator)
    return evaluate(trajectory(motions)[0], truth)


@pytest.mark.data
def test_a_camera_at_rest_stays_there(data_root: Path) -> None:
    """EuRoC: drift below 1 cm, and within 3σ of the compounded covariance on every axis.

    It trembles by milliradians on the way, but rests at both ends; its truth wanders by more than
    that.
    """
    T_world_cam, cov = trajectory(walk(data_root / "euroc/V1_01_micro")[0])
    drift = se3.log(se3.inverse(T_world_cam[-1]))
    assert np.linalg.norm(drift[:3]) < 0.01
    assert (np.abs(drift) < 3.0 * np.sqrt(np.diagonal(cov[-1]))).all()


@pytest.mark.data
@pytest.mark.parametrize(
    "name",
    [
        "26_drive_0001",
        "26_drive_0005",
        "26_drive_0009",
        "26_drive_0027",
        "26_drive_0036",
        "30_drive_0027",
    ],
)
def test_no_step_of_the_track_drives_is_off_by_a_metre(name: str, data_root: Path) -> None:
    """Two frames alone; frames with six, one and no tracks among them. The first step, when no
    speed is known, may be if it says so."""
    motions, truth = walk(data_root / f"kitti_tracks/2011_09_{name}.npz", "two-frame")
    assert all(is_proper(motion) for motion in motions[1:])
    pairs = zip(motions[1:], relative_motions(truth), strict=True)
    errors = np.array([motion_error(motion.T_curr_prev, T_true) for motion, T_true in pairs])
    assert np.linalg.norm(errors[1:, :3], axis=1).max() < 1.0
    assert np.linalg.norm(errors[0, :3]) < max(1.0, 2.0 * np.sqrt(motions[1].cov[2, 2]))


@pytest.mark.data
@pytest.mark.slow
def test_drift_on_kitti_06(data_root: Path) -> None:
    assert (metrics_of(data_root / "kitti_odometry/sequences/06").short_t_percent or np.inf) <= 1.0


@pytest.mark.parametrize(("estimator", "limit"), [("two-frame", 0.016), ("window", 0.021)])
@pytest.mark.data
@pytest.mark.slow
def test_rotation_on_kitti_raw_0005(
    estimator: Literal["two-frame", "window"], limit: float, data_root: Path
) -> None:
    """LIBVISO2, ORB-SLAM2, Basalt and a plain odometry have 0.015 to 0.031 °/m."""
    path = data_root / "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync"
    assert (metrics_of(path, estimator).short_r_deg_per_m or np.inf) <= limit


def test_the_first_steps_of_a_loose_rig_are_covered() -> None:
    """The right camera turns by 2 px of yaw from frame to frame, 20 times the prior. A step of two
    frames that shows it is solved again with what it shows, so that it claims enough: the median of
    twenty worlds is 4.9, where 5.3 is consistent; it was 9.4."""
    squared = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        frames = list(drive(rng, 2))
        for frame in frames:
            features = frame.features
            assert features is not None
            features.pixels[:, 2] += 2.0 * rng.normal()
        odometry = pv.StereoOdometry(CAMERA, config=TWO_FRAMES)
        step = [odometry.step(frame) for frame in frames][-1]
        assert step.status is pv.Status.OK
        error = motion_error(step.T_curr_prev)
        squared.append(error @ np.linalg.solve(step.cov, error))
    assert np.median(squared) < 7.0
