"""Is the covariance honest? Normalised error squared of relative poses, its average, and coverage."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.geometry.uncertainty import compound_chain, invert, normalized_error_squared

COVERAGE_PERCENT = (50, 90, 95, 99)


@dataclass(frozen=True)
class Consistency:
    """How well the claimed covariance of K relative poses describes their errors."""

    nees: FloatArray
    """ξᵀ Σ⁻¹ ξ of each relative pose, [K]; χ²(6) if the covariance is honest and the errors Gaussian."""

    @property
    def anees(self) -> float:
        """Average NEES: 6 is honest, more is overconfident, less is timid."""
        return float(self.nees.mean())

    @property
    def coverage(self) -> dict[str, float]:
        """Share of the errors, 0 … 1, inside the ellipsoids that should hold 50, 90, 95, 99 % of them, by percent."""
        return {str(p): float(np.mean(self.nees <= chdtri(6, 1.0 - p / 100.0))) for p in COVERAGE_PERCENT}

    def anees_interval(self, probability: float = 0.95) -> tuple[float, float]:
        """Where the ANEES of an honest covariance with independent Gaussian errors falls with this probability."""
        tail = 0.5 * (1.0 - probability)
        # chdtri takes the probability of the upper tail, and loads ten times faster than scipy.stats.
        low, high = chdtri(6 * len(self.nees), [1.0 - tail, tail]) / len(self.nees)
        return float(low), float(high)


def motion_consistency(
    T_curr_prev_est: FloatArray, cov: FloatArray, T_curr_prev_true: FloatArray
) -> Consistency | None:
    """Consistency of relative motions; None if the truth of none is known.

    The error is ξ = Log(T_true T_est⁻¹), the left perturbation that the covariance speaks of.
    Where the truth is noisier from frame to frame than the estimate, as that of KITTI is (GPS and INS: centimetres and
    0.04° a frame), the NEES measures the noise of the truth and comes out far above 6 for an honest covariance.

    Args:
        T_curr_prev_est: estimates, [K, 4, 4], m.
        cov: covariance of the left perturbation [ρ; φ], [K, 6, 6], m and rad, positive definite.
        T_curr_prev_true: truth, [K, 4, 4], m; NaN where unknown.
    """
    known = np.isfinite(T_curr_prev_true).all(axis=(1, 2))
    if not known.any():
        return None
    return Consistency(normalized_error_squared(T_curr_prev_true[known], T_curr_prev_est[known], cov[known]))


def drift_errors(T_world_cam_est: FloatArray, T_world_cam_true: FloatArray) -> FloatArray:
    """Error ξ = [ρ; φ] of each pose along its own camera's axes, estimated minus true, [N, 6], m and rad.

    It is the left perturbation of T_cam_world, whose covariance ``drift_covariances`` gives. Both trajectories,
    [N, 4, 4], must share their world frame; NaN where the truth is unknown.
    """
    return se3.log(se3.inverse(T_world_cam_true) @ T_world_cam_est)


def drift_covariances(T_curr_prev: FloatArray, cov: FloatArray, shared: FloatArray) -> FloatArray:
    """Covariance that N-1 motions, [N-1, 4, 4] with [N-1, 6, 6], add up to.

    Args:
        T_curr_prev, cov: the motions and their covariances.
        shared: columns along which errors that all steps have in common move each motion, [N-1, 6, K]; cov contains
            shared sharedᵀ. The rest is taken as independent from step to step: it grows with the root of the
            length, the shared part with the length itself.

    Returns:
        Covariance of the left perturbation of T_cam_world, along the axes of each camera, [N, 6, 6]; 0 at the first.
    """
    _, cov_cam = invert(*compound_chain(T_curr_prev, cov - shared @ shared.mT))
    adjoints, column = se3.adjoint(T_curr_prev), np.zeros(shared.shape[1:])
    for k, moved in enumerate(shared):
        column = moved + adjoints[k] @ column
        cov_cam[k] += column @ column.T
    return np.concatenate([np.zeros((1, 6, 6)), cov_cam])
