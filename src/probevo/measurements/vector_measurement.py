"""Measurements with a single residual, Student-t distributed or Gaussian: what most sensors are."""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from typing import Self

import numpy as np
from scipy.special import chdtri

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry.uncertainty import squared_mahalanobis
from probevo.measurements.arguments import as_array
from probevo.measurements.base import Linearization, Outcome
from probevo.measurements.variables import Values, Variable, dimension, retract

ASYMMETRY = 1e-8
"""Largest difference between a covariance and its transpose, relative to its largest entry, that is
taken as rounding."""

LARGE_TAIL_PROBABILITY = 0.05
"""Tail probability of a residual beyond which a bounded loss is no longer quadratic. It is the same
for all sensors, whatever the dimension of their residual."""


class VectorMeasurement(ABC):
    """A measurement with a single residual of d dimensions, Student-t distributed or Gaussian.

    A subclass defines its ``variables`` and how its ``residual`` depends on them. The Jacobians are
    central differences unless it overrides ``jacobians``.

    Args:
        covariance: of the residual, [d, d] (the scale matrix of a Student-t).
        dim: d, where a subclass knows it.
        dof: degrees of freedom ν of the Student-t; np.inf is Gaussian.
        gate: squared Mahalanobis distance beyond which it does not contribute; np.inf keeps all.

    Raises:
        InputError: the covariance is not symmetric positive definite, or not [d, d].
    """

    def __init__(
        self,
        covariance: FloatArray,
        *,
        dim: int | None = None,
        dof: float = np.inf,
        gate: float = np.inf,
    ) -> None:
        if dim is not None:
            covariance = as_array(covariance, (dim, dim), f"{type(self).__name__}: covariance")
        covariance = np.asarray(covariance, dtype=np.float64)
        square = covariance.ndim == 2 and covariance.shape[0] == covariance.shape[1]
        if not square or not np.isfinite(covariance).all():
            raise InputError(type(self).__name__, "its covariance is not symmetric and finite.")
        if np.abs(covariance - covariance.T).max() > ASYMMETRY * np.abs(covariance).max():
            raise InputError(type(self).__name__, "its covariance is not symmetric and finite.")
        # A covariance is positive definite if and only if it has a Cholesky factor.
        try:
            root = np.linalg.cholesky(covariance)
        except np.linalg.LinAlgError as error:
            what = "its covariance is not positive definite."
            raise InputError(type(self).__name__, what) from error
        self.covariance = covariance
        self.dof = dof
        self.gate = gate
        self._large_threshold = np.inf
        # Computed from its root, an information is never negative by rounding.
        inverse_root = np.linalg.inv(root)
        self._information: FloatArray = np.asarray(inverse_root.T @ inverse_root)

    @property
    @abstractmethod
    def variables(self) -> tuple[Variable, ...]:
        """The variables that it constrains."""

    @abstractmethod
    def residual(self, values: Values) -> FloatArray:
        """Return the residual, measured minus predicted, [d]."""

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return ∂residual/∂(perturbation of each variable), [d, n] each."""
        return numeric_jacobians(self, values)

    @property
    def has_own_loss(self) -> bool:
        """Whether it has a robust loss of its own, a Student-t or a gate, that must not be
        replaced."""
        return bool(np.isfinite(self.dof) or np.isfinite(self.gate))

    def scaled(self, factor: float) -> Self:
        """Return the same measurement with its covariance multiplied by a factor."""
        other = copy.copy(self)
        other.covariance = factor * self.covariance
        other._information = self._information / factor
        return other

    def bounded(self) -> Self:
        """Return the same measurement with a bounded loss, unless it has a loss of its own.

        With s the squared Mahalanobis distance and a its 95 % quantile
        (``LARGE_TAIL_PROBABILITY``), the loss is s/2 up to a, and a − a²/(2s) beyond. It never
        exceeds a, and its weight (a/s)² falls so fast that the influence of a wrong measurement
        vanishes.
        """
        if self.has_own_loss:
            return self
        other = copy.copy(self)
        other._large_threshold = large_residual_threshold(len(self.covariance))
        return other

    def innovation_squared(self, values: Values, covariance: FloatArray, *, of: Variable) -> float:
        """Return the squared Mahalanobis distance of the innovation against a prior.

        With J the Jacobian by the variable and P the covariance of the prior, the innovation has
        the covariance R + J P Jᵀ.

        Args:
            values: the prior.
            covariance: P of one of its variables, [n, n]; the others are known.
            of: that variable.
        """
        innovation = self.residual(values)
        jacobian = self.jacobians(values)[self.variables.index(of)]
        innovation_cov = self.covariance + jacobian @ covariance @ jacobian.T
        return float(squared_mahalanobis(innovation, innovation_cov))

    def reweighted(self, values: Values, covariance: FloatArray, *, of: Variable) -> Self:
        """Return the same measurement, if its loss is ``bounded``, with the weight that this loss
        has for the innovation against a prior (see ``innovation_squared``), instead of for the
        residual by itself.

        A prior may be off by many standard deviations of a precise sensor, which says nothing
        against the sensor.
        """
        if np.isinf(self._large_threshold):
            return self
        squared = self.innovation_squared(values, covariance, of=of)
        other = self.scaled(1.0 / bounded_weight(squared, self._large_threshold))
        other._large_threshold = np.inf
        return other

    def propagated(self, values: Values) -> VectorMeasurement:
        """Return itself: its covariance does not depend on the values."""
        return self

    def linearize(self, values: Values, *, newton: bool = False) -> Linearization:
        """Return cost and normal equations, the robust weight included."""
        return self.linearize_about(values, jacobians_at=values)

    def linearize_about(self, values: Values, *, jacobians_at: Values) -> Linearization:
        """Return cost and normal equations at some values, with the Jacobians at others.

        A window evaluates all Jacobians of a pose at the same point ("first-estimates Jacobians").
        Otherwise it would gain spurious information about its position and yaw in the world.
        """
        residual = self.residual(values)
        jacobian = np.hstack(self.jacobians(jacobians_at))
        squared = float(residual @ self._information @ residual)
        # Residuals are measured minus predicted, J = ∂e/∂ξ, so that the descent of ½ w eᵀ Σ⁻¹ e is
        # −w Jᵀ Σ⁻¹ e. IRLS: the weight is held, so the Hessian is positive semi-definite even for
        # outliers.
        weighted = self._weight(squared) * jacobian.T @ self._information
        return Linearization(
            cost=self._cost(squared),
            hessian=weighted @ jacobian,
            gradient=-weighted @ residual,
        )

    def information(self, values: Values) -> FloatArray:
        """Return Jᵀ Σ⁻¹ J times the curvature of the loss at the residual.

        That of a Student-t is (ν + d)/(ν + d + 2) on average, as its Fisher information has it, and
        vanishes where the residual is an outlier.
        """
        residual = self.residual(values)
        jacobian = np.hstack(self.jacobians(values))
        squared = float(residual @ self._information @ residual)
        curvature = self._curvature(squared)
        information: FloatArray = curvature * jacobian.T @ self._information @ jacobian
        return information

    def outcome(self, values: Values) -> Outcome:
        """Return weight and gating of its residual."""
        residual = self.residual(values)
        squared = float(residual @ self._information @ residual)
        perfect = self._weight(0.0)
        return Outcome(
            mahalanobis_sq=np.array([squared]),
            weight=np.array([self._weight(squared) / perfect]),
            gated=np.array([squared > self.gate]),
        )

    def _weight(self, squared: float) -> float:
        """Return the IRLS weight (ν + d)/(ν + s); 0 beyond the gate."""
        if squared > self.gate:
            return 0.0
        if np.isinf(self.dof):
            return bounded_weight(squared, self._large_threshold)
        return (self.dof + len(self.covariance)) / (self.dof + squared)

    def _curvature(self, squared: float) -> float:
        """Return the second derivative of the loss, averaged over the d directions of the
        residual; 0 beyond the gate."""
        if squared > self.gate or np.isinf(self.dof):
            return self._weight(squared)
        # w I − 2 w e eᵀ/(ν + s) of the white residual e. One with few dimensions has a negative
        # mean where it is large; what is left of its information is then next to nothing.
        mean = 1.0 - 2.0 / len(self.covariance) * squared / (self.dof + squared)
        return self._weight(squared) * max(0.0, mean)

    def _cost(self, squared: float) -> float:
        squared = min(squared, self.gate)
        if squared > self._large_threshold:
            return self._large_threshold * (1.0 - 0.5 * self._large_threshold / squared)
        if np.isinf(self.dof):
            return 0.5 * squared
        return 0.5 * (self.dof + len(self.covariance)) * float(np.log1p(squared / self.dof))


def large_residual_threshold(dim: int) -> float:
    """Return the quantile of χ²(dim) beyond which a residual counts as large."""
    return float(chdtri(dim, LARGE_TAIL_PROBABILITY))


def bounded_weight(squared: float, threshold: float) -> float:
    """Return the weight of the bounded loss: 1, and (a/s)² where s is larger than a."""
    if squared <= threshold:
        return 1.0
    return (threshold / squared) ** 2


def numeric_jacobians(measurement: VectorMeasurement, values: Values) -> tuple[FloatArray, ...]:
    """Differentiate a residual by central differences: one [d, n] for each variable."""
    jacobians_by_variable = []
    for variable in measurement.variables:
        columns = []
        # One column a degree of freedom, (e(+h) − e(−h))/(2 h). 1e-6 balances the truncation error,
        # ∝ h², and the rounding error, ∝ 1/h.
        for unit in 1e-6 * np.eye(dimension(values[variable])):
            ahead = {**values, variable: retract(values[variable], unit)}
            behind = {**values, variable: retract(values[variable], -unit)}
            change = measurement.residual(ahead) - measurement.residual(behind)
            columns.append(change / 2e-6)
        jacobians_by_variable.append(np.stack(columns, axis=1))
    return tuple(jacobians_by_variable)
