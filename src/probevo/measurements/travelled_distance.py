"""The distance since the previous frame along an axis of the camera, as from wheel odometry."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import so3
from probevo.measurements.arguments import as_array, as_number, as_sigma
from probevo.measurements.relative import RelativeMeasurement
from probevo.measurements.variables import Values, Variable

AHEAD = np.array([0.0, 0.0, 1.0])
"""The camera's optical axis."""


class TravelledDistance(RelativeMeasurement):
    """A measured distance of the current camera from the previous one, along an axis.

    Wheel odometry measures it if the axis is the driving direction. Between two frames, arc and
    chord are practically equal.

    Args:
        distance_m: what was measured; negative backwards.
        sigma_m: its standard deviation.
        curr: pose of the current frame.
        prev: pose of the previous frame; None if the world of the poses is the previous camera.
        axis: unit vector in the previous camera's frame, [3].

    Raises:
        InputError: the distance is no number, the standard deviation not positive, or the axis no
            unit vector.
    """

    def __init__(
        self,
        distance_m: float,
        sigma_m: float,
        curr: Variable,
        prev: Variable | None = None,
        *,
        axis: FloatArray = AHEAD,
    ) -> None:
        sigma_m = as_sigma(sigma_m, "TravelledDistance: sigma_m")
        super().__init__(np.array([[sigma_m**2]]), curr, prev)
        self.distance_m = as_number(distance_m, "TravelledDistance: distance_m")
        self.axis = as_array(axis, (3,), "TravelledDistance: axis")
        if not abs(float(np.linalg.norm(self.axis)) - 1.0) < 1e-6:
            raise InputError("TravelledDistance: axis", "it is not a unit vector [3].")

    def residual(self, values: Values) -> FloatArray:
        """Return the measured distance minus the predicted one, [1], m."""
        return np.array([self.distance_m - self.axis @ self._position(values)])

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return ∂e/∂ξ of each pose, [1, 6].

        The position p moves by ρ + φ × p with ξ_prev, and by −C_prev_curr ρ with ξ_curr.
        """
        # Position −Cᵀ t in the previous frame, with T_curr_prev = (C, t). ξ_curr: t moves by ρ +
        # φ × t and C by φ^ C, so that −Cᵀ t moves by −Cᵀ ρ. ξ_prev: it moves by ρ + φ × itself.
        C_prev_curr = self.motion(values)[:3, :3].T
        curr_jacobian = np.zeros((1, 6))
        curr_jacobian[0, :3] = self.axis @ C_prev_curr
        if self.prev is None:
            return (curr_jacobian,)
        prev_jacobian = np.zeros((1, 6))
        prev_jacobian[0, :3] = -self.axis
        prev_jacobian[0, 3:] = self.axis @ so3.wedge(self._position(values))
        return prev_jacobian, curr_jacobian

    def _position(self, values: Values) -> FloatArray:
        """Return the position of the current camera in the frame of the previous one, [3], m."""
        T_curr_prev = self.motion(values)
        position: FloatArray = -T_curr_prev[:3, :3].T @ T_curr_prev[:3, 3]
        return position
