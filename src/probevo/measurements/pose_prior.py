"""A Gaussian prior on a pose, as an earlier estimate or another sensor gives it."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.base import Values, Variable, VectorMeasurement


class PosePrior(VectorMeasurement):
    """A prior on a pose: ξ = Log(T_cam_world T_prior⁻¹) ~ N(0, covariance), ξ = [ρ; φ].

    Args:
        pose: the variable.
        T_cam_world: its mean, [4, 4].
        covariance: of the left perturbation ξ, [6, 6], m and rad.
    """

    def __init__(self, pose: Variable, T_cam_world: FloatArray, covariance: FloatArray) -> None:
        super().__init__(covariance)
        self.pose = pose
        self.T_cam_world = T_cam_world

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The pose."""
        return (self.pose,)

    def residual(self, values: Values) -> FloatArray:
        """Return −Log(T T_prior⁻¹), [6]."""
        return -se3.log(values[self.pose] @ se3.inverse(self.T_cam_world))
