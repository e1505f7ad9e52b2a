"""The IMU in the window: its equations, its gauge, its start, its consistency, and its faults."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import pairwise

import numpy as np
import pytest
from scipy.stats import chi2

import inertial_worlds
import worlds
from inertial_worlds import CALIBRATION, GRAVITY, SmoothPath, inertial_drive
from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.config import OdometryConfig
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.window.equations import POSE, RIG
from probevo.estimation.window.estimator import WindowEstimator
from probevo.estimation.window.inertial import ImuStatus, Inertial
from probevo.estimation.window.inertial_equations import linearized, walk_variances
from probevo.estimation.window.inertial_prediction import predicted
from probevo.estimation.window.inertial_start import InertialFit
from probevo.estimation.window.inertial_states import (
    COMMON,
    STATE,
    InertialStates,
    moved,
)
from probevo.estimation.window.inertial_states import (
    GRAVITY as GRAVITY_DIMENSIONS,
)
from probevo.estimation.window.inertial_steps import (
    NO_SOLUTION,
    UNKNOWN_GRAVITY,
    UNTESTABLE,
    UNTESTED_STEP,
    _motions_by_imu_only,
    initialize_states,
    preintegrate_samples,
    system_of,
    without_imu,
)
from probevo.estimation.window.marginalization import without_blind
from probevo.estimation.window.window import Window
from probevo.geometry import se3, so3
from probevo.geometry.uncertainty import squared_mahalanobis
from probevo.measurements.imu_reason import ImuFault
from probevo.measurements.preintegration import Preintegration
from probevo.measurements.variables import pose_of
from probevo.noise import StudentT
from probevo.odometry import StereoOdometry
from probevo.sequences.frame import Frame, ImuSamples
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.missing_data import Defect
from worlds import CAMERA, FRAME_NS, blind_frame, tracks_between

SIGMA_PX = 0.3


def odometry(
    calibration: ImuCalibration | None = CALIBRATION, *, frames: int = 8
) -> StereoOdometry:
    config = {
        "estimator": "window",
        "self_calibration": False,
        "window": {"correlation": 0.0, "frames": frames},
    }
    noise = StudentT(dof=np.inf, scale=SIGMA_PX**2 * np.eye(4))
    return StereoOdometry(CAMERA, noise, calibration, config)


def drive_of(seed: int, frames: int, *, swing: float = 1.0) -> tuple[list[Frame], FloatArray]:
    rng = np.random.default_rng([70, seed])
    path = SmoothPath.drawn(rng, swing=swing)
    return inertial_drive(rng, frames, path, points=60, sigma_px=SIGMA_PX)


def states_of(window: Window) -> InertialStates:
    assert window.inertial.states is not None
    return window.inertial.states


def factors_of(window: Window) -> list[Preintegration]:
    return [factor for factor in window.inertial.factors if factor is not None]


@pytest.fixture(scope="module")
def run() -> tuple[list[Frame], FloatArray, Window, list[MotionEstimate]]:
    """A drive of 20 frames, its truth, the window at its end, and the estimates."""
    frames, truth = drive_of(0, 20)
    by = odometry()
    estimates = [by.step(frame) for frame in frames]
    assert by.window is not None
    return frames, truth, by.window, estimates


Run = tuple[list[Frame], FloatArray, Window, list[MotionEstimate]]


def test_jacobians_are_central_differences(run: Run) -> None:
    """Of all factors of a window, at values that are their own linearisation points."""
    window = run[2]
    states = states_of(window)
    window = replace(window, T_linear=window.T_cam_world)
    states = replace(
        states,
        velocity_linear=states.velocity,
        gravity_linear=states.gravity,
        gravity_offset=np.zeros(2),
        information=np.eye(len(states.information)),
    )
    factors = factors_of(window)
    first = np.arange(len(factors))
    _, jacobian = linearized(window, states, factors, first)
    step = 1e-6

    def residuals(at: int, column: int, size: float) -> FloatArray:
        xi = np.zeros((len(window), POSE))
        x = np.zeros(COMMON + STATE * len(window))
        if column < 2 * POSE:
            xi[at + column // POSE, column % POSE] = size
        elif column < 2 * (POSE + STATE):
            x[COMMON + STATE * at + column - 2 * POSE] = size
        else:
            x[column - 2 * (POSE + STATE)] = size
        turned = replace(window, T_cam_world=se3.exp(xi) @ window.T_cam_world)
        return linearized(turned, moved(states, x), factors, first)[0][at]

    for at in (0, 3, 6):
        for column in range(jacobian.shape[2]):
            change = residuals(at, column, step) - residuals(at, column, -step)
            np.testing.assert_allclose(
                jacobian[at, :, column], change / (2.0 * step), atol=2e-4, rtol=2e-3
            )


def test_gravity_velocity_and_biases_are_found(run: Run) -> None:
    """Errors of the states at the end of the drive are within four of their standard deviations."""
    window = run[2]
    states = states_of(window)
    turned = so3.log(_shortest_turn(states.gravity, GRAVITY))
    sigma = np.sqrt(np.diag(states.cov))
    assert np.linalg.norm(turned) < 4.0 * np.linalg.norm(sigma[:2])
    assert np.linalg.norm(turned) < 0.02


def _shortest_turn(start: FloatArray, end: FloatArray) -> FloatArray:
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis) / (np.linalg.norm(start) * np.linalg.norm(end))
    return so3.exp(axis / max(float(np.linalg.norm(axis)), 1e-12) * np.arcsin(sine))


def test_no_information_arises_about_yaw_and_place(run: Run) -> None:
    """Along a turn of the world together with gravity and along its shifts xᵀ H x is below 1e-9 of
    that along a random direction, after twelve marginalisations; a tilt against gravity is seen.

    The prior that holds the first pose knows where the world is: it is taken away from the start.
    """
    frames, _ = drive_of(1, 20)
    by = odometry()
    by.step(frames[0])
    for frame in frames[1:8]:
        by.step(frame)
    window = by.window
    assert window is not None
    states = states_of(window)
    without_prior = replace(
        states,
        coupling=np.zeros_like(states.coupling),
        information=np.zeros_like(states.information),
    )
    # Linearisation points differ from the values: the gauge must hold none the less.
    rng = np.random.default_rng(71)
    xi = 1e-3 * rng.normal(size=(len(window), POSE))
    elsewhere = replace(
        window,
        T_cam_world=se3.exp(xi) @ window.T_cam_world,
        inertial=replace(window.inertial, states=without_prior),
    )
    system = system_of(elsewhere)
    assert system is not None
    directions = _gauge(elsewhere, without_prior)
    random = rng.normal(size=(len(system.hessian), 20))
    along_random = np.einsum("in,ij,jn->n", random, system.hessian, random)
    along_random /= np.square(random).sum(axis=0)
    along = np.abs(np.einsum("in,ij,jn->n", directions, system.hessian, directions))
    along /= np.square(directions).sum(axis=0)
    assert along.max() < 1e-9 * along_random.min()
    held = directions.copy()
    held[system.num_poses : system.num_poses + GRAVITY_DIMENSIONS] = 0.0
    tilted = np.einsum("in,ij,jn->n", held, system.hessian, held)
    down = GRAVITY / np.linalg.norm(GRAVITY)
    yaw = held[:, 3:] @ (states.gravity_linear / np.linalg.norm(states.gravity_linear))
    assert np.sort(tilted[3:])[1] > 1e-3 * along_random.min()
    assert abs(yaw @ system.hessian @ yaw) / (yaw @ yaw) < 1e-9 * along_random.min()
    assert down @ states.gravity > 9.0


def test_marginalisation_adds_no_information_about_yaw_and_place() -> None:
    """Along the same six directions the whole Hessian, landmarks and joint prior included, is below
    1e-9 of that along a random direction, after 60 marginalisations."""
    frames, _ = drive_of(7, 68)
    by = WindowEstimator(
        CAMERA,
        OdometryConfig.model_validate({"self_calibration": False, "window": {"correlation": 0.0}}),
    )
    window = Window.at_first_frame(0)
    window = replace(
        window,
        prior=replace(window.prior, information=np.zeros_like(window.prior.information)),
        inertial=Inertial(CALIBRATION),
    )
    noise = StudentT(dof=np.inf, scale=SIGMA_PX**2 * np.eye(4))
    guess = np.eye(4)
    guess[2, 3] = -0.8
    for prev, curr in pairwise(frames):
        sampled = preintegrate_samples(window, prev, curr)
        tracks = tracks_between(prev, curr)
        predicted_noise = noise.predict(np.zeros((len(tracks), 0)))
        motion = guess
        if sampled.inertial.prediction is not None:
            motion = sampled.inertial.prediction.T_curr_prev
        window = by.extend(sampled, curr.index, motion, tracks, predicted_noise)
        window = initialize_states(adjusted_without_gauge(by, window))
        if len(window) > 7:
            window = by.adjustment.without_oldest(window)
    assert window.frames[0] >= 60
    states = states_of(window)
    system = system_of(window)
    assert system is not None
    joint = system.hessian.copy()
    by_images = by.adjustment._system(replace(window, inertial=Inertial.none())).equations.hessian
    joint[: len(by_images), : len(by_images)] += by_images
    # In units in which each variable has the same information: they differ by 1e9 otherwise.
    unit = np.sqrt(np.diagonal(joint))
    joint /= np.outer(unit, unit)
    directions = unit[:, None] * _gauge(window, states)
    random = np.random.default_rng(73).normal(size=(len(joint), 20))
    along_random = np.einsum("in,ij,jn->n", random, joint, random)
    along_random /= np.square(random).sum(axis=0)
    along = np.abs(np.einsum("in,ij,jn->n", directions, joint, directions))
    along /= np.square(directions).sum(axis=0)
    assert along.max() < 1e-9 * along_random.min()


def _gauge(window: Window, states: InertialStates) -> FloatArray:
    """Return shifts and turns of the world, in the joint vector, [6K + 4 + 11 + 9K, 6]."""
    poses = se3.adjoint(window.T_linear).reshape(-1, POSE)
    inertial = np.zeros((len(states.vector), POSE))
    of_frames = inertial[COMMON:].reshape(len(window), STATE, POSE)
    # Under a turn −ω of the world, velocities and gravity move by −ω × v.
    of_frames[:, :3, 3:] = so3.wedge(states.velocity_linear)
    inertial[:GRAVITY_DIMENSIONS, 3:] = -states.across.T
    return np.vstack([poses, np.zeros((RIG, POSE)), inertial])


def adjusted_without_gauge(by: WindowEstimator, window: Window) -> Window:
    """Adjust with the oldest pose held for this solve only."""
    prior = window.prior
    held = np.zeros_like(prior.information)
    held[:POSE, :POSE] = 1e9 * np.eye(POSE)
    with_gauge = replace(
        prior,
        information=prior.information + held,
        vector=prior.vector + held @ window.offsets(),
    )
    for _ in range(2):
        window = by.adjustment.adjusted(replace(window, prior=with_gauge))
    return replace(window, prior=prior)


def test_a_prediction_and_its_covariance_are_those_of_the_images(run: Run) -> None:
    """The motion that the IMU alone predicts from frame to frame differs from the truth as its
    covariance says: average of squared distances over 40 steps of 4 drives within factor 1.6."""
    squared = []
    for seed in range(2, 6):
        frames, truth = drive_of(seed, 18)
        by = odometry()
        for k, frame in enumerate(frames):
            window = by.window
            if window is not None and window.inertial.is_used:
                states = states_of(window)
                factor = _factor_after(window, frames[k - 1], frame)
                motion = predicted(window, states, factor)
                true_motion = se3.inverse(truth[k]) @ truth[k - 1]
                error = se3.log(motion.T_curr_prev @ se3.inverse(true_motion))
                squared.append(error @ np.linalg.solve(motion.cov, error))
            by.step(frame)
    assert len(squared) >= 40
    assert 6.0 / 1.6 < np.mean(squared) < 6.0 * 1.6


def _factor_after(window: Window, prev: Frame, frame: Frame) -> Preintegration:
    sampled = preintegrate_samples(window, prev, frame)
    assert sampled.inertial.pending is not None
    return sampled.inertial.pending


def test_poses_with_imu_are_consistent_and_better_than_without() -> None:
    """The average NEES of the last pose over eight drives is 0.4 to 1.6 times its dimensions, and
    the error is below that of the images alone."""
    squared = []
    errors = []
    errors_without = []
    for seed in range(10, 18):
        frames, truth = drive_of(seed, 20)
        by = odometry()
        without = odometry(calibration=None)
        for frame in frames:
            last = by.step(frame)
            alone = without.step(replace(frame, imu=None))
        error = se3.log(se3.inverse(last.T_world_cam) @ truth[-1])
        squared.append(error @ np.linalg.solve(last.cov_cam_world, error))
        errors.append(np.linalg.norm(error[:3]))
        errors_without.append(np.linalg.norm((se3.inverse(truth[-1]) @ alone.T_world_cam)[:3, 3]))
    assert 0.4 * 6.0 < np.mean(squared) < 1.6 * 6.0
    assert np.mean(errors) < np.mean(errors_without)


def scaled_force(frame: Frame) -> Frame:
    if frame.imu is None:
        return frame
    return replace(frame, imu=replace(frame.imu, accel_m_s2=1.02 * frame.imu.accel_m_s2))


def scaled_rate(frame: Frame) -> Frame:
    if frame.imu is None:
        return frame
    return replace(frame, imu=replace(frame.imu, gyro_rad_s=1.03 * frame.imu.gyro_rad_s))


def unchanged(frame: Frame) -> Frame:
    return frame


def mounted_off(calibration: ImuCalibration) -> ImuCalibration:
    """By 2.5° and 6 cm."""
    off = se3.from_parts(so3.exp(np.array([0.02, -0.03, 0.025])), np.array([0.04, 0.04, -0.02]))
    return replace(calibration, T_cam_imu=off @ calibration.T_cam_imu)


@pytest.mark.parametrize(
    ("change", "calibration", "index", "expected"),
    [
        (scaled_force, CALIBRATION, 5, 1.0 / 1.02 - 1.0),
        (scaled_rate, CALIBRATION, 4, 1.0 / 1.03 - 1.0),
        (unchanged, mounted_off(CALIBRATION), 1, 0.03),
    ],
    ids=["accelerometer's scale", "gyro's scale", "mounting"],
)
def test_errors_of_the_calibration_that_pass_the_tests_are_learned(
    change: Callable[[Frame], Frame], calibration: ImuCalibration, index: int, expected: float
) -> None:
    """The IMU stays in use, the path is no worse than that of the images alone, and the direction
    of gravity is consistent: the average NEES over two drives is below three times its
    dimensions. What is off is found."""
    squared = []
    found_errors = []
    errors_m = []
    errors_without_m = []
    for seed in (80, 82):
        frames, truth = drive_of(seed, 24, swing=2.0)
        by = odometry(calibration)
        without = odometry(calibration=None)
        for frame in frames:
            last = by.step(change(frame))
            alone = without.step(replace(frame, imu=None))
        assert by.window is not None
        assert by.window.inertial.is_used
        states = states_of(by.window)
        found = by.window.inertial.calibration_errors_in_use
        assert found is not None
        assert abs(found.errors[index] - expected) < 4.0 * found.sigma[index]
        found_errors.append(found.errors[index])
        tilt = states.across.T @ so3.log(_shortest_turn(states.gravity, GRAVITY))
        squared.append(tilt @ np.linalg.solve(states.cov[:2, :2], tilt))
        errors_m.append(np.linalg.norm((se3.inverse(truth[-1]) @ last.T_world_cam)[:3, 3]))
        errors_without_m.append(np.linalg.norm((se3.inverse(truth[-1]) @ alone.T_world_cam)[:3, 3]))
    assert np.mean(found_errors) == pytest.approx(expected, rel=0.5)
    assert np.mean(squared) < 3.0 * 2.0
    assert np.mean(errors_m) < 1.1 * np.mean(errors_without_m)


def test_in_a_blackout_the_imu_dead_reckons_and_sigma_recovers() -> None:
    """After 1.2 s without images, 10 m, the error is within 3σ and 1 % of the distance; σ of the
    motion over four frames grows meanwhile, and is then as before."""
    frames, truth = drive_of(30, 40)
    by = odometry()
    estimates = []
    steps = []
    for frame in frames:
        is_dark = 18 <= frame.index < 30
        dark_frame = replace(blind_frame(frame.index), imu=frame.imu)
        estimates.append(by.step(dark_frame if is_dark else frame))
        if frame.index >= 4:
            _, cov = by.relative(frame.index, frame.index - 4)
            steps.append(float(np.sqrt(np.trace(cov[:3, :3]))))
    dark = estimates[18:30]
    assert all(estimate.status is not Status.OK for estimate in dark)
    sigma = [np.sqrt(np.trace(estimate.cov_cam_world[:3, :3])) for estimate in estimates]
    assert (np.diff(sigma[17:30]) > 0.0).all()
    start = truth[17] @ se3.inverse(estimates[17].T_world_cam)
    aligned = start @ dark[-1].T_world_cam
    error_m = np.linalg.norm((se3.inverse(truth[29]) @ aligned)[:3, 3])
    length_m = np.linalg.norm(truth[29, :3, 3] - truth[17, :3, 3])
    error = se3.log(se3.inverse(dark[-1].T_world_cam) @ truth[29])
    assert error_m < 0.01 * length_m
    assert (np.abs(error) < 3.0 * np.sqrt(np.diag(dark[-1].cov_cam_world))).all()
    assert steps[29 - 4] > 2.0 * steps[17 - 4]
    assert steps[-1] < 1.2 * steps[17 - 4]


def test_a_blackout_before_the_imu_is_used_makes_its_states_no_more_certain() -> None:
    """Once it is used, it turns what was dead-reckoned in the dark to where it is, and only there
    does it show velocities and the errors of its calibration."""
    dark = range(3, 6)
    squared = []
    for seed in range(3):
        rng = np.random.default_rng([71, seed])
        path = SmoothPath.drawn(rng, speed_m_s=1.5)
        path = replace(path, amplitude_rad=3.0 * path.amplitude_rad)
        frames, _ = inertial_drive(rng, 11, path, points=60, sigma_px=SIGMA_PX)
        by = odometry()
        for frame in frames:
            seen = blind_frame(frame.index) if frame.index in dark else frame
            by.step(replace(seen, imu=frame.imu))
        assert by.window is not None
        assert set(dark) <= set(by.window.frames.tolist())
        states = states_of(by.window)
        around_s = 1e-9 * FRAME_NS * frames[-1].index + np.array([-1e-4, 1e-4])
        lever_m = CALIBRATION.T_cam_imu[:3, 3]
        places = path.position(around_s) + path.rotation(around_s) @ lever_m
        velocity_error = (places[1] - places[0]) / 2e-4 - states.velocity[-1]
        velocity = slice(COMMON + STATE * (len(by.window) - 1), None)
        velocity_cov = states.cov[velocity, velocity][:3, :3]
        calibration = slice(GRAVITY_DIMENSIONS, COMMON)
        squared.append(
            [
                squared_mahalanobis(velocity_error, velocity_cov),
                squared_mahalanobis(
                    states.calibration_errors, states.cov[calibration, calibration]
                ),
            ]
        )
    of_velocity, of_calibration = np.sum(squared, axis=0)
    assert of_velocity < chi2.ppf(0.999, 3 * 3)
    assert of_calibration < chi2.ppf(0.999, 3 * 9)


def test_a_factor_beyond_the_gate_leaves_the_velocity_known() -> None:
    """The images refute the samples before the last bright frame. The blackout after it is bridged
    nevertheless, within 3σ; without a velocity, σ would be 0.66 m."""
    frames, truth = drive_of(30, 24)
    last_bright = 18
    imu = frames[last_bright].imu
    assert imu is not None
    pushed = replace(imu, accel_m_s2=imu.accel_m_s2 + np.array([2.0, 0.0, 2.0]))
    frames[last_bright] = replace(frames[last_bright], imu=pushed)
    for k in range(last_bright + 1, len(frames)):
        frames[k] = replace(blind_frame(k), imu=frames[k].imu)
    by = odometry()
    estimates = [by.step(frame) for frame in frames]
    assert "contradicts the images in this step" in estimates[last_bright].imu_left_out
    _, cov = by.relative(len(frames) - 1, last_bright)
    assert np.sqrt(np.trace(cov[:3, :3])) < 0.2
    error = se3.log(se3.inverse(estimates[-1].T_world_cam) @ truth[-1])
    assert (np.abs(error) < 3.0 * np.sqrt(np.diag(estimates[-1].cov_cam_world))).all()


def test_an_imu_at_rest_starts() -> None:
    """A camera that stands still finds gravity, and then stays where it is."""
    rng = np.random.default_rng(72)
    path = SmoothPath.drawn(rng, speed_m_s=0.0, swing=0.0)
    frames, _ = inertial_drive(rng, 14, path, points=60, sigma_px=SIGMA_PX)
    by = odometry()
    last = [by.step(frame) for frame in frames][-1]
    assert by.window is not None
    states = states_of(by.window)
    np.testing.assert_allclose(states.gravity, GRAVITY, atol=0.3)
    assert np.linalg.norm(last.T_world_cam[:3, 3]) < 0.01


def test_biases_that_do_not_walk_are_as_those_that_hardly_walk() -> None:
    """σ of the biases after 40 frames, and the last pose in units of its σ, agree to a thousandth
    with walks of 1e-7 rad/s²/√Hz and 1e-6 m/s³/√Hz."""
    frames, truth = drive_of(48, 40)
    found = []
    for gyro_walk, accel_walk in ((0.0, 0.0), (1e-7, 1e-6)):
        calibration = replace(
            CALIBRATION,
            gyro_bias_walk_rad_s2_sqrt_hz=gyro_walk,
            accel_bias_walk_m_s3_sqrt_hz=accel_walk,
        )
        by = StereoOdometry(CAMERA, imu=calibration)
        for frame in frames:
            estimate = by.step(frame)
        assert by.window is not None
        error = se3.log(estimate.T_cam_world @ truth[-1])
        squared = error @ np.linalg.solve(estimate.cov_cam_world, error)
        sigmas = np.sqrt(np.diag(states_of(by.window).cov)[-6:])
        found.append(np.append(sigmas, squared))
    np.testing.assert_allclose(found[0], found[1], rtol=1e-3)


@pytest.mark.parametrize("frames", [3, 4])
def test_a_short_window_tests_its_imu_on_all_of_its_frames(frames: int) -> None:
    """It is used from then on, and the last poses of six drives are consistent."""
    squared = []
    for seed in range(60, 66):
        seen, truth = drive_of(seed, 20)
        by = odometry(frames=frames)
        for frame in seen:
            estimate = by.step(frame)
            assert Inertial.of(by.window).is_used == (frame.index >= frames)
        error = se3.log(estimate.T_cam_world @ truth[-1])
        squared.append(error @ np.linalg.solve(estimate.cov_cam_world, error))
    assert 0.4 * 6.0 < np.mean(squared) < 1.6 * 6.0


def test_a_window_that_is_too_short_for_the_test_says_so() -> None:
    """Of two frames: the IMU is left out, and after a blackout landmarks are found again."""
    frames, _ = drive_of(47, 12)
    for k in (8, 9):
        frames[k] = replace(blind_frame(k), imu=frames[k].imu)
    by = odometry(frames=2)
    estimates = [by.step(frame) for frame in frames]
    assert "fewer than 3 window.frames" in estimates[-1].imu_left_out
    assert estimates[10].status is Status.RECOVERED
    assert not Inertial.of(by.window).is_used


def test_an_imu_whose_samples_have_holes_in_each_window_starts() -> None:
    """A hole of 30 ms in each seventh interval, which is not preintegrated: the last intervals are
    tested by themselves. The last poses of six drives are consistent."""
    squared = []
    for seed in range(50, 56):
        frames, truth = drive_of(seed, 24)
        by = odometry()
        for frame in frames:
            changed = frame
            if frame.imu is not None and frame.index % 7 == 4:
                in_hole = np.abs(np.arange(len(frame.imu.stamps_ns)) - 10) < 3
                changed = with_samples_at(frame, ~in_hole)
            estimate = by.step(changed)
        assert Inertial.of(by.window).is_used
        error = se3.log(estimate.T_cam_world @ truth[-1])
        squared.append(error @ np.linalg.solve(estimate.cov_cam_world, error))
    assert 0.4 * 6.0 < np.mean(squared) < 1.6 * 6.0


Change = Callable[[ImuSamples], ImuSamples]


def in_degrees(samples: ImuSamples) -> ImuSamples:
    return replace(samples, gyro_rad_s=np.degrees(samples.gyro_rad_s))


def in_g(samples: ImuSamples) -> ImuSamples:
    return replace(samples, accel_m_s2=samples.accel_m_s2 / 9.81)


def late(samples: ImuSamples) -> ImuSamples:
    return replace(samples, stamps_ns=samples.stamps_ns - 50_000_000)


@pytest.mark.parametrize("window_frames", [3, 4, 8])
@pytest.mark.parametrize("change", [in_degrees, in_g])
def test_an_imu_that_contradicts_the_images_is_not_used(change: Change, window_frames: int) -> None:
    """The path is then that of the images alone, to the byte, and the estimates say why."""
    frames, _ = drive_of(40, 16)
    wrong = [
        frame if frame.imu is None else replace(frame, imu=change(frame.imu)) for frame in frames
    ]
    by = odometry(frames=window_frames)
    estimates = []
    for frame in wrong:
        estimates.append(by.step(frame))
        assert not Inertial.of(by.window).is_used
    assert "check the" in estimates[-1].imu_left_out


def test_noise_that_would_explain_the_contradiction_is_named(run: Run) -> None:
    """χ² of 6.25 per degree of freedom is that of 2.5 times the standard deviation."""
    fit = InertialFit(
        states_of(run[2]),
        chi2=625.0,
        dof=100,
        bias_chi2=5.0,
        gravity_m_s2=9.81,
        gravity_sigma_m_s2=0.1,
    )
    noisy = fit.reason_against(4.0)
    assert noisy is not None
    assert "noise densities at least 2.5 times as large" in noisy.text
    assert fit.reason_against(7.0) is None
    wrong = replace(fit, chi2=1e6).reason_against(4.0)
    assert wrong is not None
    assert wrong.fault is noisy.fault is ImuFault.CONTRADICTION
    assert "noise densities" not in wrong.text


def test_biases_that_the_calibration_does_not_allow_for_are_named() -> None:
    """A gyro whose bias is 6σ: among 54 degrees of freedom, its χ² would pass."""
    frames, _ = drive_of(42, 8)
    biased = [
        frame
        if frame.imu is None
        else replace(
            frame, imu=replace(frame.imu, gyro_rad_s=frame.imu.gyro_rad_s + 0.12 * np.eye(3)[0])
        )
        for frame in frames
    ]
    by = odometry()
    estimates = [by.step(frame) for frame in biased]
    assert "check gyro_bias_sigma_rad_s" in estimates[-1].imu_left_out


def test_behind_an_imu_that_is_left_out_landmarks_are_found_again() -> None:
    """Black frames are then those of a window without an IMU, and their pose as uncertain."""
    frames, _ = drive_of(42, 46)
    changed = [
        frame if frame.imu is None else replace(frame, imu=in_g(frame.imu)) for frame in frames
    ]
    for k in (41, 42):
        changed[k] = replace(blind_frame(k), imu=changed[k].imu)
    by = odometry()
    without = odometry(calibration=None)
    for frame in changed:
        estimate = by.step(frame)
        expected = without.step(replace(frame, imu=None))
        if frame.index >= 41:
            np.testing.assert_allclose(estimate.cov_cam_world, expected.cov_cam_world, rtol=1e-6)
        if frame.index == 43:
            assert estimate.status is Status.RECOVERED
    assert by.window is not None
    assert by.window.inertial.is_excluded


def at_the_rate_of_the_frames(frame: Frame) -> Frame:
    """Keep the sample nearest to each end of the interval, as of an inertial navigation system."""
    if frame.imu is None:
        return frame
    stamps_ns = frame.imu.stamps_ns
    ends_ns = np.array([frame.stamp_ns - FRAME_NS, frame.stamp_ns])
    return with_samples_at(frame, np.abs(stamps_ns[:, None] - ends_ns).argmin(axis=0))


def with_samples_at(frame: Frame, kept: IntArray | BoolArray) -> Frame:
    """Keep some of a frame's samples."""
    if frame.imu is None:
        return frame
    imu = ImuSamples(
        frame.imu.stamps_ns[kept], frame.imu.gyro_rad_s[kept], frame.imu.accel_m_s2[kept]
    )
    return replace(frame, imu=imu)


