"""A motion between two frames with its covariance, as from dead reckoning or a network."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.arguments import as_transform
from probevo.measurements.relative import RelativeMeasurement
from probevo.measurements.variables import Values, Variable


class RelativePose(RelativeMeasurement):
    """A measured motion: ξ = Log(T_curr_prev T_measured⁻¹) ~ N(0, covariance), ξ = [ρ; φ].

    Args:
        T_curr_prev: the motion, [4, 4], m.
        covariance: of its left perturbation ξ, [6, 6], m and rad.
        curr: pose of the current frame.
        prev: pose of the previous frame; None if the world of the poses is the previous camera.

    Raises:
        InputError: the covariance is not [6, 6] and positive definite, or the motion no rigid
            transform.
    """

    def __init__(
        self,
        T_curr_prev: FloatArray,
        covariance: FloatArray,
        curr: Variable,
        prev: Variable | None = None,
    ) -> None:
        super().__init__(covariance, curr, prev, dim=6)
        self.T_curr_prev = as_transform(T_curr_prev, "RelativePose: T_curr_prev")

    def expected(self, values: Values) -> FloatArray:
        """Return the measured motion, [4, 4]."""
        return self.T_curr_prev

    def residual(self, values: Values) -> FloatArray:
        """Return −Log(T_curr_prev T_measured⁻¹), [6]."""
        return -se3.log(self.motion(values) @ se3.inverse(self.T_curr_prev))

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return ∂e/∂ξ of each pose, [6, 6]: −J(x)⁻¹ of the current one, x = −e."""
        curr_jacobian = -se3.inverse_left_jacobian(-self.residual(values))
        if self.prev is None:
            return (curr_jacobian,)
        # ξ_prev acts on the motion as −Ad(T_curr_prev) ξ_prev.
        return (-curr_jacobian @ se3.adjoint(self.motion(values)), curr_jacobian)
