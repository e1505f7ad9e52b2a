"""The sliding window: its equations, its gauge, its marginalisation, and its covariances."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.optimize import least_squares

from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.camera.rig_calibration import disparity_basis
from probevo.camera.rig_jitter import jitter_offsets
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.estimation.window.adjustment import WindowAdjustment
from probevo.estimation.window.equations import JITTER, LENS, POSE, RIG
from probevo.estimation.window.estimator import WindowEstimator
from probevo.estimation.window.further_measurements import (
    with_dead_reckoning,
    with_dead_reckoning_in_prior,
    with_measurements,
)
from probevo.estimation.window.live_motion import live_motion
from probevo.estimation.window.marginalization import (
    MIN_POSITION_INFORMATION,
    kept_positive,
    without_blind,
)
from probevo.estimation.window.window import MarginalPrior, Window, selected
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared
from probevo.measurements.pose_prior import PosePrior
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.measurements.variables import pose_of
from probevo.noise import StereoNoise, StudentT
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, drive, motion_error, tracks_between

SIGMA_PX = 0.3
TAU_PX = 0.4
JITTER_SIGMA_RAD = np.deg2rad(0.03)


def estimator(
    frames: int, *, calibrates: bool = False, iterations: int = 3, correlation: float = 0.0
) -> WindowEstimator:
    config = OdometryConfig.model_validate(
        {
            "self_calibration": calibrates,
            "window": {
                "frames": frames,
                "max_iterations": iterations,
                "correlation": correlation,
            },
        }
    )
    return WindowEstimator(CAMERA, config)


def noise_of(count: int, *, dof: float = np.inf, tau_px: float = 0.0) -> StereoNoise:
    noise = StudentT(dof=dof, scale=SIGMA_PX**2 * np.eye(4)).predict(np.zeros((count, 0)))
    return replace(noise, time_correlated=np.full(count, tau_px**2)) if tau_px else noise


def step_to(frame: int, T_curr_prev: FloatArray) -> RelativePose:
    """Return a motion to a frame, as two frames by themselves show it."""
    return RelativePose(T_curr_prev, 0.01 * np.eye(6), pose_of(frame), pose_of(frame - 1))


def windows_of(
    frames: list[Frame],
    by: WindowEstimator,
    *,
    dof: float = np.inf,
    tau_px: float = 0.0,
    guess: FloatArray = FORWARD,
) -> list[Window]:
    """Return the window after each frame."""
    windows = [Window.at_first_frame(frames[0].index)]
    for prev, curr in pairwise(frames):
        tracks = tracks_between(prev, curr)
        noise = noise_of(len(tracks), dof=dof, tau_px=tau_px)
        two_frames = step_to(curr.index, guess)
        windows.append(by.add_observed_frame(windows[-1], tracks, noise, motion=two_frames))
    return windows


def distortion(u_px: FloatArray, v_px: FloatArray, kappa: float) -> tuple[FloatArray, FloatArray]:
    """Return how far a lens of distortion κ moves pixels outwards, px."""
    x, y = CAMERA.normalized(u_px, v_px)
    outwards = kappa * (x * x + y * y)
    return CAMERA.fu_px * x * outwards, CAMERA.fv_px * y * outwards


def residuals_of(
    window: Window, x: FloatArray, correlation: float = 0.0, jitter: FloatArray | None = None
) -> FloatArray:
    """Return the white residuals of all observations and priors, by the definition.

    x moves the poses after the first, the rig, and the landmarks; the jitters, [K, 3], are given.
    """
    count = len(window)
    poses = np.concatenate([np.zeros(POSE), x[: POSE * (count - 1)]]).reshape(-1, POSE)
    T_cam_world = se3.exp(poses) @ window.T_cam_world
    rig = window.rig_errors + x[POSE * (count - 1) : POSE * (count - 1) + RIG]
    state = window.landmarks.state + x[POSE * (count - 1) + RIG :].reshape(-1, 4)
    observations = window.observations
    rows = window.landmark_rows
    anchors = observations.slot[observations.start[:-1]][rows]
    u, v, d, error = state[rows].T
    rays = np.column_stack(
        [(u - CAMERA.cu_px) / CAMERA.fu_px, (v - CAMERA.cv_px) / CAMERA.fv_px, np.ones(len(u))]
    )
    T = T_cam_world[observations.slot] @ se3.inverse(T_cam_world[anchors])
    inverse_depth = d / (CAMERA.fu_px * CAMERA.baseline_m)
    h = (T[:, :3, :3] @ rays[..., None])[..., 0] + inverse_depth[:, None] * T[:, :3, 3]
    u_k = CAMERA.fu_px * h[:, 0] / h[:, 2] + CAMERA.cu_px
    v_k = CAMERA.fv_px * h[:, 1] / h[:, 2] + CAMERA.cv_px
    rig_error = disparity_basis(np.column_stack([u_k, v_k, u_k, v_k]), CAMERA) @ rig[:LENS]
    right_px = np.column_stack([u_k - d / h[:, 2], v_k])
    du_k, dv_k = distortion(u_k, v_k, float(rig[LENS]))
    du_r, _ = distortion(right_px[:, 0], v_k, float(rig[LENS]))
    predicted = np.column_stack(
        [u_k + du_k, v_k + dv_k, right_px[:, 0] + du_r - error + rig_error, v_k + dv_k]
    )
    of_jitter = np.zeros(0)
    if jitter is not None:
        offsets = jitter_offsets(np.column_stack([u_k, v_k, u_k - d / h[:, 2], v_k]), CAMERA)
        predicted[:, 2:] += (offsets @ jitter[observations.slot][..., None])[..., 0]
        of_jitter = np.linalg.solve(np.linalg.cholesky(window.jitter_cov), jitter.T).ravel()
    of_errors = np.sqrt(window.landmarks.error_information) * state[:, 3]
    white = (observations.pixels - predicted) / SIGMA_PX
    # An AR(1) process is white once the part that the error before predicts is taken away.
    is_first = np.zeros(len(white), np.bool_)
    is_first[observations.start[:-1]] = True
    innovations = (white - correlation * np.roll(white, 1, axis=0)) / np.sqrt(1.0 + correlation)
    innovations[is_first] = white[is_first] * np.sqrt(1.0 - correlation)
    return np.concatenate([innovations.ravel(), of_errors, of_jitter])


def batch(window: Window, correlation: float) -> tuple[Window, FloatArray]:
    """Solve the same problem with SciPy: all poses but the first; the rig is held."""
    num_poses = POSE * (len(window) - 1)
    num_landmarks = 4 * len(window.ids)

    def residuals(x: FloatArray) -> FloatArray:
        moves = np.concatenate([x[:num_poses], np.zeros(RIG), x[num_poses:]])
        return residuals_of(window, moves, correlation)

    found = least_squares(residuals, np.zeros(num_poses + num_landmarks), method="trf", xtol=1e-14)
    moves = np.concatenate([np.zeros(POSE), found.x[:num_poses]]).reshape(-1, POSE)
    jacobian = np.asarray(found.jac)
    cov = np.linalg.inv(jacobian.T @ jacobian)[:num_poses, :num_poses]
    return replace(window, T_cam_world=se3.exp(moves) @ window.T_cam_world), cov


@pytest.mark.parametrize("correlation", [0.0, 0.7])
def test_normal_equations_are_those_of_numeric_jacobians(correlation: float) -> None:
    """Hessian and gradient of poses and rig, after landmarks and jitters are eliminated by a dense
    Schur complement, in the middle of a window whose landmarks have not converged."""
    frames = drive(np.random.default_rng(50), 5, points=25, sigma_px=SIGMA_PX)
    by = estimator(frames=9, calibrates=True, correlation=correlation)
    window = windows_of(frames, by, tau_px=TAU_PX)[-1]
    # One landmark is seen only once, others not by the frames in the middle.
    keep = window.landmark_rows > 0
    keep[0] = True
    keep &= (window.landmark_rows % 3 > 0) | ~np.isin(window.observations.slot, (2, 3))
    keep &= (window.landmark_rows % 5 > 0) | (window.observations.slot != 1)
    window = replace(window, observations=selected(window.observations, keep))
    assert window.num_seen[0] == 1
    rng = np.random.default_rng(51)
    state = window.landmarks.state + 0.1 * rng.normal(size=window.landmarks.state.shape)
    moves = se3.exp(1e-3 * rng.normal(size=(5, POSE)))
    T_cam_world = moves @ window.T_cam_world
    T_cam_world[0] = np.eye(4)
    window = replace(
        window,
        T_cam_world=T_cam_world,
        T_linear=T_cam_world,
        landmarks=window.landmarks._replace(state=state),
    )
    # That β(x), r², and what a jitter does, move with the pose is ignored.
    window = replace(
        window,
        rig_errors=np.zeros(RIG),
        jitter=np.zeros((5, JITTER)),
        jitter_cov=JITTER_SIGMA_RAD**2 * np.diag([0.25, 1.0, 0.5]),
    )
    system = by.adjustment._system(window)
    count = POSE * 4 + RIG + 4 * len(window.ids)

    def residuals(x: FloatArray) -> FloatArray:
        jitter = 1e-3 * x[count:].reshape(5, JITTER)  # in thousandths, for the differences' sake
        return residuals_of(window, x[:count], correlation, jitter)

    here = residuals(np.zeros(count + 5 * JITTER))
    jacobian = np.empty((len(here), count + 5 * JITTER))
    for column, step in enumerate(1e-5 * np.eye(count + 5 * JITTER)):
        jacobian[:, column] = (residuals(step) - residuals(-step)) / 2e-5
    full = jacobian.T @ jacobian
    descent = -jacobian.T @ here
    kept = slice(0, POSE * 4 + RIG)
    eliminated = slice(POSE * 4 + RIG, None)
    gain = np.linalg.solve(full[eliminated, eliminated], full[eliminated, kept])
    expected = full[kept, kept] - full[kept, eliminated] @ gain
    expected_gradient = descent[kept] - gain.T @ descent[eliminated]
    prior = window.prior
    x = window.offsets()
    hessian = system.equations.hessian - prior.information
    gradient = system.equations.gradient - (prior.vector - prior.information @ x)
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert (np.abs(hessian[POSE:, POSE:] - expected) / scale).max() < 1e-6
    np.testing.assert_allclose(
        gradient[POSE:] / np.sqrt(np.diag(expected)),
        expected_gradient / np.sqrt(np.diag(expected)),
        atol=1e-5,
    )


@pytest.mark.parametrize(("tau_px", "correlation"), [(0.0, 0.0), (TAU_PX, 0.0), (TAU_PX, 0.6)])
def test_a_window_as_long_as_the_drive_is_batch_adjustment(
    tau_px: float, correlation: float
) -> None:
    """Poses agree to 1e-6 m and rad with SciPy's solution, covariances to 1e-3."""
    frames = drive(np.random.default_rng(52), 8, points=40, sigma_px=SIGMA_PX)
    by = estimator(frames=8, correlation=correlation)
    window = windows_of(frames, by, tau_px=tau_px)[-1]
    for _ in range(6):  # on line, it stops at a fraction of a standard deviation
        window = by.adjustment.adjusted(window)
    solved, cov = batch(window, correlation)
    difference = se3.log(solved.T_cam_world @ se3.inverse(window.T_cam_world))
    assert np.abs(difference).max() < 1e-6
    at = slice(POSE, POSE * 8)
    sigma = np.sqrt(np.diag(cov))
    assert (np.abs(window.cov[at, at] - cov) / np.outer(sigma, sigma)).max() < 1e-3


