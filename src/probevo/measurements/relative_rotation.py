"""The rotation between two frames with its covariance, as a gyro gives it (PROBE eqs. 3–4)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import so3
from probevo.measurements.arguments import as_array, as_rotation
from probevo.measurements.relative import RelativeMeasurement
from probevo.measurements.variables import Values, Variable

MIN_SIGMA_RAD = 1e-6
"""Its square is added to every variance, so that the covariance of a gyro without noise can be
inverted."""


class RelativeRotation(RelativeMeasurement):
    """A measured C_curr_prev: φ = Log(C_curr_prev C_measuredᵀ) ~ N(0, covariance).

    Args:
        C_curr_prev: p_curr = C_curr_prev p_prev, [3, 3].
        covariance: of its left perturbation φ, [3, 3], rad².
        curr: pose of the current frame.
        prev: pose of the previous frame; None if the world of the poses is the previous camera.

    Raises:
        InputError: the covariance is not [3, 3] and positive definite, or C_curr_prev no rotation.
    """

    def __init__(
        self,
        C_curr_prev: FloatArray,
        covariance: FloatArray,
        curr: Variable,
        prev: Variable | None = None,
    ) -> None:
        least = MIN_SIGMA_RAD**2 * np.eye(3)
        enlarged = as_array(covariance, (3, 3), "RelativeRotation: covariance") + least
        super().__init__(enlarged, curr, prev, dim=3)
        self.C_curr_prev = as_rotation(C_curr_prev, "RelativeRotation: C_curr_prev")

    def residual(self, values: Values) -> FloatArray:
        """Return −φ, [3], rad."""
        return -so3.log(self.motion(values)[:3, :3] @ self.C_curr_prev.T)

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return ∂(−φ)/∂ξ of each pose; the Jacobian of Log is taken as 1, since φ is small."""
        curr_jacobian = np.hstack([np.zeros((3, 3)), -np.eye(3)])
        if self.prev is None:
            return (curr_jacobian,)
        # ξ_prev acts on the motion as −Ad(T_curr_prev) ξ_prev, and on −φ with the opposite sign.
        C_curr_prev = self.motion(values)[:3, :3]
        return (np.hstack([np.zeros((3, 3)), C_curr_prev]), curr_jacobian)
