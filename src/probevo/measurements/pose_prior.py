"""A Gaussian prior on a pose, from an earlier estimate or another sensor."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.arguments import as_transform
from probevo.measurements.variables import Values, Variable
from probevo.measurements.vector_measurement import VectorMeasurement


class PosePrior(VectorMeasurement):
    """A prior on a pose: ξ = Log(T_cam_world T_prior⁻¹) ~ N(0, covariance), ξ = [ρ; φ].

    Args:
        pose: the variable.
        T_cam_world: its mean, [4, 4].
        covariance: of the left perturbation ξ, [6, 6], m and rad.

    Raises:
        InputError: the covariance is not [6, 6] and positive definite, or the mean no rigid
            transform.
    """

    def __init__(self, pose: Variable, T_cam_world: FloatArray, covariance: FloatArray) -> None:
        super().__init__(covariance, dim=6)
        self.pose = pose
        self.T_cam_world = as_transform(T_cam_world, "PosePrior: T_cam_world")

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The pose."""
        return (self.pose,)

    def residual(self, values: Values) -> FloatArray:
        """Return −Log(T T_prior⁻¹), [6]."""
        return -se3.log(values[self.pose] @ se3.inverse(self.T_cam_world))

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return −J(x)⁻¹, [6, 6], of x = Log(T T_prior⁻¹)."""
        return (-se3.inverse_left_jacobian(-self.residual(values)),)
