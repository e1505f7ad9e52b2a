"""The pose in the world with its covariance: motions compounded, and measurements of the pose."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation import gauss_newton
from probevo.estimation.motion_estimate import MotionEstimate
from probevo.geometry import se3
from probevo.measurements.base import Measurement, Variable
from probevo.measurements.pose_prior import PosePrior

LEAST_SIGMA = np.array([1e-6, 1e-6, 1e-6, 1e-8, 1e-8, 1e-8])
"""Standard deviation to which the first pose is known, m and rad: it is the world's origin by
definition, but a prior needs a covariance that can be inverted."""


@dataclass(frozen=True)
class PoseFilter:
    """A Gaussian estimate of the pose of the current camera; the world is the first camera."""

    T_world_cam: FloatArray
    """[4, 4], m."""
    own_cov: FloatArray
    """Covariance of the left perturbation ξ = [ρ; φ] of T_cam_world without the common-mode part,
    [6, 6], m and rad."""
    common_mode: FloatArray
    """How the common-mode errors of all steps so far move it, [6, 3]: they add up along the
    path."""
    is_corrected: bool = False
    """Whether a measurement of the pose has corrected it. From then on the cross-covariances of
    steps with the path before them are neglected: they refer to the path as it was."""

    @staticmethod
    def at_origin() -> PoseFilter:
        """Return the pose of the first camera."""
        return PoseFilter(
            T_world_cam=np.eye(4), own_cov=np.zeros((6, 6)), common_mode=np.zeros((6, 3))
        )

    @property
    def cov(self) -> FloatArray:
        """Covariance of the left perturbation ξ of T_cam_world, [6, 6], m and rad."""
        return self.own_cov + self.common_mode @ self.common_mode.T

    def advanced(self, motion: MotionEstimate) -> PoseFilter:
        """Return the pose after a step: P = Ad P Adᵀ + cov + X + Xᵀ, X the cross-covariance."""
        adjoint = se3.adjoint(motion.T_curr_prev)
        # Common-mode errors are the same in all steps: their roots add up, not their covariances.
        step_cov = motion.cov - motion.common_mode @ motion.common_mode.T
        own_cov = adjoint @ self.own_cov @ adjoint.T + step_cov
        if not self.is_corrected:
            own_cov = own_cov + motion.path_cross_cov + motion.path_cross_cov.T
        return PoseFilter(
            T_world_cam=self.T_world_cam @ se3.inverse(motion.T_curr_prev),
            own_cov=own_cov,
            common_mode=adjoint @ self.common_mode + motion.common_mode,
            is_corrected=self.is_corrected,
        )

    def updated(self, measurements: Sequence[Measurement], pose: Variable) -> PoseFilter:
        """Return the pose given measurements of it: one Gauss–Newton solve with this as prior.

        With Λ the measurements' information, P⁺ = (P⁻¹ + Λ)⁻¹, and an error ξ before is A ξ after,
        A = P⁺ P⁻¹. So the common-mode part shrinks by A, and the rest of P⁺ is the pose's own.
        """
        if not measurements:
            return self
        prior_cov = self.cov + np.diag(LEAST_SIGMA**2)
        T_cam_world = se3.inverse(self.T_world_cam)
        prior = PosePrior(pose, T_cam_world, prior_cov)
        optimum = gauss_newton.minimize([prior, *measurements], {pose: T_cam_world}, [pose])
        information = gauss_newton.information(optimum.measurements, optimum.values, [pose])
        cov = np.linalg.inv(information)
        common_mode = cov @ np.linalg.solve(prior_cov, self.common_mode)
        return PoseFilter(
            T_world_cam=se3.inverse(optimum.values[pose]),
            own_cov=cov - common_mode @ common_mode.T,
            common_mode=common_mode,
            is_corrected=True,
        )