def test_marginalisation_loses_nothing_of_landmarks_that_have_gone() -> None:
    """Where each landmark is seen in four frames of six, the newest pose and its covariance are
    those of batch adjustment, to a thousandth of σ, which is due to linearisation."""
    frames = drive(np.random.default_rng(53), 14, points=60, sigma_px=0.05)
    short = [_renamed_every(frame, 4) for frame in frames]
    by = estimator(frames=6, iterations=10)
    window = windows_of(short, by)[-1]
    whole = windows_of(short, estimator(frames=14, iterations=10))[-1]
    assert len(window) == 6
    assert len(whole) == 14
    last = window.pose(-1)
    expected = whole.pose(-1)
    difference = se3.log(se3.inverse(last.T_world_cam) @ expected.T_world_cam)
    sigma = np.sqrt(np.diag(expected.cov))
    assert (np.abs(difference) < 1e-3 * sigma).all()
    np.testing.assert_allclose(np.sqrt(np.diag(last.cov)), sigma, rtol=1e-3)


def _renamed_every(frame: Frame, count: int) -> Frame:
    """Return the frame with landmarks that get another identity every few frames."""
    assert frame.features is not None
    features = frame.features
    ids = features.ids * 1000 + (frame.index + features.ids) // count
    return replace(frame, features=replace(features, ids=ids))


