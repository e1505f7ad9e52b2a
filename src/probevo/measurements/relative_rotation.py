"""The rotation between two frames with its covariance, as a gyro gives it (PROBE eqs. 3–4)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.measurements.base import Values, Variable, VectorMeasurement

LEAST_SIGMA_RAD = 1e-6
"""No rotation is known better, even from a gyro said to be without noise."""


class RelativeRotation(VectorMeasurement):
    """A measured C_curr_prev: φ = Log(C_curr_prev C_measuredᵀ) ~ N(0, cov).

    Args:
        C_curr_prev: p_curr = C_curr_prev p_prev, [3, 3].
        cov: covariance of its left perturbation φ, [3, 3], rad².
        curr: pose of the current frame.
        prev: pose of the previous frame; None if the world of the poses is the previous camera.
    """

    def __init__(
        self,
        C_curr_prev: FloatArray,
        cov: FloatArray,
        curr: Variable,
        prev: Variable | None = None,
    ) -> None:
        super().__init__(cov + LEAST_SIGMA_RAD**2 * np.eye(3))
        self.C_curr_prev = C_curr_prev
        self.cov = cov
        self.curr = curr
        self.prev = prev

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The poses of both frames, or only the current one."""
        return (self.curr,) if self.prev is None else (self.prev, self.curr)

    def residual(self, values: Values) -> FloatArray:
        """Return −φ, [3], rad."""
        T_curr_prev = relative_motion(values, self.curr, self.prev)
        return -so3.log(T_curr_prev[:3, :3] @ self.C_curr_prev.T)

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return ∂(−φ)/∂ξ of each pose; the Jacobian of Log is taken as 1, since φ is small."""
        of_curr = np.hstack([np.zeros((3, 3)), -np.eye(3)])
        if self.prev is None:
            return (of_curr,)
        T_curr_prev = relative_motion(values, self.curr, self.prev)
        return (np.hstack([np.zeros((3, 3)), T_curr_prev[:3, :3]]), of_curr)


def relative_motion(values: Values, curr: Variable, prev: Variable | None) -> FloatArray:
    """Return T_curr_prev, [4, 4]; without ``prev``, the world is the previous camera."""
    if prev is None:
        return values[curr]
    motion: FloatArray = values[curr] @ se3.inverse(values[prev])
    return motion
