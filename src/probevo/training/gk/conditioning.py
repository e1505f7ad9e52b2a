"""Fusion of the motions of a drive with its truth: both are Gaussian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.estimation.visual_motion import MOTIONS_DIFFER_FROM
from probevo.geometry import se3
from probevo.training.supervision import Supervision

LEAST_TRUTH_SIGMA = np.array([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])
"""Least standard deviation of the truth, m and rad: no truth is more accurate."""
FEW_STRETCHES = 20
"""With fewer stretches, the accuracy of the truth cannot be estimated reliably."""
LOOP_SIGMA = np.array([0.1, 0.1, 0.1, 0.02, 0.02, 0.02])
"""Standard deviation of a loop closure that was not measured, m and rad: the vehicle is parked by
hand."""


@dataclass(frozen=True)
class _Stretch:
    """The m steps of a stretch, and the distance of its motion from the truth."""

    first: int
    """First step."""
    end: int
    """The step after the last one."""
    to_end: FloatArray
    """Adjoint Ad_k that maps a perturbation of each step to one of the whole motion, [m, 6, 6]."""
    cov: FloatArray
    """Covariance M of the whole motion, [6, 6]."""
    distance: FloatArray
    """ξ = Log(T_true T⁻¹), [6], m and rad."""


def conditioned(
    T_curr_prev: FloatArray,
    cov: FloatArray,
    supervision: Supervision,
    truth_sigma: FloatArray | None,
    is_solved: BoolArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Condition the motions of K − 1 steps on the true motion over each stretch.

    The motion over a stretch is T = T_m … T_1, and perturbations ξ_k of its steps move it by
    Σ Ad_k ξ_k with Ad_k = Ad(T_m … T_{k+1}). With M = Σ Ad_k C_k Ad_kᵀ, the covariance P of the
    truth and its distance ξ = Log(T_true T⁻¹), each step moves by C_k Ad_kᵀ (M + P)⁻¹ ξ. For
    stretches of one step this is the fusion of two Gaussians.

    P is estimated from the distances of the stretches whose steps are all solved unless it is
    given, or the loop is only assumed to close. Truth that fails the gate
    ξᵀ(M + P)⁻¹ξ ≤ MOTIONS_DIFFER_FROM is then not used; without any such stretch, none is used.

    Args:
        T_curr_prev: motion of each step, [K − 1, 4, 4].
        cov: covariance of each motion, [K − 1, 6, 6].
        supervision: true motions over the stretches.
        truth_sigma: standard deviation of the truth over a stretch, m and rad, [6]; None to
            estimate it.
        is_solved: whether the features determine the motion of each step, [K − 1]; by default all.

    Returns:
        motions [K − 1, 4, 4] and covariances [K − 1, 6, 6] given the truth.
    """
    # The distance of each stretch from the truth.
    motions = T_curr_prev.copy()
    posterior = cov.copy()
    stretches = []
    for i, (first, end) in enumerate(supervision.stretches.tolist()):
        T_world_cam = supervision.T_world_cam[[i, i + 1]]
        stretches.append(_stretch(T_curr_prev, cov, first, end, T_world_cam=T_world_cam))

    # The covariance P of the truth.
    is_estimated = truth_sigma is None and not supervision.is_assumed
    if is_estimated:
        # A step without a solve has a made-up covariance, which says nothing about the truth.
        if is_solved is None:
            is_solved = np.ones(len(cov), np.bool_)
        solved = [each for each in stretches if is_solved[each.first : each.end].all()]
        if not solved:
            return motions, posterior
        truth_sigma = _estimated_truth_sigma(solved)
    elif truth_sigma is None:
        truth_sigma = LOOP_SIGMA
    P = np.diag(np.maximum(truth_sigma, LEAST_TRUTH_SIGMA) ** 2)

    for stretch in stretches:
        # Gate the truth.
        information = np.linalg.inv(stretch.cov + P)
        distance = stretch.distance
        if is_estimated and distance @ information @ distance > MOTIONS_DIFFER_FROM:
            continue
        # Kalman update of all steps of the stretch: the truth measures Σ Ad_k ξ_k, with the noise
        # P.
        steps = slice(stretch.first, stretch.end)
        # The gain is C_k Ad_kᵀ (M + P)⁻¹, [m, 6, 6]. Correlations that the truth makes between
        # steps are not kept: each step is used by itself.
        gain = cov[steps] @ np.swapaxes(stretch.to_end, 1, 2) @ information
        motions[steps] = se3.exp(gain @ distance) @ T_curr_prev[steps]
        posterior[steps] -= gain @ stretch.to_end @ cov[steps]
    return motions, posterior


def _stretch(
    T_curr_prev: FloatArray, cov: FloatArray, first: int, end: int, *, T_world_cam: FloatArray
) -> _Stretch:
    """Compound the motions of a stretch and compare them with the truth.

    Args:
        T_curr_prev: motion of each step of the drive, [K − 1, 4, 4].
        cov: covariance of each, [K − 1, 6, 6].
        first: first step of the stretch.
        end: the step after the last one.
        T_world_cam: true poses at both ends of the stretch, [2, 4, 4].
    """
    # From the last step backwards, so that each adjoint is that of the steps after it.
    motions = T_curr_prev[first:end]
    T_last_k = np.eye(4)
    to_end = np.empty((len(motions), 6, 6))
    for k in range(len(motions) - 1, -1, -1):
        to_end[k] = se3.adjoint(T_last_k)
        T_last_k = T_last_k @ motions[k]
    # The motion of the whole stretch, its covariance M = Σ Ad_k C_k Ad_kᵀ, and the distance of the
    # true motion from it. T_true is T_world_last⁻¹ T_world_first.
    M: FloatArray = np.sum(to_end @ cov[first:end] @ np.swapaxes(to_end, 1, 2), axis=0)
    T_true = se3.inverse(T_world_cam[1]) @ T_world_cam[0]
    distance = se3.log(T_true @ se3.inverse(T_last_k))
    return _Stretch(first=first, end=end, to_end=to_end, cov=M, distance=distance)


def _estimated_truth_sigma(stretches: Sequence[_Stretch]) -> FloatArray:
    """Estimate the standard deviation of the truth, m and rad, [6].

    It is the scatter of the truth around the features' motions beyond their own uncertainty, by
    medians. Few stretches may scatter little by chance: then the truth is taken to be no better
    than the features.

    Args:
        stretches: at least one stretch, of solved steps only.
    """
    # Translations and rotations apart, [U, 2, 3].
    distances = np.abs([stretch.distance for stretch in stretches]).reshape(-1, 2, 3)
    variances = np.reshape([np.diagonal(stretch.cov) for stretch in stretches], (-1, 2, 3))
    # 1.4826 times the median of absolute values is the σ of a Gaussian. The median is over
    # stretches and axes: one number for translations and one for rotations, [2].
    scatter = (1.4826 * np.median(distances, axis=(0, 2))) ** 2
    own = np.median(variances, axis=(0, 2))
    least = own if len(stretches) < FEW_STRETCHES else np.zeros(2)
    # Variances of truth and features add up in the scatter of their difference.
    sigma: FloatArray = np.repeat(np.sqrt(np.maximum(scatter - own, least)), 3)
    return sigma