def test_the_window_gains_no_information_about_where_it_is() -> None:
    """Along the six directions of the world's frame xᵀ H x is below 1e-9 of that along a random
    one, before and after 200 marginalisations."""
    frames = drive(np.random.default_rng(54), 212, points=50, sigma_px=SIGMA_PX)
    by = estimator(frames=6)
    window = Window.at_first_frame(0)
    # The prior that holds the first pose, which is all that knows where the world is.
    nothing = np.zeros((POSE + RIG, POSE + RIG))
    window = replace(window, prior=replace(window.prior, information=nothing))
    rng = np.random.default_rng(55)
    before: Window | None = None
    for prev, curr in pairwise(frames):
        tracks = tracks_between(prev, curr)
        guess = se3.exp(1e-3 * rng.normal(size=6)) @ FORWARD
        extended = by.extend(window, curr.index, guess, tracks, noise_of(len(tracks)))
        adjusted = _adjusted_without_gauge(by, extended)
        before = before or (adjusted if len(adjusted) == 6 else None)
        window = by.adjustment.without_oldest(adjusted) if len(adjusted) > 6 else adjusted
    assert before is not None
    assert window.frames[0] > 200
    for each in (before, window):
        hessian = by.adjustment._system(each).equations.hessian[:-RIG, :-RIG]
        directions = se3.adjoint(each.T_linear).reshape(-1, POSE)
        random = np.random.default_rng(56).normal(size=(len(directions), 20))
        along_random = np.einsum("in,ij,jn->n", random, hessian, random)
        along_random /= np.square(random).sum(axis=0)
        along_gauge = np.abs(np.einsum("in,ij,jn->n", directions, hessian, directions))
        along_gauge /= np.square(directions).sum(axis=0)
        assert along_gauge.max() < 1e-9 * along_random.min()


@pytest.mark.parametrize("kind", [RelativeRotation, RelativePose])
def test_measured_motions_say_nothing_of_where_the_window_is(
    kind: type[RelativeRotation] | type[RelativePose],
) -> None:
    """Nor do those of poses that have moved away from where they are linearised."""
    frames = drive(np.random.default_rng(57), 8, points=50, sigma_px=SIGMA_PX)
    by = estimator(frames=6)
    window = windows_of(frames, by)[-1]
    rng = np.random.default_rng(58)
    moved = se3.exp(0.05 * rng.normal(size=(len(window), 6))) @ window.T_cam_world
    window = replace(window, T_cam_world=moved)
    pose_last, pose_before = pose_of(int(window.frames[-1])), pose_of(int(window.frames[-2]))
    measured: RelativeRotation | RelativePose
    if kind is RelativeRotation:
        measured = RelativeRotation(FORWARD[:3, :3], 1e-8 * np.eye(3), pose_last, pose_before)
    else:
        measured = RelativePose(FORWARD, 1e-8 * np.eye(6), pose_last, pose_before)
    after = with_measurements(window, [measured])
    gained = (after.prior.information - window.prior.information)[:-RIG, :-RIG]
    directions = se3.adjoint(window.T_linear).reshape(-1, POSE)
    along_gauge = np.abs(np.einsum("in,ij,jn->n", directions, gained, directions))
    assert along_gauge.max() < 1e-9 * np.linalg.eigvalsh(gained)[-1]
    # The residual is that of the poses as they are.
    x = window.offsets()
    gradient = after.prior.vector - window.prior.vector
    gradient[:-RIG] -= gained @ x[:-RIG]
    values = {pose_of(int(frame)): T for frame, T in zip(window.frames, moved, strict=True)}
    linear = {
        pose_of(int(frame)): T for frame, T in zip(window.frames, window.T_linear, strict=True)
    }
    jacobian = np.hstack(measured.jacobians(linear))
    expected = -1e8 * jacobian.T @ measured.residual(values)
    np.testing.assert_allclose(gradient[-RIG - 2 * POSE : -RIG], expected, rtol=1e-4, atol=1.0)


def test_after_a_blackout_measured_rotations_turn_the_window_no_further() -> None:
    """A prior that knows the rotation of a pose alone holds its linearisation point. With rotations
    measured, each step is as good as without, though the heading is known to some degrees only."""
    frames = drive(np.random.default_rng(59), 30, points=80, sigma_px=SIGMA_PX)
    rng = np.random.default_rng(60)
    by = estimator(frames=6)
    errors = {}
    for measures in (False, True):
        window = Window.at_first_frame(0)
        errors[measures] = []
        for prev, curr in pairwise(frames):
            k = curr.index
            if 8 <= k < 12:
                guess = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.01, 0.0])) @ FORWARD
                blind = RelativePose(guess, 3e-3 * np.eye(6), curr=pose_of(k), prev=pose_of(k - 1))
                window = by.add_unobserved_frame(window, k, blind)
                continue
            measured = []
            if measures:
                C = se3.exp(1e-3 * rng.normal(size=6))[:3, :3] @ FORWARD[:3, :3]
                measured = [RelativeRotation(C, 1e-6 * np.eye(3), pose_of(k), pose_of(k - 1))]
            tracks = tracks_between(prev, curr)
            before = window
            window = by.add_observed_frame(
                window,
                tracks,
                noise_of(len(tracks)),
                motion=step_to(k, FORWARD),
                measurements=measured,
            )
            step = window.T_cam_world[-1] @ se3.inverse(before.T_cam_world[-1])
            if k > 12:
                errors[measures].append(np.linalg.norm(motion_error(step)[3:]))
    assert np.mean(errors[True]) < 1.1 * np.mean(errors[False])
    assert np.max(errors[True]) < 3e-3


def _adjusted_without_gauge(by: WindowEstimator, window: Window) -> Window:
    """Adjust with the oldest pose held for this solve only."""
    size = len(window.prior.vector)
    held = np.zeros((size, size))
    held[:POSE, :POSE] = 1e9 * np.eye(POSE)
    x = window.offsets()
    prior = window.prior
    with_gauge = replace(
        prior, information=prior.information + held, vector=prior.vector + held @ x
    )
    adjusted = by.adjustment.adjusted(replace(window, prior=with_gauge))
    return replace(adjusted, prior=prior)


