"""The measurement protocol: a constraint on some variables, with its own covariance and robust
loss.

Every sensor enters the estimate through it. The solver (``estimation.levenberg_marquardt``) knows
no sensor by name: it sums the normal equations of all measurements. A new sensor is one class; most
need only a residual and its Jacobians (``measurements.vector_measurement``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from probevo.arrays import BoolArray, FloatArray
from probevo.measurements.variables import Values, Variable


class Linearization(NamedTuple):
    """The normal equations of one measurement over its n degrees of freedom, in the order of its
    variables."""

    cost: float
    hessian: FloatArray
    """[n, n]."""
    gradient: FloatArray
    """The direction of descent, [n]: the step solves hessian · step = gradient."""


@dataclass(frozen=True)
class Outcome:
    """Weights and gating of the N residuals of a measurement (one, or a batch)."""

    mahalanobis_sq: FloatArray
    """Squared Mahalanobis distance of each residual, [N]."""
    weight: FloatArray
    """Robust weight of each residual, relative to the weight of a zero residual, [N], 0 to 1."""
    gated: BoolArray
    """Which residuals the gate rejected, [N]."""


class Measurement(Protocol):
    """A constraint on some variables. It is immutable: the solver never changes it."""

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The variables that it constrains."""

    def propagated(self, values: Values) -> Measurement:
        """Return the same measurement with its covariance evaluated at these values.

        The solver keeps that covariance until it has moved by a standard deviation. A measurement
        whose covariance does not depend on the values returns itself.
        """

    def linearize(self, values: Values, *, newton: bool = False) -> Linearization:
        """Return cost and normal equations at these values.

        Args:
            values: values of its variables; others are ignored.
            newton: the solver is close to the optimum, and the curvature of the robust loss may
                enter the Hessian.
        """

    def information(self, values: Values) -> FloatArray:
        """Return its Fisher information on its variables, [n, n].

        The covariance of an estimate is the inverse of their sum. For a robust loss this is not the
        Hessian of ``linearize``, whose weights depend on the residuals.
        """

    def outcome(self, values: Values) -> Outcome:
        """Return weights and gating of its residuals at these values."""
