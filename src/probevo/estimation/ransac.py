"""Random sample consensus over minimal motions: three points, or one where a gyro gives the
rotation (PROBE V)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import NEAREST, Intrinsics, move_point
from probevo.compiled import compiled, copy_into, solve_positive_definite
from probevo.geometry.se3_numba import perturb
from probevo.measurements.robust_loss_numba import LossKind
from probevo.measurements.stereo_numba import (
    LossParameters,
    NormalEquations,
    PropagatedNoise,
    normal_equations,
)
from probevo.tracking.tracks import Tracks

INLIER_RATIO = 0.5
"""Share of inliers that is assumed at first, as in PROBE."""
MIN_INLIER_SHARE = 0.25
"""Least share of inliers that is looked for; with fewer, no motion is accepted."""

SAMPLE_ITERATIONS = 6
"""Gauss–Newton iterations for the motion of a sample, at most."""
SAMPLE_STEP = 1e-4
"""Length of a step ξ, m and rad together, at which the motion of a sample has converged: far below
what moves a feature by its threshold."""

COMMON_WITHIN = 3.0
"""Standard deviations within which an error common to all features is tolerated."""


@dataclass(frozen=True)
class InlierThreshold:
    """Largest reprojection error of an inlier."""

    all_px: float
    """Largest error in any of u_l, v_l, u_r."""
    right_sigma_px: float = 0.0
    """Standard deviation of an error that is the same for all u_r of the step, such as a flexing
    rig causes: it widens the threshold of u_r, and lowers its weight."""

    @property
    def right_px(self) -> float:
        """Largest error in u_r."""
        return math.hypot(self.all_px, COMMON_WITHIN * self.right_sigma_px)


@dataclass(frozen=True)
class Consensus:
    """The motion that most features agree on."""

    T_curr_prev: FloatArray
    """[4, 4]; from a minimal sample, so only a start for a solve."""
    inliers: BoolArray
    """Features within the threshold of it, [N]."""


def num_hypotheses(confidence: float) -> int:
    """Return how many samples of three points contain one without outliers, with this confidence.

    It is 35 at a confidence of 99 %, 69 at 99.99 % (Fischler & Bolles 1981).
    """
    return _num_samples(INLIER_RATIO**3, confidence)


def _num_samples(probability: float, confidence: float) -> int:
    """Return how many samples contain a good one, with this confidence, if each is good with a
    probability."""
    if probability >= confidence:
        return 1
    return math.ceil(math.log(1.0 - confidence) / math.log1p(-probability))


def _num_samples_needed(inliers: BoolArray, sample_size: int, confidence: float) -> int:
    """Return how many samples of points drawn at random contain one of different inliers only, with
    this confidence, where so many of N points are inliers.

    Fewer than ``MIN_INLIER_SHARE`` are not looked for, and none among fewer points than a sample
    has.
    """
    count = len(inliers)
    if count < sample_size:
        return 0
    num_inliers = max(int(inliers.sum()), math.ceil(MIN_INLIER_SHARE * count), sample_size)
    # Of a few points, the same one is often drawn twice.
    probability = 1.0
    for k in range(sample_size):
        probability *= (num_inliers - k) / count
    return _num_samples(probability, confidence)


def find_consensus(
    tracks: Tracks,
    camera: StereoCamera,
    rng: np.random.Generator,
    *,
    guess: FloatArray,
    threshold: InlierThreshold,
    C_curr_prev: FloatArray | None = None,
    confidence: float = 0.99,
) -> Consensus:
    """Find the best of the motions of random minimal samples.

    The best has the least sum of truncated squared reprojection errors over all features.

    The motion of a sample minimises the reprojection error in (u_l, v_l, u_r), by Gauss–Newton from
    the guess. Unlike an alignment of triangulated points, this does not suffer from the depth noise
    of far points. The guess itself is a candidate, too.

    Args:
        tracks: the N features.
        camera: the rectified camera.
        rng: source of the samples.
        guess: predicted T_curr_prev, [4, 4].
        threshold: largest error of an inlier in any of u_l, v_l, u_r.
        C_curr_prev: rotation from a gyro, [3, 3]; a sample is then a single point.
        confidence: probability that at least one sample of three is free of outliers. As many
            samples of one point are drawn with a gyro, as in PROBE: fewer would do against
            outliers, but each motion has the depth noise of its point, and the best is chosen.
            Where fewer than half of the features are inliers, more are drawn.
    """
    sample_size = 3 if C_curr_prev is None else 1
    start = np.array(guess)
    # The sample's translation is solved for; its rotation stays the gyro's.
    if C_curr_prev is not None:
        start[:3, :3] = C_curr_prev
    problem = _Problem.of(tracks, camera, threshold, start=start, sample_size=sample_size)
    return _consensus(problem, rng, confidence=confidence)


def find_consensus_near(
    tracks: Tracks,
    camera: StereoCamera,
    rng: np.random.Generator,
    *,
    guess: FloatArray,
    cov: FloatArray,
    threshold: InlierThreshold,
    confidence: float,
) -> Consensus:
    """Find the best of the motions of random minimal samples of three that are near a guess.

    Args:
        tracks: the N features.
        camera: the rectified camera.
        rng: source of the samples.
        guess: predicted T_curr_prev, [4, 4].
        cov: covariance by which the squared Mahalanobis distance to the guess is to be at most 1,
            [6, 6].
        threshold: largest error of an inlier in any of u_l, v_l, u_r.
        confidence: see ``find_consensus``.
    """
    near = np.ascontiguousarray(np.linalg.inv(cov), np.float64)
    problem = _Problem.of(tracks, camera, threshold, start=np.array(guess), near=near)
    return _consensus(problem, rng, confidence=confidence)


class _Problem(NamedTuple):
    """The features and the threshold that every sample is tested with."""

    points: FloatArray
    """(u, v, d) of N features in the previous frame, [N, 3], px."""
    curr: FloatArray
    """Their observations in the current frame, [N, 4], px."""
    camera: Intrinsics
    threshold_px: float
    right_share: float
    """The threshold of u_l and v over that of u_r, 0 to 1."""
    start: FloatArray
    """Where the motion of a sample starts, T_curr_prev, [4, 4]."""
    sample_size: int
    """3, or 1 to keep the rotation of the start."""
    near: FloatArray
    """Information by which the distance to the start is measured, which is to be 1 at most, [6, 6];
    zeros for no limit."""

    @staticmethod
    def of(
        tracks: Tracks,
        camera: StereoCamera,
        threshold: InlierThreshold,
        *,
        start: FloatArray,
        sample_size: int = 3,
        near: FloatArray | None = None,
    ) -> _Problem:
        """Return the problem of these tracks."""
        # (u, v, d) instead of (X, Y, Z): a point kilometres away has a finite disparity.
        disparity = tracks.prev_px[:, 0] - tracks.prev_px[:, 2]
        points = np.column_stack([tracks.prev_px[:, :2], disparity])
        return _Problem(
            points=np.ascontiguousarray(points),
            curr=np.ascontiguousarray(tracks.curr_px),
            camera=Intrinsics.of(camera),
            threshold_px=threshold.all_px,
            right_share=threshold.all_px / threshold.right_px,
            start=np.ascontiguousarray(start),
            sample_size=sample_size,
            near=np.zeros((6, 6)) if near is None else near,
        )


def _consensus(problem: _Problem, rng: np.random.Generator, *, confidence: float) -> Consensus:
    """Return the best of the motions of random samples, and its inliers; the start competes.

    Args:
        problem: features, threshold and start.
        rng: source of the samples.
        confidence: that of a sample without outliers.
    """
    count = len(problem.points)
    size = problem.sample_size
    T_curr_prev = problem.start.copy()
    inliers = np.zeros(count, np.bool_)
    loss = LossParameters(int(LossKind.L2), np.ones(size))
    num_drawn = 0
    num_wanted = num_hypotheses(confidence)
    while num_drawn < num_wanted:
        samples = _drawn(count, (num_wanted - num_drawn, size), rng)
        _best_sample(problem, samples, loss, T_best=T_curr_prev, inliers=inliers)
        num_drawn = num_wanted
        num_wanted = _num_samples_needed(inliers, size, confidence)
    return Consensus(T_curr_prev, inliers)


def _drawn(count: int, shape: tuple[int, int], rng: np.random.Generator) -> IntArray:
    """Draw samples, [M, size], from so many points; none if there are fewer than a sample has."""
    if count < shape[1]:
        return np.zeros((0, shape[1]), np.int64)
    return rng.integers(count, size=shape)


@compiled
def _best_sample(
    problem: _Problem,
    samples: IntArray,
    loss: LossParameters,
    T_best: FloatArray,
    inliers: BoolArray,
) -> None:
    """Replace a motion T_best by the best one of all samples, if that is better, and mark its
    inliers.

    The residuals of a sample have unit information on (u_l, v_l, u_r) and none on v_r.

    Args:
        problem: features and threshold.
        samples: rows of the features of each, [M, 3] or [M, 1].
        loss: that of the samples.
        T_best: the best so far, which competes, [4, 4].
        inliers: receives those of the best, [N].
    """
    T_start = problem.start
    size = problem.sample_size
    free = 6 if size == 3 else 3  # entries of ξ = [ρ; φ]; the rotation of a single point is held
    T = np.empty((4, 4))
    T_moved = np.empty((4, 4))
    curr = np.empty((size, 4))
    sample = PropagatedNoise(
        np.empty((size, 3)), np.zeros((size, 4)), np.zeros((size, 4, 4)), np.zeros((size, 4, 2))
    )
    # v_r repeats v_l in rectified images. Without it, a sample of three has nine residuals for six
    # unknowns, and a tilt of the right camera does not pull at the motion.
    for i in range(3):
        sample.information[:, i, i] = 1.0
    sample.information[:, 2, 2] = problem.right_share * problem.right_share
    system = NormalEquations(np.empty((6, 6)), np.empty(6), np.empty(size))
    newton = problem.threshold_px < 0.0  # False; as a literal it would compile the loop once more
    lower = np.zeros((6, 6))
    step = np.zeros(6)
    # The start competes: where the motion hardly changes, it is better than a noisy sample.
    best = _truncated_cost(problem, T_best, np.inf, inliers)
    for k in range(len(samples)):
        # The motion of the sample: Gauss–Newton from the guess, all points exact and L2.
        for i in range(size):
            copy_into(sample.refined[i], problem.points[samples[k, i]])
            copy_into(curr[i], problem.curr[samples[k, i]])
        copy_into(T, T_start)
        solvable = True
        # A few undamped steps are enough: a sample with an outlier may diverge, and loses by its
        # cost.
        for _ in range(SAMPLE_ITERATIONS):
            normal_equations(T, problem.camera, curr, sample, loss, newton, system)
            solvable = solve_positive_definite(
                system.hessian, system.gradient[:free], lower, solution=step
            )
            if not solvable:
                break
            # With a gyro, the last three entries of the step stay zero: the rotation is held.
            perturb(step, T, T_moved)
            copy_into(T, T_moved)
            if np.sum(step * step) < SAMPLE_STEP**2:
                break
        if solvable and _is_near(T, T_start, problem.near):
            # Most samples are given up early: as soon as they cost more than the best one.
            cost = _truncated_cost(problem, T, best, inliers)
            if cost < best:
                best = cost
                copy_into(T_best, T)
    # Later samples have overwritten the mask of inliers: evaluate the best one again.
    _truncated_cost(problem, T_best, np.inf, inliers)


@compiled
def _is_near(T: FloatArray, T_guess: FloatArray, information: FloatArray) -> bool:
    """Return whether the squared Mahalanobis distance of a motion [4, 4] to the guess is at most 1,
    for an information of [6, 6]."""
    # ξ of T = Exp(ξ) T_guess for a small rotation: C − Cᵀ is twice the skew matrix of φ.
    xi = np.empty(6)
    C = np.empty((3, 3))
    for i in range(3):
        xi[i] = T[i, 3]
        for j in range(3):
            C[i, j] = 0.0
            for n in range(3):
                C[i, j] += T[i, n] * T_guess[j, n]
            xi[i] -= C[i, j] * T_guess[j, 3]
    xi[3] = 0.5 * (C[2, 1] - C[1, 2])
    xi[4] = 0.5 * (C[0, 2] - C[2, 0])
    xi[5] = 0.5 * (C[1, 0] - C[0, 1])
    squared = 0.0
    for i in range(6):
        for j in range(6):
            squared += xi[i] * information[i, j] * xi[j]
    return bool(squared <= 1.0)


@compiled
def _truncated_cost(
    problem: _Problem, T: FloatArray, give_up_at: float, inliers: BoolArray
) -> float:
    """Return Σ min(error², threshold²), the error being the largest of u_l, v_l, u_r.

    It marks the inliers, and stops once the sum reaches ``give_up_at``.
    """
    fu, fv, cu, cv, fb = problem.camera
    curr = problem.curr
    limit = problem.threshold_px * problem.threshold_px
    total = 0.0
    for n in range(len(problem.points)):
        X, Y, Z, rho = move_point(T, problem.camera, problem.points[n])
        squared = limit  # of a point behind the camera, as of any other outlier
        if Z > NEAREST:
            # Rows are compared in the left image only, as in the samples.
            e0 = fu * X / Z + cu - curr[n, 0]
            e1 = fv * Y / Z + cv - curr[n, 1]
            e2 = problem.right_share * ((fu * X - fb * rho) / Z + cu - curr[n, 2])
            squared = max(e0 * e0, e1 * e1, e2 * e2)
        inliers[n] = squared < limit
        total += min(squared, limit)
        if total >= give_up_at:
            return total
    return total