@pytest.mark.parametrize(("dof", "tau_px"), [(np.inf, 0.0), (np.inf, TAU_PX), (4.0, TAU_PX)])
def test_relative_poses_are_consistent(dof: float, tau_px: float) -> None:
    """The average NEES of motions over 1, 4 and 8 frames, at the end of independent drives, lies in
    the 99.9 % interval of χ²(6); noise is of the model's own kind: one scale for a landmark."""
    drives = 16
    squared: dict[int, list[float]] = {1: [], 4: [], 8: []}
    for seed in range(drives):
        rng = np.random.default_rng([57, seed])
        frames = _noisy(drive(rng, 16, points=60, sigma_px=0.0), rng, dof=dof, tau_px=tau_px)
        window = windows_of(frames, estimator(frames=9), dof=dof, tau_px=tau_px)[-1]
        for step, found in squared.items():
            T, cov = window.relative(8, 8 - step)
            expected = np.linalg.matrix_power(FORWARD, step)
            found.append(normalized_error_squared(T[None], expected[None], cov[None])[0])
    low, high = chi2_interval(dof=6, count=drives)
    for found in squared.values():
        assert low < np.mean(found) < high


@pytest.mark.parametrize("knows", [True, False])
def test_with_jitter_of_the_rig_relative_poses_are_consistent(knows: bool) -> None:
    """As above, for a right camera that turns by 0.03° in every frame. Windows that do not know of
    it claim far too much."""
    drives = 16
    cov = JITTER_SIGMA_RAD**2 * np.eye(JITTER)
    squared = []
    for seed in range(drives):
        rng = np.random.default_rng([62, seed])
        frames = [_jittered(frame, rng) for frame in drive(rng, 16, points=60, sigma_px=SIGMA_PX)]
        by = estimator(frames=9)
        window = Window.at_first_frame(frames[0].index)
        for prev, curr in pairwise(frames):
            tracks = tracks_between(prev, curr)
            if knows:
                window = replace(window, jitter_cov=cov)
            window = by.add_observed_frame(
                window,
                tracks,
                noise_of(len(tracks)),
                motion=step_to(curr.index, FORWARD),
            )
        T, relative_cov = window.relative(8, 4)
        expected = np.linalg.matrix_power(FORWARD, 4)
        squared.append(normalized_error_squared(T[None], expected[None], relative_cov[None])[0])
    low, high = chi2_interval(dof=6, count=drives)
    if knows:
        assert low < np.mean(squared) < high
    else:
        assert np.mean(squared) > 2.0 * high


def _jittered(frame: Frame, rng: np.random.Generator) -> Frame:
    """Return the frame as a right camera sees it that is turned against the left one."""
    assert frame.features is not None
    pixels = frame.features.pixels.copy()
    pixels[:, 2:] += jitter_offsets(pixels, CAMERA) @ (JITTER_SIGMA_RAD * rng.normal(size=JITTER))
    return replace(frame, features=replace(frame.features, pixels=pixels))


def _noisy(
    frames: list[Frame], rng: np.random.Generator, *, dof: float, tau_px: float
) -> list[Frame]:
    """Return the frames with noise whose scale each landmark has drawn once."""
    scales: dict[int, float] = {}
    errors: dict[int, float] = {}
    noisy = []
    for frame in frames:
        assert frame.features is not None
        pixels = frame.features.pixels.copy()
        for row, landmark in enumerate(frame.features.ids.tolist()):
            if landmark not in scales:
                gamma = 1.0 if np.isinf(dof) else rng.chisquare(dof) / dof
                scales[landmark] = float(np.sqrt(1.0 / gamma))
                errors[landmark] = float(tau_px * rng.normal())
            pixels[row] += scales[landmark] * SIGMA_PX * rng.normal(size=4)
            pixels[row, 2] -= scales[landmark] * errors[landmark]
        noisy.append(replace(frame, features=replace(frame.features, pixels=pixels)))
    return noisy


def _with_flaws(frame: Frame, disparity_px: FloatArray, kappa: float) -> Frame:
    """Return the frame as a rig with errors of the disparity and distorting lenses sees it."""
    assert frame.features is not None
    pixels = frame.features.pixels.copy()
    pixels[:, 2] += disparity_basis(pixels, CAMERA) @ disparity_px
    du, dv = distortion(frame.features.pixels[:, 0], frame.features.pixels[:, 1], kappa)
    du_r, _ = distortion(frame.features.pixels[:, 2], frame.features.pixels[:, 1], kappa)
    pixels += np.column_stack([du, dv, du_r, dv])
    return replace(frame, features=replace(frame.features, pixels=pixels))


def test_the_errors_of_the_rig_are_found_within_their_sigma() -> None:
    frames = drive(np.random.default_rng(58), 40, points=100, sigma_px=SIGMA_PX)
    true_px = np.array([0.3, -0.4, 1.2])
    true_kappa = 0.015
    seen = [_with_flaws(frame, true_px, true_kappa) for frame in frames]
    window = windows_of(seen, estimator(frames=8, calibrates=True))[-1]
    sigma = np.sqrt(np.diag(window.cov)[-RIG:])
    assert (np.abs(window.rig_errors - np.append(true_px, true_kappa)) < 3.0 * sigma).all()
    assert (sigma[:LENS] < 0.3).all()
    assert sigma[LENS] < 0.005


def test_noise_feigns_no_errors_of_the_rig() -> None:
    """The mean over drives of each error of a flawless rig is zero within 3.5 standard errors of
    their scatter.

    Taken where points are seen, not where they are predicted, κ would be biased.
    """
    found = np.array(
        [
            windows_of(
                drive(np.random.default_rng([63, seed]), 20, points=150, sigma_px=SIGMA_PX),
                estimator(frames=8, calibrates=True),
            )[-1].rig_errors
            for seed in range(12)
        ]
    )
    standard_error = found.std(axis=0, ddof=1) / np.sqrt(len(found))
    assert (np.abs(found.mean(axis=0)) < 3.5 * standard_error).all()


def test_live_steps_compound_to_the_live_pose_and_its_covariance() -> None:
    frames = drive(np.random.default_rng(59), 25, points=60, sigma_px=SIGMA_PX)
    windows = windows_of(frames, estimator(frames=6))
    motion = MotionEstimate(np.eye(4), np.eye(6), Status.OK, num_tracks=0)
    steps = [live_motion(motion, before, after) for before, after in pairwise(windows)]
    T_curr_prev = np.array([step.T_curr_prev for step in steps])
    covs = drift_covariances(
        T_curr_prev,
        np.array([step.cov for step in steps]),
        np.array([step.common_mode for step in steps]),
        path_cross_cov=np.array([step.path_cross_cov for step in steps]),
    )
    last = windows[-1].pose(-1)
    np.testing.assert_allclose(se3.chain_motions(T_curr_prev)[-1], last.T_world_cam, atol=1e-9)
    sigma = np.sqrt(np.diag(last.cov))
    np.testing.assert_allclose(
        covs[-1] / np.outer(sigma, sigma), last.cov / np.outer(sigma, sigma), atol=1e-3
    )


