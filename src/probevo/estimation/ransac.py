"""Random sample consensus over minimal motions: three points, or one where a gyro gives the
rotation (PROBE V)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.compiled import compiled, copy_into, perturb, solve_positive_definite
from probevo.measurements.normal_equations_numba import normal_equations
from probevo.measurements.stereo_numba import NEAREST

INLIER_RATIO = 0.5
"""Share of inliers that is assumed, as in PROBE."""


@dataclass(frozen=True)
class Consensus:
    """The motion that most features agree on."""

    T_curr_prev: FloatArray
    """[4, 4]; from a minimal sample, so only a start for a solve."""
    inliers: BoolArray
    """Features within the threshold of it, [N]."""


def num_hypotheses(confidence: float) -> int:
    """Samples of three points needed for one without outliers (Fischler & Bolles 1981): 35 at 99 %,
    69 at 99.99 %."""
    return math.ceil(math.log(1.0 - confidence) / math.log(1.0 - INLIER_RATIO**3))


def find_consensus(
    prev_px: FloatArray,
    curr_px: FloatArray,
    camera: StereoCamera,
    rng: np.random.Generator,
    *,
    guess: FloatArray,
    C_curr_prev: FloatArray | None = None,
    threshold_px: float = 2.0,
    confidence: float = 0.99,
) -> Consensus:
    """The best of the motions of random minimal samples, by the truncated squared reprojection
    error of all features.

    The minimal motions minimise the reprojection error in (u_l, v_l, u_r) by Gauss–Newton from the
    guess, which, other than aligning triangulated points, does not suffer from the depth noise of
    far ones. The guess itself competes too.

    Args:
        prev_px, curr_px: observations of N features, [N, 4], px.
        camera: the rectified camera.
        rng: source of the samples.
        guess: expected T_curr_prev, [4, 4].
        C_curr_prev: rotation from a gyro, [3, 3]; a sample is then a single point.
        threshold_px: largest error of an inlier in any of u_l, v_l, u_r.
        confidence: probability that at least one sample of three is free of outliers. As many
            samples of one are drawn with a gyro (PROBE does so too): each carries the depth noise
            of its point, and needs the choice.
    """
    sample_size = 3 if C_curr_prev is None else 1
    count = len(prev_px)
    start = np.array(guess)
    if C_curr_prev is not None:
        start[:3, :3] = C_curr_prev
    samples = np.zeros((0, sample_size), dtype=np.int64)
    if count >= sample_size:
        samples = rng.integers(count, size=(num_hypotheses(confidence), sample_size))
    intrinsics = np.array(
        [camera.fu_px, camera.fv_px, camera.cu_px, camera.cv_px, camera.fu_px * camera.baseline_m]
    )
    points = np.column_stack([prev_px[:, :2], prev_px[:, 0] - prev_px[:, 2]])
    C = np.ascontiguousarray(start[:3, :3])
    t = np.ascontiguousarray(start[:3, 3])
    inliers = np.zeros(count, np.bool_)
    _best_sample(
        points,
        np.ascontiguousarray(curr_px),
        intrinsics,
        samples=samples,
        free=6 if sample_size == 3 else 3,
        threshold=threshold_px,
        best_C=C,
        best_t=t,
        inliers=inliers,
    )
    motion = np.eye(4)
    motion[:3, :3] = C
    motion[:3, 3] = t
    return Consensus(motion, inliers)


@compiled
def _best_sample(
    points: FloatArray,
    curr: FloatArray,
    camera: FloatArray,
    samples: IntArray,
    free: int,
    threshold: float,
    best_C: FloatArray,
    best_t: FloatArray,
    inliers: BoolArray,
) -> None:
    """Replace the guess (best_C, best_t) by the best motion of all samples, and mark its inliers.

    Of ξ = [ρ; φ] the first ``free`` entries are solved for: 6, or 3 to keep the rotation.
    """
    size = samples.shape[1]
    start_C = best_C.copy()
    start_t = best_t.copy()
    C = np.empty((3, 3))
    t = np.empty(3)
    C_new = np.empty((3, 3))
    t_new = np.empty(3)
    seen = np.empty((size, 3))
    observed = np.empty((size, 4))
    offset = np.zeros((size, 4))
    squared = np.empty(size)
    parameter = np.ones(size)
    information = np.zeros((size, 4, 4))
    for i in range(3):
        information[:, i, i] = 1.0
    near = (
        threshold < 0.0
    )  # False, but no literal: normal_equations would be compiled for that, too
    kind = int(near)
    hessian = np.empty((6, 6))
    gradient = np.empty(6)
    lower = np.zeros((6, 6))
    step = np.zeros(6)
    best = _truncated_cost(
        start_C,
        start_t,
        points,
        curr=curr,
        camera=camera,
        threshold=threshold,
        give_up_at=np.inf,
        inliers=inliers,
    )
    for k in range(len(samples)):
        for i in range(size):
            copy_into(seen[i], points[samples[k, i]])
            copy_into(observed[i], curr[samples[k, i]])
        copy_into(C, start_C)
        copy_into(t, start_t)
        solvable = True
        for _ in range(6):
            normal_equations(
                C,
                t,
                camera,
                refined=seen,
                offset=offset,
                curr=observed,
                information=information,
                kind=kind,
                parameter=parameter,
                near=near,
                hessian=hessian,
                gradient=gradient,
                squared=squared,
            )
            solvable = solve_positive_definite(hessian, gradient[:free], lower, solution=step)
            if not solvable:
                break
            perturb(step, C, t, C_out=C_new, t_out=t_new)
            copy_into(C, C_new)
            copy_into(t, t_new)
            if np.sum(step * step) < 1e-8:
                break
        if solvable:
            cost = _truncated_cost(
                C,
                t,
                points,
                curr=curr,
                camera=camera,
                threshold=threshold,
                give_up_at=best,
                inliers=inliers,
            )
            if cost < best:
                best = cost
                copy_into(best_C, C)
                copy_into(best_t, t)
    _truncated_cost(
        best_C,
        best_t,
        points,
        curr=curr,
        camera=camera,
        threshold=threshold,
        give_up_at=np.inf,
        inliers=inliers,
    )


@compiled
def _truncated_cost(
    C: FloatArray,
    t: FloatArray,
    points: FloatArray,
    curr: FloatArray,
    camera: FloatArray,
    threshold: float,
    give_up_at: float,
    inliers: BoolArray,
) -> float:
    """Σ min(error², threshold²), the error being the largest of u_l, v_l, u_r; stops at
    ``give_up_at``."""
    fu, fv, cu, cv, fb = camera
    limit = threshold * threshold
    total = 0.0
    for n in range(len(points)):
        mx = (points[n, 0] - cu) / fu
        my = (points[n, 1] - cv) / fv
        rho = points[n, 2] / fb
        X = C[0, 0] * mx + C[0, 1] * my + C[0, 2] + rho * t[0]
        Y = C[1, 0] * mx + C[1, 1] * my + C[1, 2] + rho * t[1]
        Z = C[2, 0] * mx + C[2, 1] * my + C[2, 2] + rho * t[2]
        squared = limit
        if Z > NEAREST:
            e0 = fu * X / Z + cu - curr[n, 0]
            e1 = fv * Y / Z + cv - curr[n, 1]
            e2 = (fu * X - fb * rho) / Z + cu - curr[n, 2]
            squared = max(e0 * e0, e1 * e1, e2 * e2)
        inliers[n] = squared < limit
        total += min(squared, limit)
        if total >= give_up_at:
            return total
    return total
