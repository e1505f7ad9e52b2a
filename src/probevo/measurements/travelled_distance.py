"""The way since the previous frame along an axis of the camera, as the wheels give it."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import so3
from probevo.measurements.base import Values, Variable, VectorMeasurement
from probevo.measurements.relative_rotation import relative_motion

AHEAD = np.array([0.0, 0.0, 1.0])
"""The camera's optical axis."""


class TravelledDistance(VectorMeasurement):
    """A measured distance: that of the current camera from the previous one, along an axis.

    Wheels measure it where the axis is the direction in which the vehicle drives. Between two
    frames the arc and its chord are the same.

    Args:
        distance_m: what was measured; negative backwards.
        sigma_m: its standard deviation.
        curr: pose of the current frame.
        prev: pose of the previous frame; None if the world of the poses is the previous camera.
        axis: unit vector in the previous camera's frame, [3].

    Raises:
        InputError: the standard deviation is not positive, or the axis no unit vector.
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
        super().__init__(np.array([[sigma_m**2]]))
        self.distance_m = distance_m
        self.curr = curr
        self.prev = prev
        self.axis = np.asarray(axis, np.float64)
        if self.axis.shape != (3,) or not abs(float(np.linalg.norm(self.axis)) - 1.0) < 1e-6:
            raise InputError("TravelledDistance: axis", "it is not a unit vector [3].")

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The poses of both frames, or only the current one."""
        return (self.curr,) if self.prev is None else (self.prev, self.curr)

    def residual(self, values: Values) -> FloatArray:
        """Return the measured distance minus the predicted one, [1], m."""
        return np.array([self.distance_m - self.axis @ self._way(values)])

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return ∂e/∂ξ of each pose, [1, 6]: the way t is moved by ρ + φ × t, or by −C ρ."""
        C_prev_curr = relative_motion(values, self.curr, self.prev)[:3, :3].T
        of_curr = np.zeros((1, 6))
        of_curr[0, :3] = self.axis @ C_prev_curr
        if self.prev is None:
            return (of_curr,)
        of_prev = np.zeros((1, 6))
        of_prev[0, :3] = -self.axis
        of_prev[0, 3:] = self.axis @ so3.wedge(self._way(values))
        return of_prev, of_curr

    def _way(self, values: Values) -> FloatArray:
        """Return where the current camera is in the previous one's frame, [3], m."""
        T_curr_prev = relative_motion(values, self.curr, self.prev)
        way: FloatArray = -T_curr_prev[:3, :3].T @ T_curr_prev[:3, 3]
        return way