def test_a_step_that_corrects_the_last_one_beyond_its_covariance_claims_so() -> None:
    """A live pose that was 0.5 m off, as behind a car that the window had followed."""
    frames = drive(np.random.default_rng(72), 12, points=80, sigma_px=SIGMA_PX)
    before, after = windows_of(frames, estimator(frames=6))[-2:]
    motion = MotionEstimate(np.eye(4), np.eye(6), Status.OK, num_tracks=0)
    usual = live_motion(motion, before, after)
    poses = before.T_cam_world.copy()
    poses[-1, 2, 3] += 0.5
    corrected = live_motion(motion, replace(before, T_cam_world=poses), after)
    true = after.relative(len(after) - 1, len(after) - 2)[0]

    def squared_error(step: MotionEstimate) -> float:
        of_step = normalized_error_squared(step.T_curr_prev[None], true[None], step.cov[None])
        return float(of_step[0])

    assert squared_error(usual) < 22.5
    assert squared_error(replace(corrected, cov=usual.cov)) > 1000.0
    assert squared_error(corrected) < 2.0
    # The pose itself is as certain as before.
    for step in (usual, corrected):
        adjoint = se3.adjoint(step.T_curr_prev)
        from_before = adjoint @ before.pose(-1).cov @ adjoint.T
        total = from_before + step.cov + step.path_cross_cov + step.path_cross_cov.T
        np.testing.assert_allclose(total, after.pose(-1).cov, atol=1e-9)


def test_a_frame_without_features_is_bridged_by_its_measurement() -> None:
    """Its pose has the covariance of the measurement; that of the next frame, which features
    connect with it, is no better known than both."""
    frames = drive(np.random.default_rng(60), 6, points=80, sigma_px=SIGMA_PX)
    by = estimator(frames=5)
    window = windows_of(frames[:4], by)[-1]
    cov = np.diag([0.1, 0.1, 0.2, 0.01, 0.01, 0.01]) ** 2
    reckoned = RelativePose(FORWARD, cov, curr=pose_of(4), prev=pose_of(3))
    window = by.add_unobserved_frame(window, 4, reckoned)
    _, found = window.relative(len(window) - 1, len(window) - 2)
    np.testing.assert_allclose(found, cov, rtol=1e-6, atol=1e-12)
    tracks = tracks_between(frames[4], frames[5])
    noise = noise_of(len(tracks))
    window = by.add_observed_frame(window, tracks, noise, motion=step_to(5, FORWARD))
    _, over_gap = window.relative(window.slot(5), window.slot(3))
    assert (np.diag(over_gap) > np.diag(cov) * 0.9).all()


def test_a_place_that_is_lost_by_rounding_leaves_the_motions_known() -> None:
    """As after hundreds of blackouts, where only the motions within the window are known."""
    by = estimator(6)
    frames = drive(np.random.default_rng(65), 10, points=80, sigma_px=SIGMA_PX)
    window = windows_of(frames[:9], by)[-1]
    known = by.add_unobserved_frame(window, 9, step_to(9, FORWARD))
    size = len(window.prior.vector)
    for lost in (0.0, 1e-18):
        prior = MarginalPrior(lost * window.prior.information, np.zeros(size))
        found = by.add_unobserved_frame(replace(window, prior=prior), 9, step_to(9, FORWARD))
        last = len(found) - 1
        T_last, cov_last = found.relative(last, last - 1)
        np.testing.assert_allclose(T_last, known.relative(last, last - 1)[0], atol=1e-4)
        assert np.isfinite(found.cov).all()
        assert (np.diagonal(found.cov) > 0.0).all()
        assert np.linalg.eigvalsh(cov_last)[0] > 0.0
        tracks = tracks_between(frames[8], frames[9])
        with_features = by.add_observed_frame(
            replace(window, prior=prior),
            tracks,
            noise_of(len(tracks)),
            motion=step_to(9, FORWARD),
        )
        last = len(with_features) - 1
        T_seen, cov_seen = with_features.relative(last, last - 1)
        np.testing.assert_allclose(T_seen, FORWARD, atol=1e-2)
        # At worst, it is as well known as two frames by themselves show it.
        assert np.sqrt(cov_seen.diagonal().max()) < 0.11


def test_a_measurement_of_a_pose_draws_the_window_to_it() -> None:
    frames = drive(np.random.default_rng(61), 4, points=80, sigma_px=SIGMA_PX)
    by = estimator(frames=6, iterations=10)
    window = windows_of(frames, by)[-1]
    moved = se3.exp(np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0])) @ window.T_cam_world[-1]
    at_end = PosePrior(pose_of(3), moved, 1e-12 * np.eye(6))
    adjusted = by.adjustment.adjusted(with_measurements(window, [at_end]))
    error = se3.log(adjusted.T_cam_world[-1] @ se3.inverse(moved))
    assert np.abs(error).max() < 1e-3
    assert (np.diag(adjusted.pose(-1).cov) < 1e-11).all()


def test_features_that_fix_no_motion_give_way_to_that_of_two_frames() -> None:
    """Two features cannot fix six degrees of freedom."""
    frames = drive(np.random.default_rng(64), 4, points=80, sigma_px=SIGMA_PX)
    by = estimator(frames=6)
    window = windows_of(frames[:3], by)[-1]
    tracks = tracks_between(frames[2], frames[3]).subset(np.arange(2))
    two_frames = step_to(3, FORWARD)
    window = by.add_observed_frame(window, tracks, noise_of(2), motion=two_frames)
    T, cov = window.relative(3, 2)
    np.testing.assert_allclose(T, FORWARD, atol=1e-9)
    np.testing.assert_allclose(cov, two_frames.covariance, rtol=1e-6, atol=1e-9)


def test_a_bias_adds_up_along_a_track() -> None:
    """If each step adds the same mean error to a track, and the noise model knows it, the window is
    that of tracks without it, also of landmarks that began anew."""
    bias_px = np.array([0.2, 0.1, 0.0, 0.1])
    frames = drive(np.random.default_rng(68), 9, points=80, sigma_px=SIGMA_PX)
    by = estimator(frames=5)
    expected = windows_of(frames, by)[-1]
    first: dict[int, int] = {}
    found = Window.at_first_frame(0)
    for prev, curr in pairwise(frames):
        tracks = tracks_between(prev, curr)
        began = [first.setdefault(int(track), prev.index) for track in tracks.ids]
        steps = curr.index - np.array(began)[:, None]
        drifting = replace(
            tracks,
            prev_px=tracks.prev_px + (steps - 1) * bias_px,
            curr_px=tracks.curr_px + steps * bias_px,
        )
        noise = replace(noise_of(len(tracks)), bias=np.tile(bias_px, (len(tracks), 1)))
        two_frames = step_to(curr.index, FORWARD)
        found = by.add_observed_frame(found, drifting, noise, motion=two_frames)
    np.testing.assert_allclose(found.T_cam_world, expected.T_cam_world, atol=1e-9)
    np.testing.assert_allclose(found.cov, expected.cov, rtol=1e-6, atol=1e-12)


