"""A Gaussian prior on a pose, from an earlier estimate or another sensor."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.measurements.base import Values, Variable, VectorMeasurement

SERIES_BELOW = 0.05
"""Length of ξ up to which the next term of the series, a⁴/720, is below 1e-8."""


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

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return −J(x)⁻¹, [6, 6], of x = Log(T T_prior⁻¹).

        Near the prior it is the series 1 − a/2 + a²/12, a = ad(x), which is ten times as fast.
        """
        x = -self.residual(values)
        if x @ x > SERIES_BELOW**2:
            return (-np.asarray(np.linalg.inv(se3.left_jacobian(x))),)
        adjoint = np.zeros((6, 6))
        adjoint[:3, :3] = so3.wedge(x[3:])
        adjoint[3:, 3:] = adjoint[:3, :3]
        adjoint[:3, 3:] = so3.wedge(x[:3])
        return (0.5 * adjoint - adjoint @ adjoint / 12.0 - np.eye(6),)
