"""Is the covariance honest? Normalised error squared of relative poses, its average, and coverage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import bdtr, bdtrik, chdtr, chdtri, fdtr

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.geometry.uncertainty import normalized_error_squared

if TYPE_CHECKING:
    from probevo.noise import StereoNoise

COVERAGE_PERCENT = (50, 90, 95, 99)


@dataclass(frozen=True)
class Consistency:
    """How well the claimed covariance of K relative poses describes their errors."""

    nees: FloatArray
    """ξᵀ Σ⁻¹ ξ of each relative pose, [K]; χ²(6) if the covariance is honest and the errors
    Gaussian."""

    @property
    def anees(self) -> float:
        """Average NEES: 6 is honest, more is overconfident, less is conservative."""
        return float(self.nees.mean())

    @property
    def coverage(self) -> dict[str, float]:
        """Share of the errors, 0 … 1, inside the ellipsoids that should hold 50, 90, 95, 99 % of
        them, by percent."""
        shares = self.share_inside(np.array(COVERAGE_PERCENT) / 100.0)
        return {str(p): float(share) for p, share in zip(COVERAGE_PERCENT, shares, strict=True)}

    def share_inside(self, probability: FloatArray) -> FloatArray:
        """Share of the errors, 0 … 1, inside the ellipsoids that should hold each of P
        probabilities of them, [P]."""
        return np.asarray(np.mean(self.nees[:, None] <= chdtri(6, 1.0 - probability), axis=0))

    def share_interval(
        self, probability: FloatArray, confidence: float = 0.95
    ) -> tuple[FloatArray, FloatArray]:
        """Where that share falls with this confidence if the covariance is honest and the errors
        are independent, [P].

        Both ends are quantiles of the binomial distribution, so that each tail holds at most half
        of the rest.
        """
        tail = 0.5 * (1.0 - confidence)
        count = len(self.nees)
        low, high = (_binomial_quantile(q, count, probability) / count for q in (tail, 1.0 - tail))
        return low, high


def feature_coverage(noise: StereoNoise, residuals: FloatArray) -> dict[str, float]:
    """Share of N features inside the ellipsoids that should hold 50, 90, 95, 99 % of them, 0 … 1,
    by percent.

    The squared Mahalanobis length s of a Student-t residual has s/4 ~ F(4, ν), of a Gaussian one s
    ~ χ²(4). It is held against the distribution of its own feature, whatever its ν: honest noise
    has nominal coverage, less is overconfident, more is conservative.

    Args:
        noise: noise of the residuals, of N features, at least one.
        residuals: [N, 4], px.
    """
    error = (residuals - noise.bias)[..., None]
    squared = (error.mT @ np.linalg.solve(noise.scale, error))[:, 0, 0]
    gaussian = np.isinf(noise.dof)
    level = np.where(
        gaussian, chdtr(4, squared), fdtr(4, np.where(gaussian, 1.0, noise.dof), squared / 4.0)
    )
    return {str(p): float(np.mean(level <= p / 100.0)) for p in COVERAGE_PERCENT}


def motion_consistency(
    T_curr_prev_est: FloatArray, cov: FloatArray, T_curr_prev_true: FloatArray
) -> Consistency | None:
    """Consistency of relative motions; None if the truth of none is known.

    The error is ξ = Log(T_true T_est⁻¹), the left perturbation that the covariance speaks of.
    Where the truth is noisier from frame to frame than the estimate, as that of KITTI is (GPS and
    INS: centimetres and 0.04° a frame), the NEES measures the noise of the truth and comes out far
    above 6 for an honest covariance.

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
    """Error ξ = [ρ; φ] of each pose along its own camera's axes, estimated minus true, [N, 6], m
    and rad.

    It is the left perturbation of T_cam_world, whose covariance ``drift_covariances`` gives. Both
    trajectories, [N, 4, 4], must share their world frame; NaN where the truth is unknown.
    """
    return se3.log(se3.inverse(T_world_cam_true) @ T_world_cam_est)


def drift_covariances(
    T_curr_prev: FloatArray, cov: FloatArray, common_mode: FloatArray, path_cross_cov: FloatArray
) -> FloatArray:
    """Covariance that N-1 motions, [N-1, 4, 4] with [N-1, 6, 6], add up to.

    Args:
        T_curr_prev, cov: the motions and their covariances.
        common_mode: columns along which errors that all steps have in common move each motion, [N-1, 6,
            K]; cov contains common_mode sharedᵀ. They grow with the length itself, the rest with its
            root.
        path_cross_cov: covariance of each motion's error with that of all before it, [N-1, 6, 6]
            (``MotionEstimate.path_cross_cov``). Where the first of these motions is not the first of the run,
            it tells a little of what was before, too.

    Returns:
        Covariance of the left perturbation of T_cam_world, along the axes of each camera, [N, 6,
        6]; 0 at the first.
    """
    adjoints = se3.adjoint(T_curr_prev)
    column = np.zeros(common_mode.shape[1:])
    path = np.zeros((6, 6))
    drift = np.zeros((len(cov) + 1, 6, 6))
    for k, (step, moved) in enumerate(zip(cov, common_mode, strict=True)):
        column = moved + adjoints[k] @ column
        path = (
            adjoints[k] @ path @ adjoints[k].T
            + step
            - moved @ moved.T
            + path_cross_cov[k]
            + path_cross_cov[k].T
        )
        drift[k + 1] = path + column @ column.T
    return drift


def _binomial_quantile(q: float, count: int, probability: FloatArray) -> FloatArray:
    """Least k with P(successes ≤ k) ≥ q, [P]; scipy.stats has it too, but loads ten times slower."""
    k = np.ceil(bdtrik(q, count, probability))
    before = np.maximum(k - 1.0, 0.0)
    return np.asarray(np.where(bdtr(before, count, probability) >= q, before, k))