def test_what_two_frames_have_measured_counts_once_where_they_stand_for_the_features() -> None:
    """A sensor of the motion is in that of two frames already; one of the pose is not."""
    frames = drive(np.random.default_rng(64), 4, points=80, sigma_px=SIGMA_PX)
    by = estimator(frames=6)
    before = windows_of(frames[:3], by)[-1]
    tracks = tracks_between(frames[2], frames[3])
    singular = replace(noise_of(len(tracks)), scale=np.zeros((len(tracks), 4, 4)))
    two_frames = step_to(3, FORWARD)
    of_motion = RelativePose(FORWARD, 1e-4 * np.eye(6), pose_of(3), pose_of(2))
    window = by.add_observed_frame(
        before, tracks, singular, motion=two_frames, measurements=[of_motion]
    )
    _, cov = window.relative(3, 2)
    np.testing.assert_allclose(cov, two_frames.covariance, rtol=1e-6, atol=1e-9)
    there = FORWARD @ before.T_cam_world[-1]
    of_pose = PosePrior(pose_of(3), there, 1e-4 * np.eye(6))
    window = by.add_observed_frame(
        before, tracks, singular, motion=two_frames, measurements=[of_motion, of_pose]
    )
    assert (np.diag(window.pose(-1).cov) < 1.1e-4).all()


@pytest.mark.parametrize("variance_px2", [0.0, np.nan])
def test_a_scale_that_is_singular_gives_way_to_the_motion_of_two_frames(
    variance_px2: float,
) -> None:
    """Of one feature, along one axis of the image."""
    frames = drive(np.random.default_rng(67), 3, points=80, sigma_px=SIGMA_PX)
    by = estimator(frames=6)
    window = windows_of(frames[:2], by)[-1]
    tracks = tracks_between(frames[1], frames[2])
    noise = noise_of(len(tracks))
    scale = noise.scale.copy()
    scale[5, 3, 3] = variance_px2
    two_frames = step_to(2, FORWARD)
    window = by.add_observed_frame(window, tracks, replace(noise, scale=scale), motion=two_frames)
    T, cov = window.relative(2, 1)
    np.testing.assert_allclose(T, FORWARD, atol=1e-9)
    np.testing.assert_allclose(cov, two_frames.covariance, rtol=1e-6, atol=1e-9)


def test_a_window_without_a_solution_begins_anew_from_its_last_pose() -> None:
    """Rounding may leave a prior that is indefinite. Where that was so, each later step raised."""
    frames = drive(np.random.default_rng(68), 12, points=80, sigma_px=SIGMA_PX)
    by = estimator(frames=6)
    window = windows_of(frames[:8], by)[-1]
    prior = replace(window.prior, information=-window.prior.information)
    spoiled = replace(window, prior=prior)
    tracks = tracks_between(frames[7], frames[8])
    begun = by.add_observed_frame(
        spoiled, tracks, noise_of(len(tracks)), motion=step_to(8, FORWARD)
    )
    np.testing.assert_array_equal(begun.frames, [7, 8])
    assert [pose.frame for pose in begun.marginalized] == window.frames[:-1].tolist()
    T, cov = begun.relative(1, 0)
    np.testing.assert_allclose(T, FORWARD, atol=1e-9)
    np.testing.assert_allclose(cov, step_to(8, FORWARD).covariance, rtol=1e-6, atol=1e-12)
    # The pose before is as certain as it was, and the next frames are seen again.
    np.testing.assert_allclose(
        begun.cov_given_calibration(0), window.cov_given_calibration(-1), rtol=1e-6, atol=1e-15
    )
    for prev, curr in pairwise(frames[8:]):
        tracks = tracks_between(prev, curr)
        begun = by.add_observed_frame(
            begun, tracks, noise_of(len(tracks)), motion=step_to(curr.index, FORWARD)
        )
    T, cov = begun.relative(len(begun) - 1, len(begun) - 2)
    np.testing.assert_allclose(T, FORWARD, atol=0.02)
    assert np.trace(cov[:3, :3]) < 0.02**2


def test_correlated_errors_of_different_scales_keep_the_equations_positive() -> None:
    """Scale matrices that change a hundredfold from frame to frame, and are not proportional."""
    rng = np.random.default_rng(65)
    frames = drive(rng, 6, points=60, sigma_px=SIGMA_PX)
    by = estimator(frames=9, correlation=0.9)
    window = Window.at_first_frame(0)
    for prev, curr in pairwise(frames):
        tracks = tracks_between(prev, curr)
        factors = rng.normal(size=(len(tracks), 4, 4)) * 10.0 ** rng.uniform(
            -1, 1, (len(tracks), 1, 1)
        )
        scale = factors @ factors.mT + 0.01 * np.eye(4)
        noise = replace(noise_of(len(tracks)), scale=scale)
        window = by.extend(window, curr.index, FORWARD, tracks, noise)
        assert np.linalg.eigvalsh(by.adjustment._system(window).equations.hessian)[0] > 0.0
        window = by.adjustment.adjusted(window)


def with_standing_factors(window: Window, by: WindowEstimator) -> FloatArray:
    """Return how far each landmark is trusted to stand still, [L]."""
    return by.adjustment._with_static_weights(window).landmarks.static_weight


def squared_along_velocity(window: Window, row: int, correlation: float) -> tuple[float, float]:
    """Return s_c of a landmark, and the rest of its squared errors, by the definition."""
    observations = window.observations

    def white(window: Window, state_step: FloatArray | None = None) -> FloatArray:
        x = np.zeros(POSE * (len(window) - 1) + RIG + 4 * len(window.ids))
        if state_step is not None:
            x[POSE * (len(window) - 1) + RIG + 4 * row :][:4] = state_step
        found = residuals_of(window, x, correlation)
        of_landmark = np.repeat(window.landmark_rows == row, 4)
        of_prior = np.arange(len(window.ids)) == row
        return found[np.concatenate([of_landmark, of_prior])]

    errors = white(window)
    step = 1e-5
    of_state = np.column_stack(
        [(white(window, step * unit) - white(window, -step * unit)) for unit in np.eye(4)]
    ) / (2.0 * step)
    first = observations.start[row]
    time = observations.slot - observations.slot[first]
    of_velocity = np.column_stack(
        [
            white(
                replace(
                    window,
                    observations=observations._replace(
                        pixels=observations.pixels - time[:, None] * direction
                    ),
                )
            )
            - errors
            for direction in np.array([[1.0, 0, 1, 0], [0, 1, 0, 1], [0, 0, -1, 0]])
        ]
    )
    basis, _ = np.linalg.qr(of_state)
    basis_of_velocity, _ = np.linalg.qr(of_velocity - basis @ (basis.T @ of_velocity))
    along = float(np.sum((basis_of_velocity.T @ errors) ** 2))
    return along, float(errors @ errors) - along


