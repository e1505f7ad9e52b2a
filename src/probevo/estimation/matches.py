"""The solver alone: the motion between two frames, from matches of another front end."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.rig_jitter import common_sigma_px
from probevo.camera.stereo import StereoCamera
from probevo.config import RansacConfig
from probevo.errors import InputError, brief
from probevo.estimation.feature_weights import (
    agree_with_noise,
    comparable_weights,
    num_inliers,
    scale_of_residuals,
)
from probevo.estimation.motion_estimate import MAX_UNKNOWN, MotionEstimate, Status
from probevo.estimation.noise_scale import MAX_FACTOR
from probevo.estimation.ransac import InlierThreshold, find_consensus
from probevo.estimation.reprojection import (
    ReprojectionSolution,
    evaluated_at,
    solve_reprojection,
)
from probevo.geometry import se3
from probevo.measurements.stereo_observations import StereoObservations
from probevo.noise import NoiseModel, StereoNoise
from probevo.noise.base import has_relative_scale, predicted_noise
from probevo.python_arguments import as_camera, as_finite_array, as_noise, as_seed
from probevo.tracking.left_right import check_features
from probevo.tracking.tracks import Tracks

MIN_MATCHES = 3
"""Minimum number of points that determine a motion."""
MIN_VARIANCE_PX2 = 1e-12
"""Smallest variance of an observation: below, its inverse is rounding."""
MAX_SOLVES = 4
"""Solves, after each of which all matches are tested again."""
MAX_LOG_FACTOR_CHANGE = 0.05
"""Change of the noise, as that of the logarithm of its variances, that needs no further solve."""
THRESHOLD_SIGMAS = 4.0
"""Threshold of RANSAC in standard deviations of a usual residual: hardly an inlier is beyond."""


def estimate_motion(
    prev_px: ArrayLike,
    curr_px: ArrayLike,
    noise: NoiseModel | StereoNoise | str | Path | ArrayLike,
    camera: StereoCamera,
    *,
    guess: ArrayLike | None = None,
    seed: int = 0,
) -> MotionEstimate:
    """Estimate the motion between two frames from N stereo matches: T_curr_prev, its covariance.

    RANSAC finds a start, and the solver uses the matches that their noise explains there, each
    weighted by it. Of a model whose scale is relative (``has_relative_scale``), the variances are
    multiplied by what the residuals show (``MotionEstimate.noise_factor``). Calls are independent
    of each other, so the covariance contains no error that persists over frames.

    Args:
        prev_px: (u_l, v_l, u_r, v_r) in the previous frame, rectified, [N, 4], px.
        curr_px: the same points in the current frame, [N, 4], px.
        noise: covariance of an observation, [4, 4] or [N, 4, 4], px²; a ``StereoNoise`` of the N
            matches; or a noise model without predictors, by its name or file too.
        camera: the rectified camera.
        guess: where to start, T_curr_prev, [4, 4]; no motion by default.
        seed: of the samples of RANSAC; the same seed gives the same result.

    Returns:
        The estimate. If the matches do not determine a motion, the status says so, T_curr_prev is
        the guess, and the covariance that of a motion of which nothing is known.

    Raises:
        InputError: an array has a wrong shape or is not finite, left and right are swapped, a
            covariance is not positive definite, the guess is no rigid motion, the noise depends on
            predictors, the camera is impossible, or the seed negative.
    """
    camera = as_camera(camera)
    prev = as_finite_array(prev_px, "prev_px", (None, 4))
    curr = as_finite_array(curr_px, "curr_px", (len(prev), 4))
    match_noise, scale_is_relative = _as_match_noise(noise, len(prev), camera)
    start = np.eye(4)
    if guess is not None:
        start = se3.check_transform(as_finite_array(guess, "guess", (4, 4)), "guess")
    rng = np.random.default_rng(as_seed(seed))
    ids = np.arange(len(prev))
    tracks = Tracks(prev_px=prev, curr_px=curr, ids=ids, age=np.full(len(prev), 2))
    check_features(tracks, "curr_px")
    if len(tracks) < MIN_MATCHES:
        return _failed(Status.TOO_FEW_TRACKS, start, len(tracks))

    # Inliers and a start by RANSAC, with thresholds in px that matches of this noise pass.
    consensus = find_consensus(
        tracks,
        camera,
        rng,
        guess=start,
        threshold=InlierThreshold(
            _threshold_px(match_noise), common_sigma_px(match_noise.jitter_cov, camera)
        ),
    )
    # From there each match is tested by its own noise, again and again as the motion improves. If
    # those within one threshold were kept instead, noisy matches would be cut off, and the
    # covariance would be too small.
    agreeing = consensus.inliers
    T_curr_prev = consensus.T_curr_prev
    factor = 1.0
    factor_shown = 1.0
    for _ in range(MAX_SOLVES):
        used = agreeing
        factor = factor_shown
        if used.sum() < MIN_MATCHES:
            return _failed(Status.TOO_FEW_TRACKS, start, len(tracks))
        solution = _solved(tracks, match_noise.scaled(factor), used, camera, T_curr_prev)
        T_curr_prev = solution.T_curr_prev
        squared = _squared_residuals(tracks, match_noise, camera, solution)
        if scale_is_relative:
            factor_shown = _noise_factor(squared, match_noise)
        agreeing = agree_with_noise(squared, match_noise.dof, factor_shown)
        is_same_noise = abs(math.log(factor_shown / factor)) < MAX_LOG_FACTOR_CHANGE
        if (agreeing == used).all() and is_same_noise:
            break
    if not np.isfinite(solution.cov).all():
        return _failed(Status.DEGENERATE, start, len(tracks))
    return MotionEstimate(
        T_curr_prev=solution.T_curr_prev,
        cov=solution.cov,
        status=Status.OK if solution.converged else Status.NOT_CONVERGED,
        num_tracks=len(tracks),
        num_inliers=num_inliers(comparable_weights(solution.features, match_noise.dof[used])),
        iterations=solution.iterations,
        num_used=int(used.sum()),
        noise_factor=factor,
    )


def _noise_factor(squared: FloatArray, noise: StereoNoise) -> float:
    """Return the factor by which the variances of a noise model would fit the residuals at a motion
    that was solved for, [N]: as that of one step (``NoiseScale``)."""
    shown = scale_of_residuals(squared, noise.dof, num_fitted=6)
    return min(max(shown, 1.0 / MAX_FACTOR), MAX_FACTOR)


def _threshold_px(noise: StereoNoise) -> float:
    """Return the threshold of RANSAC for matches of this noise, at least that of the odometry."""
    # A residual has the noise of both observations; each coordinate has its own.
    both = 2.0 if noise.refers_to == "observation" else 1.0
    largest_px2 = both * np.diagonal(noise.scale, axis1=1, axis2=2).max(axis=1)
    usual_px = float(np.sqrt(np.median(largest_px2)))
    return max(RansacConfig().threshold_px, THRESHOLD_SIGMAS * usual_px)


def _solved(
    tracks: Tracks,
    noise: StereoNoise,
    used: BoolArray,
    camera: StereoCamera,
    guess: FloatArray,
) -> ReprojectionSolution:
    """Return the motion by some of N matches, [N], from a guess T_curr_prev, [4, 4]."""
    observations = StereoObservations.of(
        tracks.prev_px[used],
        tracks.curr_px[used],
        noise.subset(np.flatnonzero(used)),
        camera=camera,
    )
    return solve_reprojection(observations, guess=guess)


def _squared_residuals(
    tracks: Tracks, noise: StereoNoise, camera: StereoCamera, solution: ReprojectionSolution
) -> FloatArray:
    """Return how far N matches are from a solve, from its motion and its jitter of the rig, in
    their noise: eᵀ Σ⁻¹ e, [N]."""
    observations = StereoObservations.of(tracks.prev_px, tracks.curr_px, noise, camera=camera)
    return evaluated_at(solution, observations).features.mahalanobis_sq


def _as_match_noise(noise: object, count: int, camera: StereoCamera) -> tuple[StereoNoise, bool]:
    """Return the noise of the matches, and whether it is that of a model whose scale is relative.

    Raises:
        InputError: it is no noise, or does not fit the matches.
    """
    if isinstance(noise, StereoNoise):
        if len(noise.dof) != count:
            raise InputError("noise", f"is that of {len(noise.dof)} features, not of {count}.")
        for scale in (noise.scale, noise.prev_scale):
            if scale is not None:
                _check_covariances(scale)
        return noise, False
    if isinstance(noise, str | Path) or hasattr(noise, "predict"):
        model = as_noise(noise)
        model.check_camera(camera)
        if model.columns:
            what = f"depends on the predictors {', '.join(model.columns)}."
            cure = "Give what it predicts for these matches: model.predict(phi), a StereoNoise."
            raise InputError("noise", what, cure)
        return predicted_noise(model, np.zeros((count, 0))), has_relative_scale(model)
    return _gaussian(noise, count), False


def _gaussian(noise: object, count: int) -> StereoNoise:
    """Return Gaussian noise with covariances of single observations.

    Raises:
        InputError: they are no covariances.
    """
    is_common = np.ndim(np.asarray(noise, dtype=object)) == 2
    cov = as_finite_array(noise, "noise", (4, 4) if is_common else (count, 4, 4))
    _check_covariances(cov)
    scale = np.array(np.broadcast_to(cov, (count, 4, 4)))
    dof = np.full(count, np.inf)
    return StereoNoise(scale, dof, bias=np.zeros((count, 4)), refers_to="observation")


def _check_covariances(cov: FloatArray) -> None:
    """Refuse covariances, [..., 4, 4], px², of which one is none.

    Raises:
        InputError: one is not finite, not symmetric, or not positive definite.
    """
    if not np.isfinite(cov).all():
        raise InputError("noise", "a covariance is not finite.")
    rounding = 1e-9 * float(np.abs(cov).max(initial=0.0))
    if not np.allclose(cov, cov.swapaxes(-1, -2), rtol=1e-6, atol=rounding):
        raise InputError("noise", "a covariance is not symmetric.")
    smallest = float(np.linalg.eigvalsh(cov).min(initial=np.inf))
    if smallest < MIN_VARIANCE_PX2:
        what = f"a covariance has the variance {brief(smallest)} px² in a direction."
        raise InputError("noise", what, "It must be positive definite, in px².")


def _failed(status: Status, T_curr_prev: FloatArray, num_tracks: int) -> MotionEstimate:
    """Return the estimate if the matches do not determine a motion: the guess, as unknown."""
    cov = np.diag(MAX_UNKNOWN**2)
    return MotionEstimate(T_curr_prev=T_curr_prev, cov=cov, status=status, num_tracks=num_tracks)
