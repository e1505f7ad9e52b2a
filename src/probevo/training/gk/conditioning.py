"""Fusion of the motions of a drive with its truth: both are Gaussian."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from probevo.arrays import BoolArray, FloatArray
from probevo.estimation.disparity_filter import StepCorrelation
from probevo.estimation.disparity_filter_numba import NUM_LATENT
from probevo.geometry import se3
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM
from probevo.measurements.jitter_numba import JITTER_DIM
from probevo.training.supervision import LOOP_SIGMA, Supervision

MIN_TRUTH_SIGMA = np.array([1e-4, 1e-4, 1e-4, 1e-5, 1e-5, 1e-5])
"""Smallest standard deviation of the truth, m and rad: no truth is more accurate."""
FEW_STRETCHES = 20
"""With fewer stretches, the accuracy of the truth cannot be estimated reliably."""
MEDIAN_CHI2 = 0.4549
"""Median of χ² with one degree of freedom: of the square of a standard normal variable."""
SIGMA_ACCURACY = 1e-4
"""Relative accuracy of the estimated σ of the truth, whose own scatter is half a percent with ten
thousand stretches."""
MAX_COMMON = NUM_LATENT + JITTER_DIM
"""Largest number K of latent errors: of the disparities, and of the rig's jitter."""


class StepCorrelations(NamedTuple):
    """The ``StepCorrelation`` of each of K − 1 steps, filled up with zeros."""

    with_before: FloatArray
    """Cross-covariance B of each step with the common errors before it, [K − 1, 6, MAX_COMMON]."""
    with_after: FloatArray
    """Cross-covariance A of each step with the common errors after it, [K − 1, 6, MAX_COMMON]."""
    transition: FloatArray
    """Cross-covariance Φ of the common errors before and after each step, [K − 1, MAX_COMMON,
    MAX_COMMON]."""

    @staticmethod
    def none(num_steps: int) -> StepCorrelations:
        """Return the correlations of steps whose errors are independent: zeros."""
        return StepCorrelations(
            with_before=np.zeros((num_steps, 6, MAX_COMMON)),
            with_after=np.zeros((num_steps, 6, MAX_COMMON)),
            transition=np.zeros((num_steps, MAX_COMMON, MAX_COMMON)),
        )

    @staticmethod
    def of(steps: Sequence[StepCorrelation]) -> StepCorrelations:
        """Gather the correlations of single steps."""
        gathered = StepCorrelations.none(len(steps))
        for k, step in enumerate(steps):
            before, after = step.transition.shape
            gathered.with_before[k, :, :before] = step.with_before
            gathered.with_after[k, :, :after] = step.with_after
            gathered.transition[k, :before, :after] = step.transition
        return gathered

    def between(self, first: int, end: int) -> StepCorrelations:
        """Return the correlations of the steps from ``first`` to before ``end``."""
        return StepCorrelations(
            with_before=self.with_before[first:end],
            with_after=self.with_after[first:end],
            transition=self.transition[first:end],
        )


@dataclass(frozen=True)
class Stretch:
    """The m steps of a stretch, and the distance of its motion from the truth."""

    first: int
    """First step."""
    end: int
    """The step after the last one."""
    cross_cov: FloatArray
    """Cross-covariance of each step with the whole motion, [m, 6, 6]."""
    cov: FloatArray
    """Covariance M of the whole motion, [6, 6]."""
    distance: FloatArray
    """ξ = Log(T_true T⁻¹), [6], m and rad."""

    @staticmethod
    def of(
        T_curr_prev: FloatArray,
        cov: FloatArray,
        correlations: StepCorrelations,
        *,
        first: int,
        end: int,
        T_world_cam: FloatArray,
    ) -> Stretch:
        """Compound the motions of a stretch and compare them with the truth.

        Args:
            T_curr_prev: motion of each step of the drive, [K − 1, 4, 4].
            cov: covariance of each, [K − 1, 6, 6].
            correlations: what correlates their errors.
            first: first step of the stretch.
            end: the step after the last one.
            T_world_cam: true poses at both ends of the stretch, [2, 4, 4].
        """
        # From the last step backwards: each adjoint is the product over the steps after it.
        motions = T_curr_prev[first:end]
        T_last_k = np.eye(4)
        to_end = np.empty((len(motions), 6, 6))
        for k in range(len(motions) - 1, -1, -1):
            to_end[k] = se3.adjoint(T_last_k)
            T_last_k = T_last_k @ motions[k]
        # The covariance M = Σ Ad_k G_k of the motion of the whole stretch, and the distance of the
        # true motion from it. T_true is T_world_last⁻¹ T_world_first.
        cross_cov = _cross_covariances(cov[first:end], to_end, correlations.between(first, end))
        M: FloatArray = np.sum(to_end @ cross_cov, axis=0)
        T_true = se3.inverse(T_world_cam[1]) @ T_world_cam[0]
        distance = se3.log(T_true @ se3.inverse(T_last_k))
        return Stretch(
            first=first, end=end, cross_cov=cross_cov, cov=0.5 * (M + M.T), distance=distance
        )