@pytest.mark.parametrize("correlation", [0.0, 0.6])
def test_the_test_for_a_velocity_is_that_of_its_definition(correlation: float) -> None:
    dof = 4.0
    rng = np.random.default_rng(71)
    frames = _noisy(drive(rng, 7, points=30, sigma_px=0.0), rng, dof=dof, tau_px=TAU_PX)
    by = estimator(frames=9, correlation=correlation)
    window = windows_of(frames, by, dof=dof, tau_px=TAU_PX)[-1]
    found = with_standing_factors(window, by)
    seen = np.diff(window.observations.start)
    tested = np.flatnonzero(seen >= 3)
    assert len(tested) > 20
    for row in tested:
        along, others = squared_along_velocity(window, int(row), correlation)
        # Student-t weights of n errors: (ν + n)/(ν + s).
        scale = max(1.0, (dof + others) / (dof + 4 * seen[row] - 6))
        expected = min(1.0, (dof + 3) / (dof + along / scale))
        assert found[row] == pytest.approx(expected, rel=1e-5)
    assert found[tested].min() < 0.9  # of thirty, some errors look like a velocity
    assert (found[seen < 3] == 1.0).all()


def test_what_moves_slowly_does_not_lead_the_window() -> None:
    """A third of the points moves at 0.6 m/s, which single steps hardly show."""
    moving = se3.exp(0.95 * se3.log(FORWARD))
    errors_m: dict[bool, list[float]] = {True: [], False: []}
    factors: dict[bool, list[float]] = {True: [], False: []}
    for seed in range(6):
        rng = np.random.default_rng([72, seed])
        still = drive(rng, 14, points=60, sigma_px=SIGMA_PX)
        movers = drive(rng, 14, moving, points=30, sigma_px=SIGMA_PX)
        frames = [_joined(*pair) for pair in zip(still, movers, strict=True)]
        by = estimator(frames=9)
        for tests in (True, False):
            with pytest.MonkeyPatch.context() as patch:
                if not tests:
                    patch.setattr(
                        WindowAdjustment, "_with_static_weights", lambda _, window: window
                    )
                window = windows_of(frames, by, dof=4.0)[-1]
            T, _ = window.relative(8, 0)
            error = motion_error(T, np.linalg.matrix_power(FORWARD, 8))
            errors_m[tests].append(float(error[2]))
            if tests:
                is_tested = np.diff(window.observations.start) >= 6
                is_moving = window.ids % 2 == 1
                for moves in (True, False):
                    factors[moves] += window.landmarks.static_weight[
                        is_tested & (is_moving == moves)
                    ].tolist()
    assert np.median(factors[True]) < 0.3
    assert np.median(factors[False]) > 0.9
    rms = {tests: float(np.sqrt(np.mean(np.square(e)))) for tests, e in errors_m.items()}
    assert rms[True] < 0.5 * rms[False]


def _joined(still: Frame, movers: Frame) -> Frame:
    """Return the features of both frames; those of the latter have odd identities."""
    assert still.features is not None
    assert movers.features is not None
    return replace(
        still,
        features=StereoFeatures(
            np.concatenate([2 * still.features.ids, 2 * movers.features.ids + 1]),
            np.vstack([still.features.pixels, movers.features.pixels]),
        ),
    )


def test_frames_that_are_not_in_the_window_are_refused() -> None:
    window = windows_of(drive(np.random.default_rng(62), 3, points=30), estimator(frames=4))[-1]
    with pytest.raises(InputError, match="not in the window"):
        window.slot(7)


def test_the_same_frames_give_the_same_bytes() -> None:
    frames = drive(np.random.default_rng(63), 12, points=50, sigma_px=SIGMA_PX)
    first, second = (windows_of(frames, estimator(frames=5))[-1] for _ in range(2))
    assert first.T_cam_world.tobytes() == second.T_cam_world.tobytes()
    assert first.cov.tobytes() == second.cov.tobytes()


def test_landmarks_of_one_age_still_connect_the_last_frames() -> None:
    """All are seen in all frames, and begin anew at once: the newest motion stays known."""
    rng = np.random.default_rng(66)
    slow = se3.exp(0.02 * se3.log(FORWARD))
    frames = drive(rng, 8, slow, points=60, sigma_px=SIGMA_PX)
    assert frames[0].features is not None
    ids = frames[0].features.ids
    by = estimator(frames=4)
    for window in windows_of(frames, by, guess=slow)[1:]:
        assert np.isin(window.ids, ids).mean() > 0.8
        hessian = by.adjustment._system(window).equations.hessian[:-RIG, :-RIG]
        cov = np.linalg.inv(hessian)
        assert np.linalg.eigvalsh(cov)[0] > 0.0
        assert np.sqrt(np.diag(cov)[-POSE:]).max() < 0.1


def test_landmarks_settle_however_well_or_badly_they_fit() -> None:
    """At fixed poses, also those with the one observation with which they have begun anew, and
    with heavy tails, whose curvature is far from that of the quadratic loss."""
    by = estimator(4)
    frames = drive(np.random.default_rng(68), 9, points=150, sigma_px=3.0 * SIGMA_PX)
    window = windows_of(frames, by, dof=2.5)[-1]
    assert np.diff(window.observations.start).min() == 1
    for _ in range(60):
        before = window.landmarks.state
        system = by.adjustment._system(window)
        window = by.adjustment._incremented(system, np.zeros(len(system.equations.gradient)))
    assert np.abs(window.landmarks.state - before).max() < 1e-3


def test_a_pose_that_is_kept_keeps_no_window() -> None:
    """The path of a long run holds a pose of each frame: it must not hold the covariances of all
    windows with them."""
    left = Window.at_first_frame(0).pose(0)
    assert left.cov.base is None
    assert left.T_world_cam.base is None or left.T_world_cam.base.nbytes <= 16 * 8


