"""A motion between two frames with its covariance, as from dead reckoning or a network."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.base import Values, Variable
from probevo.measurements.relative import RelativeMeasurement


class RelativePose(RelativeMeasurement):
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
        super().__init__(covariance, curr, prev)
        self.T_curr_prev = T_curr_prev

    def residual(self, values: Values) -> FloatArray:
        """Return −Log(T_curr_prev T_measured⁻¹), [6]."""
        return -se3.log(self.motion(values) @ se3.inverse(self.T_curr_prev))
