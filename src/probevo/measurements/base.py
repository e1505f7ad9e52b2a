"""The measurement protocol: a constraint on some variables, with its own covariance and robust
loss.

Every sensor enters the estimate through it. The solver (``estimation.levenberg_marquardt``) knows
no sensor by name: it sums the normal equations of all measurements. A new sensor is one class; most
need only a residual and its Jacobians (``VectorMeasurement``).
"""

from __future__ import annotations

import copy
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self, SupportsFloat

import numpy as np
from scipy.special import chdtri

from probevo.arrays import BoolArray, FloatArray
from probevo.errors import InputError, brief
from probevo.geometry import se3, so3
from probevo.geometry.se3_numba import perturb

ASYMMETRY = 1e-8
"""Largest difference between a covariance and its transpose, relative to its largest entry, that is
taken as rounding."""

LARGE_TAIL_PROBABILITY = 0.05
"""Tail probability of a residual beyond which a bounded loss is no longer quadratic. It is the same
for all sensors, whatever the dimension of their residual."""


class Variable(NamedTuple):
    """An unknown of the problem."""

    kind: str
    """Its kind, e.g. ``pose``."""
    frame: int
    """Index of the frame that it belongs to."""


def pose_of(frame: int) -> Variable:
    """Return the variable T_cam_world of a frame, [4, 4], perturbed from the left by ξ, [6]."""
    return Variable(kind="pose", frame=frame)


class PosePair(NamedTuple):
    """The poses of the two frames that a relative measurement connects."""

    curr: Variable
    """Pose of the current frame."""
    prev: Variable | None = None
    """Pose of the previous frame; None if the world of the poses is the previous camera."""


MOTION = pose_of(0)
"""The default variable of a two-frame solve. With the previous camera as the world, the pose of the
current camera is the motion T_curr_prev."""

TWO_FRAMES = PosePair(MOTION)
"""The poses of a two-frame solve."""

Values = Mapping[Variable, FloatArray]
"""A value for each variable: poses T_cam_world [4, 4], anything else a vector [n]."""


def dimension(value: FloatArray) -> int:
    """Return the number of degrees of freedom of a variable's value."""
    return 6 if value.shape == (4, 4) else len(value)


def retract(value: FloatArray, step: FloatArray) -> FloatArray:
    """Move a value by a step: Exp(ξ) T for a pose, plain addition for a vector."""
    if value.shape != (4, 4):
        return value + step
    moved = np.empty((4, 4))
    perturb(step, value, moved)
    return moved


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

    squared: FloatArray
    """Squared Mahalanobis distance of each residual, [N]."""
    weight: FloatArray
    """Robust weight of each, relative to that of a zero residual, [N], 0 to 1."""
    gated: BoolArray
    """Which were rejected by the gate, [N]."""


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
        # By its root, no rounding makes an information negative.
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
        return float(innovation @ np.linalg.solve(innovation_cov, innovation))

    def weighed(self, values: Values, covariance: FloatArray, *, of: Variable) -> Self:
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
            squared=np.array([squared]),
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


def as_transform(T: object, where: str) -> FloatArray:
    """Return the rigid transform nearest to a matrix, [4, 4]; NaN is what a sensor without a fix
    gives.

    Raises:
        InputError: it is of another kind or shape, or no rigid transform up to rounding.
    """
    matrix = as_array(T, (4, 4), where)
    if np.isfinite(matrix).all():
        C = so3.check_rotation(matrix[:3, :3], where)
        if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > so3.ROTATION_TOLERANCE:
            raise InputError(where, "the last row of this transform is not 0 0 0 1.")
        matrix = se3.from_parts(C, matrix[:3, 3])
    return matrix


def as_rotation(C: object, where: str) -> FloatArray:
    """Return the rotation nearest to a matrix, [3, 3]; NaN is what a sensor without a fix gives.

    Raises:
        InputError: it is of another kind or shape, or no rotation up to rounding.
    """
    matrix = as_array(C, (3, 3), where)
    if np.isfinite(matrix).all():
        matrix = so3.check_rotation(matrix, where)
    return matrix


def as_array(values: object, shape: tuple[int, ...], where: str) -> FloatArray:
    """Return what a measurement is made of as an array of floats.

    Raises:
        InputError: it holds something else than numbers, or has another shape.
    """
    needed = f"Give numbers, [{', '.join(map(str, shape))}]."
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(where, f"it is {brief(values)}.", needed) from None
    if array.shape != shape:
        raise InputError(where, f"it has shape {array.shape}.", needed)
    return array


def as_number(value: object, where: str) -> float:
    """Return a number as a float; NaN is what a sensor without a fix gives.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(value, SupportsFloat) or getattr(value, "shape", ()) != ():
        raise InputError(where, f"is {brief(value)}.", "Give a number.")
    return float(value)


def as_sigma(value: object, where: str) -> float:
    """Return a standard deviation as a float.

    Raises:
        InputError: it is no number, or not positive.
    """
    sigma = as_number(value, where)
    if not sigma > 0.0:
        raise InputError(where, f"is {sigma}.", "It must be positive.")
    return sigma


def numeric_jacobians(measurement: VectorMeasurement, values: Values) -> tuple[FloatArray, ...]:
    """Differentiate a residual by central differences: one [d, n] for each variable."""
    found = []
    for variable in measurement.variables:
        columns = []
        # One column a degree of freedom, (e(+h) − e(−h))/(2 h). 1e-6 balances the truncation error,
        # ∝ h², and the rounding error, ∝ 1/h.
        for unit in 1e-6 * np.eye(dimension(values[variable])):
            ahead = {**values, variable: retract(values[variable], unit)}
            behind = {**values, variable: retract(values[variable], -unit)}
            change = measurement.residual(ahead) - measurement.residual(behind)
            columns.append(change / 2e-6)
        found.append(np.stack(columns, axis=1))
    return tuple(found)


def blocks_of(variables: Sequence[Variable], values: Values) -> tuple[dict[Variable, slice], int]:
    """Return where each variable's degrees of freedom lie in the joint vector, and their number."""
    found: dict[Variable, slice] = {}
    start = 0
    for variable in variables:
        stop = start + dimension(values[variable])
        found[variable] = slice(start, stop)
        start = stop
    return found, start