def test_a_step_is_as_certain_as_the_window_knows_it_wherever_that_is() -> None:
    """Behind blackouts, which leave the place known to tens of metres and radians."""
    by = estimator(6)
    frames = drive(np.random.default_rng(67), 14, points=80, sigma_px=SIGMA_PX)
    windows = windows_of(frames[:9], by)
    lost = 1e-9 * windows[-1].prior.information
    prior = MarginalPrior(lost, np.zeros(len(lost)))
    windows = [by.adjustment.adjusted(replace(windows[-1], prior=prior))]
    for prev, curr in pairwise(frames[8:]):
        tracks = tracks_between(prev, curr)
        two_frames = step_to(curr.index, FORWARD)
        windows.append(
            by.add_observed_frame(windows[-1], tracks, noise_of(len(tracks)), motion=two_frames)
        )
    motion = MotionEstimate(np.eye(4), np.eye(6), Status.OK, num_tracks=0)
    for before, after in pairwise(windows[1:]):
        assert np.sqrt(after.pose(-1).cov[3:, 3:].diagonal().max()) > 1.0
        step = live_motion(motion, before, after)
        _, known = after.relative(len(after) - 1, len(after) - 2)
        assert (np.sqrt(step.cov.diagonal()) < 5.0 * np.sqrt(known.diagonal())).all()
        assert (np.sqrt(step.cov.diagonal()) > 0.99 * np.sqrt(known.diagonal())).all()


def test_a_prior_that_rounding_has_made_negative_keeps_what_it_says_of_motions() -> None:
    """Two poses, the motion between which is known; their place is lost."""
    between = np.kron(np.array([[1.0, -1.0], [-1.0, 1.0]]), np.diag([1e4] * 3 + [1e6] * 3))
    information = np.zeros((2 * POSE + RIG, 2 * POSE + RIG))
    information[:-RIG, :-RIG] = between - 1e-7 * np.eye(2 * POSE)
    prior = kept_positive(MarginalPrior(information, np.zeros(len(information))))
    of_poses = prior.information[:-RIG, :-RIG]
    assert np.linalg.eigvalsh(of_poses)[0] > 0.5 * MIN_POSITION_INFORMATION
    difference = np.kron(np.array([1.0, -1.0]), np.eye(POSE))
    cov = difference @ np.linalg.inv(of_poses) @ difference.T
    np.testing.assert_allclose(cov, np.diag([1e-4] * 3 + [1e-6] * 3), rtol=1e-3, atol=1e-9)
    assert kept_positive(prior) is prior


def test_dead_reckoning_is_linearised_where_the_poses_are_until_a_frame_of_it_leaves() -> None:
    """A precise motion turns dead-reckoned frames by a radian. What is said of them is what would
    be said had they been there from the start."""
    frames = drive(np.random.default_rng(67), 4, points=60, sigma_px=SIGMA_PX)
    by = estimator(frames=9, iterations=10)
    seen = windows_of(frames, by)[-1]
    turned = se3.exp(np.array([0.0, 0.0, 0.0, 0.3, 1.0, -0.2])) @ FORWARD
    known = RelativePose(turned, 1e-8 * np.eye(6), pose_of(4), pose_of(3))
    windows = []
    for guess in (FORWARD, turned):
        window = by.extend(seen, 4, guess, Tracks.none(), noise_of(0))
        window = with_dead_reckoning(window, [step_to(4, FORWARD), known])
        windows.append(by.adjustment.adjusted(window))
    adjusted, expected = windows
    np.testing.assert_allclose(adjusted.T_cam_world, expected.T_cam_world, atol=1e-6)
    np.testing.assert_array_equal(adjusted.T_linear[4], adjusted.T_cam_world[4])
    np.testing.assert_allclose(adjusted.cov, expected.cov, rtol=1e-4, atol=1e-12)
    # In the prior, it says the same where the poses are.
    leaving = np.arange(5) == 4
    fixed = with_dead_reckoning_in_prior(adjusted, leaving)
    assert not fixed.dead_reckoning
    assert with_dead_reckoning_in_prior(adjusted, np.arange(5) == 0).dead_reckoning
    before = by.adjustment._system(adjusted).equations
    after = by.adjustment._system(fixed).equations
    scale = np.abs(before.hessian).max()
    np.testing.assert_allclose(after.hessian, before.hessian, atol=1e-12 * scale)
    np.testing.assert_allclose(after.gradient, before.gradient, atol=1e-12 * scale)


def test_a_blind_frame_between_two_that_see_a_landmark_changes_nothing_for_them() -> None:
    """The normal equations of all other frames are those of a window without it."""
    frames = drive(np.random.default_rng(66), 6, points=60, sigma_px=SIGMA_PX)
    by = estimator(frames=9)
    before = windows_of(frames[:4], by)[-1]
    seen = tracks_between(frames[3], frames[5])
    noise = noise_of(len(seen))
    none = noise_of(0)
    expected = by.extend(before, 5, FORWARD @ FORWARD, seen, noise)
    blind = by.extend(before, 4, FORWARD, Tracks.none(), none)
    found = by.extend(blind, 5, FORWARD @ FORWARD, seen, noise, prev=3)
    np.testing.assert_array_equal(found.is_blind, [False, False, False, False, True, False])
    np.testing.assert_array_equal(found.frames, [0, 1, 2, 3, 4, 5])
    kept = np.delete(np.arange(6 * POSE + RIG), np.arange(4 * POSE, 5 * POSE))
    wanted = by.adjustment._system(expected).equations
    equations = by.adjustment._system(found).equations
    scale = np.abs(wanted.hessian).max()
    np.testing.assert_allclose(
        equations.hessian[np.ix_(kept, kept)], wanted.hessian, rtol=1e-9, atol=1e-12 * scale
    )
    np.testing.assert_allclose(equations.gradient[kept], wanted.gradient, rtol=1e-6, atol=1e-6)
    assert np.abs(equations.hessian[4 * POSE : 5 * POSE]).max() == 0.0
    # Marginalised, it takes along what measured nothing but itself.
    measured = by.adjustment.adjusted(with_measurements(found, [step_to(4, FORWARD)]))
    without = without_blind(measured, found.is_blind)
    attached = np.arange(3 * POSE, 4 * POSE)  # to frame 3, of which no other prior speaks
    assert np.abs(measured.prior.information[np.ix_(attached, attached)]).max() > 10.0
    assert np.abs(without.prior.information[np.ix_(attached, attached)]).max() < 1e-3
    np.testing.assert_array_equal(without.frames, expected.frames)
    np.testing.assert_array_equal(without.observations.slot, expected.observations.slot)