def gyro_from_the_second_interval_on(frame: Frame) -> Frame:
    """Keep only the gyro, and nothing before the second frame."""
    if frame.imu is None or frame.index == 1:
        return replace(frame, imu=None)
    no_force = np.full_like(frame.imu.accel_m_s2, np.nan)
    return replace(frame, imu=replace(frame.imu, accel_m_s2=no_force))


@pytest.mark.parametrize("seed", range(3))
def test_an_imu_waits_until_the_direction_of_gravity_is_known(
    seed: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The window of a camera with 200 frames a second lasts 50 ms. At 40 to 400 m, images know its
    acceleration to ten times gravity: any direction of that would fit."""
    frame_ns = 5_000_000
    monkeypatch.setattr(worlds, "FRAME_NS", frame_ns)
    monkeypatch.setattr(inertial_worlds, "FRAME_NS", frame_ns)
    monkeypatch.setattr(inertial_worlds, "drive", partial(worlds.drive, depth_m=(40.0, 400.0)))
    rng = np.random.default_rng([70, seed])
    path = SmoothPath.drawn(rng, swing=1.0)
    frames, _ = inertial_drive(rng, 20, path, sigma_px=0.5)
    odometry = StereoOdometry(CAMERA, imu=CALIBRATION, config={"self_calibration": False})
    images = StereoOdometry(CAMERA, config={"self_calibration": False})
    for frame in frames:
        motion = odometry.step(frame)
        alone = images.step(replace(frame, imu=None))
    assert Inertial.of(odometry.window).status is ImuStatus.WAITING
    assert motion.imu_reason == UNKNOWN_GRAVITY
    np.testing.assert_array_equal(motion.T_world_cam, alone.T_world_cam)


@pytest.mark.parametrize("change", [at_the_rate_of_the_frames, gyro_from_the_second_interval_on])
def test_behind_samples_that_are_never_preintegrated_landmarks_are_found_again(
    change: Callable[[Frame], Frame],
) -> None:
    """No state ever depends on them: a blackout ends as without an IMU, and in it the position is
    as uncertain."""
    frames, _ = drive_of(45, 14)
    dark = range(6, 9)
    by = odometry()
    without = odometry(calibration=None)
    for frame in frames:
        shown = replace(blind_frame(frame.index), imu=frame.imu) if frame.index in dark else frame
        estimate = by.step(change(shown))
        expected = without.step(replace(shown, imu=None))
        if frame.index == dark.stop:
            assert estimate.status is Status.RECOVERED
            assert expected.status is Status.RECOVERED
        sigma_m = np.sqrt(estimate.cov_cam_world[:3, :3].trace())
        assert sigma_m == pytest.approx(np.sqrt(expected.cov_cam_world[:3, :3].trace()), rel=0.1)
    np.testing.assert_allclose(estimate.T_world_cam, expected.T_world_cam, atol=2e-3)


def test_factors_between_frames_that_stay_remain_when_blind_ones_leave() -> None:
    frames, _ = drive_of(46, 8)
    by = odometry()
    for frame in frames:
        by.step(frame)
    window = by.window
    assert window is not None
    factors = factors_of(window)
    known = replace(window.prior, information=np.eye(len(window.prior.vector)))
    leaving = np.arange(len(window)) == 3
    kept = without_blind(replace(window, prior=known), leaving)
    assert kept.inertial.factors == (*factors[:2], None, *factors[4:])
    # Meanwhile the biases walk on, for two steps.
    walks = walk_variances(CALIBRATION, kept.inertial.durations_s(kept.frames))
    step = CALIBRATION.gyro_bias_walk_rad_s2_sqrt_hz**2 * 1e-9 * FRAME_NS
    np.testing.assert_allclose(walks[:, 0], step * np.array([1, 1, 2, 1, 1, 1]), rtol=1e-9)


def test_biases_walk_for_as_long_as_no_sample_comes() -> None:
    """A minute without images and samples adds σ² T to their variances."""
    gap_ns = 60_000_000_000
    frames, _ = drive_of(49, 13)
    by = odometry()
    for frame in frames[:12]:
        by.step(frame)
    assert by.window is not None
    before = np.diag(states_of(by.window).cov)[-6:]
    assert frames[12].features is not None
    others = replace(frames[12].features, ids=frames[12].features.ids + 1_000_000)
    behind = replace(frames[12], stamp_ns=frames[12].stamp_ns + gap_ns, features=others, imu=None)
    by.step(behind)
    added = np.diag(states_of(by.window).cov)[-6:] - before
    walks = [CALIBRATION.gyro_bias_walk_rad_s2_sqrt_hz, CALIBRATION.accel_bias_walk_m_s3_sqrt_hz]
    duration_s = 1e-9 * (gap_ns + FRAME_NS)
    np.testing.assert_allclose(added, np.repeat(np.square(walks) * duration_s, 3), rtol=1e-3)


def test_a_gyro_by_itself_is_no_imu_that_is_left_out() -> None:
    """It predicts motions, and nobody is warned that the window does not use it."""
    frames, _ = drive_of(41, 8)
    gyro_only = [
        frame
        if frame.imu is None
        else replace(
            frame, imu=replace(frame.imu, accel_m_s2=np.full_like(frame.imu.accel_m_s2, np.nan))
        )
        for frame in frames
    ]
    by = odometry()
    estimates = [by.step(frame) for frame in gyro_only]
    assert Inertial.of(by.window).trusts_gyro
    assert not any(estimate.imu_left_out for estimate in estimates)


def test_an_accelerometer_that_starts_late_is_used() -> None:
    """In the first interval there is the gyro alone."""
    frames, _ = drive_of(46, 16)
    imu = frames[1].imu
    assert imu is not None
    without = replace(imu, accel_m_s2=np.full_like(imu.accel_m_s2, np.nan))
    frames[1] = replace(frames[1], imu=without)
    by = odometry()
    estimates = [by.step(frame) for frame in frames]
    assert not estimates[1].imu_left_out
    assert Inertial.of(by.window).is_used


def test_an_imu_that_is_being_tested_says_how_far_it_is() -> None:
    """Where every fourth interval has no samples, for the whole drive."""
    frames, _ = drive_of(37, 12)
    by = odometry()
    said = [by.step(frame).imu_left_out for frame in frames]
    connected = "is being tested: its samples connect {} of the 6 frames it takes"
    assert said == ["", *[connected.format(count) for count in range(2, 6)], *[""] * 7]
    by = odometry()
    reasons = []
    for frame in frames:
        imu = None if frame.index % 4 == 0 else frame.imu
        seen = blind_frame(frame.index) if frame.index == 10 else frame
        reasons.append(by.step(replace(seen, imu=imu)).imu_reason)
    for index, reason in enumerate(reasons[1:], 1):
        assert reason is not None
        assert reason.fault is (ImuFault.TESTING if index % 4 else ImuFault.NO_SAMPLES)


def test_a_step_that_the_images_do_not_show_tests_no_imu() -> None:
    frames, _ = drive_of(38, 6)
    by = odometry()
    for frame in frames:
        seen = blind_frame(frame.index) if frame.index == 5 else frame
        estimate = by.step(replace(seen, imu=frame.imu))
    assert estimate.imu_reason == UNTESTED_STEP


def test_samples_that_end_are_said_for_as_long_as_they_are_missed() -> None:
    """Also once no interval of the window has any."""
    frames, _ = drive_of(44, 24)
    by = odometry(frames=4)
    estimates = [
        by.step(frame if frame.index < 12 else replace(frame, imu=None)) for frame in frames
    ]
    assert not estimates[11].imu_left_out
    assert all(estimate.imu_left_out for estimate in estimates[12:])


def test_what_the_test_at_the_start_shows_of_the_noise_counts_for_the_factors_it_tested() -> None:
    """Poses and samples that differ by more than both claim, but pass."""
    frames, _ = drive_of(47, 12)
    modest = replace(
        CALIBRATION,
        gyro_noise_rad_s_sqrt_hz=CALIBRATION.gyro_noise_rad_s_sqrt_hz / 5.0,
        accel_noise_m_s2_sqrt_hz=CALIBRATION.accel_noise_m_s2_sqrt_hz / 5.0,
    )
    by = odometry(modest)
    for frame in frames[:5]:
        by.step(frame)
    assert by.window is not None
    before = factors_of(by.window)
    by.step(frames[5])
    used = by.window.inertial
    assert used.is_used
    assert used.noise_factor > 1.1
    for factor, tested in zip(before, factors_of(by.window), strict=False):
        np.testing.assert_allclose(tested.cov, used.noise_factor * factor.cov)


def test_frames_that_are_dead_reckoned_are_not_connected_by_an_imu_that_is_left_out() -> None:
    frames, _ = drive_of(43, 8)
    by = odometry()
    for frame in frames:
        seen = blind_frame(frame.index) if frame.index in (3, 4) else frame
        by.step(replace(seen, imu=frame.imu))
    assert by.window is not None
    assert by.window.inertial.is_used
    # Frames 3 and 4 are dead-reckoned from frame 2 each, and frame 5 has found its landmarks again.
    pairs = [motion.variables for motion in _motions_by_imu_only(by.window, 1.0)]
    assert pairs == [(pose_of(3), pose_of(4)), (pose_of(4), pose_of(5))]


def test_frames_that_only_the_imu_connects_stay_when_it_is_left_out() -> None:
    """After a blackout that the IMU has bridged, it begins to lie. It is left out while the window
    still holds the dark frames; the poses stay known, and the newest motions are as accurate."""
    frames, truth = drive_of(42, 26)
    changed = list(frames)
    for k in (13, 14):
        changed[k] = replace(blind_frame(k), imu=frames[k].imu)
    for k in range(15, 26):
        imu = frames[k].imu
        assert imu is not None
        changed[k] = replace(frames[k], imu=in_degrees(imu))
    by = odometry()
    windows = []
    estimates = []
    for frame in changed:
        estimates.append(by.step(frame))
        windows.append(by.window)
    lied = []
    for k, window in enumerate(windows):
        if Inertial.of(window).is_excluded:
            lied.append(k)
    assert by.window is not None
    before = windows[lied[0] - 1]
    assert before is not None
    assert {13, 14} <= set(before.frames.tolist())
    for k in range(lied[0], 26):
        assert estimates[k].status is Status.OK
        motion = se3.inverse(truth[k]) @ truth[k - 1]
        error = se3.log(estimates[k].T_curr_prev @ se3.inverse(motion))
        assert error @ np.linalg.solve(estimates[k].cov, error) < 30.0
    sigma_m = np.sqrt(np.trace(estimates[-1].cov_cam_world[:3, :3]))
    off = se3.inverse(truth[-1]) @ estimates[-1].T_world_cam
    assert np.linalg.norm(off[:3, 3]) < 3.0 * sigma_m


@pytest.mark.parametrize("seed", range(3))
def test_poses_stay_known_where_the_imu_is_left_out_behind_the_first_frame(seed: int) -> None:
    """The prior then holds the one factor of the frame that has left, and does not know all of
    velocity, biases and gravity. What it says of the poses is semi-definite none the less, and no
    more than with the IMU."""
    frames, _ = drive_of(seed, 9)
    by = odometry()
    for frame in frames:
        by.step(frame)
    window = by.window
    assert window is not None
    assert window.inertial.is_used
    assert window.frames[0] == 1
    poses = slice(0, POSE * len(window))
    before = window.prior.information[poses, poses]
    after = without_imu(window, NO_SOLUTION).prior.information[poses, poses]
    largest = np.linalg.eigvalsh(before)[-1]
    assert np.linalg.eigvalsh(after)[0] > -1e-12 * largest
    assert np.linalg.eigvalsh(before - after)[0] > -1e-12 * largest


def test_a_blackout_without_samples_is_dead_reckoned_until_the_velocity_is_known() -> None:
    """While neither image nor sample has shown the velocity, σ grows as by the motion model, and
    no state overflows; afterwards the IMU is used again."""
    frames, _ = drive_of(43, 36)
    changed = list(frames)
    for k in range(12, 18):
        changed[k] = replace(blind_frame(k), imu=None if k == 12 else frames[k].imu)
    by = odometry()
    estimates = [by.step(frame) for frame in changed]
    for estimate in estimates[13:18]:
        assert "velocity" in estimate.imu_left_out
        assert np.sqrt(estimate.cov[:3, :3].trace()) < 5.0
    assert np.sqrt(estimates[18].cov_cam_world[:3, :3].trace()) < 10.0
    assert not estimates[-1].imu_left_out
    assert estimates[-1].status is Status.OK


def test_the_status_says_who_bridges_and_whom_the_gyro_may_predict_for(run: Run) -> None:
    """An IMU that may yet be used bridges; one whose samples can be tested has to pass first."""
    used = run[2].inertial
    factor = factors_of(run[2])[-1]
    none = (None,) * len(used.factors)
    untested = replace(used, states=None, pending=None)
    expected = {
        ImuStatus.ABSENT: (Inertial.none(), False, True),
        ImuStatus.USED: (used, True, True),
        ImuStatus.TESTING: (replace(untested, factors=none, pending=factor), True, False),
        ImuStatus.WAITING: (untested, True, False),
        ImuStatus.UNUSABLE: (replace(untested, factors=none), False, True),
        ImuStatus.EXCLUDED: (used.excluded(NO_SOLUTION), False, False),
    }
    assert set(expected) == set(ImuStatus)
    for status, (imu, bridges, predicts) in expected.items():
        assert imu.status is status
        assert imu.is_used == (status is ImuStatus.USED)
        assert imu.may_bridge == bridges
        assert imu.trusts_gyro == predicts


def test_an_imu_that_cannot_be_tested_waits() -> None:
    """Where rounding has left the poses' covariance indefinite, the images go on without it."""
    frames, _ = drive_of(44, 12)
    by = odometry()
    for frame in frames:
        by.step(frame)
    window = by.window
    assert window is not None
    untested = replace(window, inertial=window.inertial.restarted())
    assert initialize_states(untested).inertial.is_used
    broken = initialize_states(replace(untested, cov=-untested.cov))
    assert not broken.inertial.is_used
    assert broken.inertial.reason is UNTESTABLE
    assert not broken.inertial.is_excluded


@pytest.mark.parametrize("size_rad_s", [1.0, 5.0, 1000.0])
def test_a_spike_of_one_sample_is_left_out(size_rad_s: float) -> None:
    """The error at the end is within 1.1 times that without the spike, or within a fifth of σ."""
    frames, truth = drive_of(41, 20)
    spiked = list(frames)
    imu = frames[13].imu
    assert imu is not None
    rates = imu.gyro_rad_s.copy()
    rates[9] += size_rad_s * np.array([0.6, 0.0, 0.8])
    spiked[13] = replace(frames[13], imu=replace(imu, gyro_rad_s=rates))
    results = []
    for each in (frames, spiked):
        by = odometry()
        estimates = [by.step(frame) for frame in each]
        results.append(estimates)
    error_m = [
        np.linalg.norm((se3.inverse(truth[-1]) @ estimates[-1].T_world_cam)[:3, 3])
        for estimates in results
    ]
    sigma_m = float(np.sqrt(np.trace(results[0][-1].cov_cam_world[:3, :3])))
    assert error_m[1] < max(1.1 * error_m[0], error_m[0] + 0.2 * sigma_m)
    assert [each.defect for each in results[1][13].missing] == [Defect.RATE_IS_SPIKE]
