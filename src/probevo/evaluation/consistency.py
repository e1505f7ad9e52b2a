"""Consistency of covariances: the NEES of relative poses, its average, and the coverage.

An estimate is consistent if its covariance Σ describes its error ξ. The normalised estimation error
squared, NEES = ξᵀ Σ⁻¹ ξ, is then χ²-distributed with 6 degrees of freedom (Bar-Shalom, Li,
Kirubarajan 2001, sec. 5.4): its average is 6, and the share of errors inside an ellipsoid of
probability p is p. A larger NEES means that the covariance is overconfident, a smaller one that it
is conservative.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import bdtr, bdtrik, chdtr, chdtri, fdtr

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.geometry.uncertainty import (
    advance_cov,
    normalized_error_squared,
    squared_mahalanobis,
)

if TYPE_CHECKING:
    from probevo.noise import StereoNoise

COVERAGE_PERCENT = (50, 90, 95, 99)
"""Probabilities of the ellipsoids whose coverage is reported."""


@dataclass(frozen=True)
class Consistency:
    """How well the covariances of K relative poses describe their errors."""

    nees: FloatArray
    """ξᵀ Σ⁻¹ ξ of each relative pose, [K]; χ²(6) if the covariance is consistent and the errors
    are Gaussian."""

    @property
    def anees(self) -> float:
        """Average NEES: 6 is consistent, more is overconfident, less is conservative."""
        return float(self.nees.mean())

    @property
    def coverage(self) -> dict[str, float]:
        """Share of the errors, 0 … 1, inside the 50, 90, 95, 99 % ellipsoids, by percentage."""
        shares = self.share_inside(np.array(COVERAGE_PERCENT) / 100.0)
        return {str(p): float(share) for p, share in zip(COVERAGE_PERCENT, shares, strict=True)}

    def share_inside(self, probability: FloatArray) -> FloatArray:
        """Compute the share of errors inside the ellipsoids of P probabilities, 0 … 1, [P].

        The ellipsoid of probability p holds the errors whose NEES is at most the p-quantile of
        χ²(6).
        """
        radius_squared = chdtri(6, 1.0 - probability)
        return np.asarray(np.mean(self.nees[:, None] <= radius_squared, axis=0))

    def share_interval(
        self, probability: FloatArray, confidence: float = 0.95
    ) -> tuple[FloatArray, FloatArray]:
        """Compute the interval of that share for consistent covariances, [P] each.

        For independent errors, K times the share is binomial, Bin(K, p). Both ends are quantiles
        of it; each tail holds at most half of 1 − ``confidence``.
        """
        tail = 0.5 * (1.0 - confidence)
        count = len(self.nees)
        low = _binomial_quantile(tail, count, probability) / count
        high = _binomial_quantile(1.0 - tail, count, probability) / count
        return low, high


def feature_coverage(noise: StereoNoise, residuals: FloatArray) -> dict[str, float]:
    """Compute the share of N features inside their 50, 90, 95, 99 % ellipsoids, by percentage.

    The squared Mahalanobis distance s = (e − b)ᵀ R⁻¹ (e − b) of a Student-t residual has
    s/4 ~ F(4, ν); a Gaussian residual has s ~ χ²(4). Each feature is compared with the distribution
    of its own ν: consistent noise has nominal coverage, less is overconfident, more conservative.

    Args:
        noise: noise of the residuals of N ≥ 1 features.
        residuals: e, [N, 4], px.
    """
    # Squared Mahalanobis distance of each feature, [N].
    squared = squared_mahalanobis(residuals - noise.bias, noise.scale)
    # Probability of an ellipsoid that ends at the error of each feature, [N].
    is_gaussian = np.isinf(noise.dof)
    finite_dof = np.where(is_gaussian, 1.0, noise.dof)
    level = np.where(is_gaussian, chdtr(4, squared), fdtr(4, finite_dof, squared / 4.0))
    return {str(p): float(np.mean(level <= p / 100.0)) for p in COVERAGE_PERCENT}


def motion_consistency(
    T_curr_prev_est: FloatArray, cov: FloatArray, T_curr_prev_true: FloatArray
) -> Consistency | None:
    """Compute the consistency of relative motions; None if the truth of none is known.

    The error is ξ = Log(T_true T_est⁻¹), the left perturbation that the covariance describes.
    Where the truth is noisier from frame to frame than the estimate, as KITTI's is (GPS and
    INS: centimetres and 0.04° a frame), the NEES measures the noise of the truth, and is far above
    6 for a consistent covariance.

    Args:
        T_curr_prev_est: estimates, [K, 4, 4], m.
        cov: covariance of the left perturbation [ρ; φ], [K, 6, 6], m and rad, positive definite.
        T_curr_prev_true: truth, [K, 4, 4], m; NaN where unknown.
    """
    known = np.isfinite(T_curr_prev_true).all(axis=(1, 2))
    if not known.any():
        return None
    return Consistency(
        normalized_error_squared(T_curr_prev_true[known], T_curr_prev_est[known], cov[known])
    )


def drift_errors(T_world_cam_est: FloatArray, T_world_cam_true: FloatArray) -> FloatArray:
    """Compute the error ξ = [ρ; φ] of each pose in its own camera frame, [N, 6], m and rad.

    ξ = Log(T_world_cam_true⁻¹ T_world_cam_est) is the left perturbation of T_cam_world, whose
    covariance ``drift_covariances`` gives.

    Args:
        T_world_cam_est: estimates, [N, 4, 4], m.
        T_world_cam_true: truth in the same world frame, [N, 4, 4], m; NaN where unknown.
    """
    return se3.log(se3.inverse(T_world_cam_true) @ T_world_cam_est)


def drift_covariances(
    T_curr_prev: FloatArray, cov: FloatArray, common_mode: FloatArray, path_cross_cov: FloatArray
) -> FloatArray:
    """Compound the covariances of N − 1 motions to covariances of the N poses along their path.

    To first order the error of pose k is ξ_k = Ad_k ξ_{k−1} + ε_k, with Ad_k the adjoint of motion
    k and ε_k its error. That error has three parts. A common-mode part A_k c, with c ~ N(0, I) the
    same in all motions, adds up coherently: its σ grows with the length of the path. The rest has
    the covariance Σ_k − A_k A_kᵀ, and its cross-covariance with the error of the pose before it is
    X_k. With B_k the common-mode columns, and P_k the covariance of the rest, of pose k:

        B_k = Ad_k B_{k−1} + A_k
        P_k = Ad_k P_{k−1} Ad_kᵀ + Σ_k − A_k A_kᵀ + X_k + X_kᵀ
        cov(ξ_k) = P_k + B_k B_kᵀ

    Args:
        T_curr_prev: the motions, [N-1, 4, 4], m.
        cov: their covariances Σ_k, [N-1, 6, 6], m and rad.
        common_mode: the columns A_k, [N-1, 6, C].
        path_cross_cov: the cross-covariances X_k, [N-1, 6, 6] (``MotionEstimate.path_cross_cov``).
            Where the first of these motions is not the first of the run, they also contain a little
            of the errors before it.

    Returns:
        Covariance of the left perturbation of T_cam_world, in the frame of each camera, [N, 6, 6];
        0 at the first.
    """
    # B and P of the first pose are 0: it defines the world frame.
    common = np.zeros(common_mode.shape[1:])
    rest = np.zeros((6, 6))
    drift = np.zeros((len(cov) + 1, 6, 6))
    # The recursion of the docstring; drift[k + 1] is the covariance of the pose after motion k.
    for k, (T_k, cov_k, common_k) in enumerate(zip(T_curr_prev, cov, common_mode, strict=True)):
        common = common_k + se3.adjoint(T_k) @ common
        rest = advance_cov(rest, T_k, cov_k - common_k @ common_k.T, path_cross_cov[k])
        drift[k + 1] = rest + common @ common.T
    return drift


def _binomial_quantile(q: float, count: int, probability: FloatArray) -> FloatArray:
    """Compute the least k with P(successes ≤ k) ≥ q, [P].

    ``scipy.stats.binom.ppf`` does the same, but takes ten times as long to import.
    """
    # bdtrik is the root of the distribution function, continued to real k; NaN without any success.
    k = np.where(probability > 0.0, np.ceil(bdtrik(q, count, probability)), 0.0)
    # The root above may be rounded up by one too many.
    k_below = np.maximum(k - 1.0, 0.0)
    return np.asarray(np.where(bdtr(k_below, count, probability) >= q, k_below, k))
