"""The motion between two frames with its covariance, as dead reckoning or a network gives it."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.base import Values, Variable, VectorMeasurement
from probevo.measurements.relative_rotation import relative_motion


class RelativePose(VectorMeasurement):
    """A measured motion: ξ = Log(T_curr_prev T_measured⁻¹) ~ N(0, covariance), ξ = [ρ; φ].

    Args:
        T_curr_prev: the motion, [4, 4], m.
        covariance: of its left perturbation ξ, [6, 6], m and rad.
        curr: pose of the current frame.
        prev: pose of the previous frame; None if the world of the poses is the previous camera.
    """

    def __init__(
        self,
        T_curr_prev: FloatArray,
        covariance: FloatArray,
        curr: Variable,
        prev: Variable | None = None,
    ) -> None:
        super().__init__(covariance)
        self.T_curr_prev = T_curr_prev
        self.curr = curr
        self.prev = prev

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The poses of both frames, or only the current one."""
        return (self.curr,) if self.prev is None else (self.prev, self.curr)

    def residual(self, values: Values) -> FloatArray:
        """Return −Log(T_curr_prev T_measured⁻¹), [6]."""
        T_curr_prev = relative_motion(values, self.curr, self.prev)
        return -se3.log(T_curr_prev @ se3.inverse(self.T_curr_prev))