def conditioned(
    T_curr_prev: FloatArray,
    cov: FloatArray,
    supervision: Supervision,
    *,
    truth_sigma: FloatArray | None,
    is_solved: BoolArray | None = None,
    correlations: StepCorrelations | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Condition the motions of K − 1 steps on the true motion over each stretch.

    The motion over a stretch is T = T_m … T_1, and perturbations ξ_k of its steps move it by
    Σ Ad_k ξ_k with Ad_k = Ad(T_m … T_{k+1}). With the covariances C_jk of steps j and k, the
    cross-covariance of a step with the whole motion is G_k = Σ_j C_kj Ad_jᵀ, and the covariance of
    the whole motion is M = Σ Ad_k G_k. With the covariance P of the truth and its distance
    ξ = Log(T_true T⁻¹), each step moves by G_k (M + P)⁻¹ ξ. For stretches of one step this is the
    fusion of two Gaussians.

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
        correlations: what correlates the errors of the K − 1 motions; by default nothing does.

    Returns:
        motions [K − 1, 4, 4] and covariances [K − 1, 6, 6] given the truth.
    """
    # The distance of each stretch from the truth.
    motions = T_curr_prev.copy()
    posterior = cov.copy()
    if correlations is None:
        correlations = StepCorrelations.none(len(cov))
    stretches = []
    for i, (first, end) in enumerate(supervision.stretches.tolist()):
        stretches.append(
            Stretch.of(
                T_curr_prev,
                cov,
                correlations,
                first=first,
                end=end,
                T_world_cam=supervision.T_world_cam[[i, i + 1]],
            )
        )

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
    P = np.diag(np.maximum(truth_sigma, MIN_TRUTH_SIGMA) ** 2)

    for stretch in stretches:
        # Gate the truth.
        information = np.linalg.inv(stretch.cov + P)
        distance = stretch.distance
        if is_estimated and distance @ information @ distance > MOTIONS_DIFFER_FROM:
            continue
        # Kalman update of all steps of the stretch: the truth measures Σ Ad_k ξ_k, with the noise
        # P.
        steps = slice(stretch.first, stretch.end)
        # The gain is G_k (M + P)⁻¹, [m, 6, 6]. The covariances between steps are not updated: each
        # step is used by itself.
        gain = stretch.cross_cov @ information
        motions[steps] = se3.exp(gain @ distance) @ T_curr_prev[steps]
        posterior[steps] -= gain @ np.swapaxes(stretch.cross_cov, 1, 2)
    return motions, posterior


def _cross_covariances(
    cov: FloatArray, to_end: FloatArray, correlations: StepCorrelations
) -> FloatArray:
    """Return the cross-covariance G_k of each step with the whole motion Σ Ad_j ξ_j, [m, 6, 6].

    B_k and A_k are the cross-covariances of step k with the common errors c before and after it,
    Φ_k the cross-covariance of c before with c after it. With c after step k, let S_k = cov(Σ_{j≤k}
    Ad_j ξ_j, c) and N_k = cov(c, Σ_{j>k} Ad_j ξ_j). One pass forwards and one backwards give

        S_k = S_{k−1} Φ_k + Ad_k A_k
        N_{k−1} = B_kᵀ Ad_kᵀ + Φ_k N_k
        G_k = C_k Ad_kᵀ + B_k S_{k−1}ᵀ + A_k N_k

    Args:
        cov: covariance C_k of each step, [m, 6, 6].
        to_end: adjoint Ad_k that maps a perturbation of each step to one of the whole motion,
            [m, 6, 6].
        correlations: of the m steps.
    """
    cross_cov: FloatArray = cov @ np.swapaxes(to_end, 1, 2)
    # The steps before each.
    before = np.zeros((6, MAX_COMMON))
    for k in range(len(cov)):
        cross_cov[k] += correlations.with_before[k] @ before.T
        before = before @ correlations.transition[k] + to_end[k] @ correlations.with_after[k]
    # The steps after each.
    after = np.zeros((MAX_COMMON, 6))
    for k in range(len(cov) - 1, -1, -1):
        cross_cov[k] += correlations.with_after[k] @ after
        after = (to_end[k] @ correlations.with_before[k]).T + correlations.transition[k] @ after
    return cross_cov


def _estimated_truth_sigma(stretches: Sequence[Stretch]) -> FloatArray:
    """Estimate the standard deviation of the truth, m and rad, [6].

    It is the scatter of the truth around the features' motions beyond their own uncertainty, by
    medians. Few stretches may scatter little by chance: then the truth is taken to be no better
    than the features.

    Args:
        stretches: at least one stretch, of solved steps only.
    """
    # Translations and rotations apart, [U, 2, 3]: one number for either, of stretches and axes.
    squared = np.square([stretch.distance for stretch in stretches]).reshape(-1, 2, 3)
    variances = np.reshape([np.diagonal(stretch.cov) for stretch in stretches], (-1, 2, 3))
    least = MIN_TRUTH_SIGMA.reshape(2, 3).max(axis=1)
    if len(stretches) < FEW_STRETCHES:
        least = np.maximum(least, np.sqrt(np.median(variances, axis=(0, 2))))
    sigma = [_sigma_beyond(variances[:, i], squared[:, i], float(least[i])) for i in range(2)]
    return np.repeat(sigma, 3)


def _sigma_beyond(variances: FloatArray, squared: FloatArray, least: float) -> float:
    """Estimate the σ of what deviations have in them beyond their own uncertainty, m or rad.

    Variances add up; hence d²/(V + σ²) has the median of χ²(1). Each deviation is compared with its
    own variance: a stereo camera's axes have different variances, and the median of a mixture is
    not the median for any of the variances in it.

    Args:
        variances: variance V of each deviation by itself, of any shape, m² or rad².
        squared: squared deviations d², of the same shape.
        least: the least σ.
    """

    def excess(log_sigma: float) -> float:
        """Return by how much the median exceeds the median of χ²(1), given ln σ; it falls with
        σ."""
        return float(np.median(squared / (variances + np.exp(2.0 * log_sigma)))) - MEDIAN_CHI2

    if excess(np.log(least)) <= 0.0:
        return least
    # With this σ, no deviation is beyond the median.
    most = np.sqrt(float(np.max(squared)) / MEDIAN_CHI2)
    return float(np.exp(brentq(excess, np.log(least), np.log(most), xtol=SIGMA_ACCURACY)))
