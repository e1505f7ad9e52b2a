"""The spaces of what networks regress, with the covariance of its error: numbers, or rotations.

The outputs of a head are plain numbers. A target space maps them to an estimate and to a covariance
that is positive definite whatever the weights are. Errors are tangent vectors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import AnyArray, FloatArray
from probevo.nets import quaternions
from probevo.nets.triangular_covariance import TriangularCovariance

MIN_VARIANCE = 1e-6
"""Smallest variance of a number; as published."""
MIN_SIGMA_RAD = 1e-4
MAX_SIGMA_RAD = math.pi
"""Standard deviations of rotations lie between these two before axes are mixed."""
FIRST_SIGMA_RAD = 0.5
"""Standard deviation that an output of zero stands for. If it is small, the first steps of a
training are huge."""


class TargetSpace(Protocol):
    """A space of estimates with differences; leading dimensions are batches."""

    @property
    def num_outputs(self) -> int:
        """Numbers that a head gives for an estimate."""

    @property
    def size(self) -> int:
        """Numbers of an estimate."""

    @property
    def dof(self) -> int:
        """Dimension d of an error."""

    @property
    def num_covariance(self) -> int:
        """Numbers that a covariance head gives."""

    @property
    def least_variance(self) -> float:
        """Along each axis, of any prediction."""

    def __hash__(self) -> int:
        """Return the hash: what is compiled for a space is kept."""

    def estimate(self, outputs: jax.Array) -> jax.Array:
        """Return the estimates, [..., size], that a head's outputs mean."""

    def difference(self, estimates: jax.Array, targets: jax.Array) -> jax.Array:
        """Return the errors of estimates, [..., d]."""

    def perturb(self, targets: jax.Array, errors: jax.Array) -> jax.Array:
        """Return the targets moved by errors, [..., size]."""

    def mean(self, estimates: jax.Array) -> jax.Array:
        """Return the mean of K estimates each, [..., K, size] to [..., size]."""

    def squared(self, errors: jax.Array) -> jax.Array:
        """Return the loss of errors, [...], where no covariance is learned: φᵀ φ or the like."""

    def whiten(self, raw: jax.Array, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the errors in units of their σ, [..., d], and ½ log|Σ|, [...].

        Args:
            raw: outputs of the covariance head, [..., num_covariance].
            errors: [..., d].
        """

    def covariance(self, raw: AnyArray) -> FloatArray:
        """Return Σ, [..., d, d], that the outputs of a covariance head mean."""


@dataclass(frozen=True)
class NumberTargets:
    """Real numbers, whose variance is softplus(raw) + 1e-6, as published."""

    num_outputs = 1
    size = 1
    dof = 1
    num_covariance = 1
    least_variance = MIN_VARIANCE

    def estimate(self, outputs: jax.Array) -> jax.Array:
        """Return the outputs."""
        return outputs

    def difference(self, estimates: jax.Array, targets: jax.Array) -> jax.Array:
        """Return estimated minus true."""
        return estimates - targets

    def perturb(self, targets: jax.Array, errors: jax.Array) -> jax.Array:
        """Return the sums."""
        return targets + errors

    def mean(self, estimates: jax.Array) -> jax.Array:
        """Return the arithmetic mean."""
        return jnp.mean(estimates, axis=-2)

    def squared(self, errors: jax.Array) -> jax.Array:
        """Return e²."""
        return jnp.sum(errors**2, axis=-1)

    def whiten(self, raw: jax.Array, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return e / σ and log σ."""
        variance = jax.nn.softplus(raw) + MIN_VARIANCE
        return errors * jax.lax.rsqrt(variance), 0.5 * jnp.log(variance[..., 0])

    def covariance(self, raw: AnyArray) -> FloatArray:
        """Return the variance, [..., 1, 1]."""
        # softplus(x) = ln(1 + eˣ), without overflow
        variance = np.logaddexp(0.0, np.asarray(raw, np.float64)) + MIN_VARIANCE
        return variance[..., None]


@dataclass(frozen=True)
class RotationTargets:
    """Rotations as unit quaternions; the error is φ = Log(q ⊗ q*⁻¹), rad, a left perturbation."""

    num_outputs = 4
    size = 4
    dof = 3
    num_covariance = 6
    least_variance = MIN_SIGMA_RAD**2
    first_sigma_rad = FIRST_SIGMA_RAD

    def estimate(self, outputs: jax.Array) -> jax.Array:
        """Return the outputs as unit quaternions."""
        return quaternions.normalized(outputs)

    def difference(self, estimates: jax.Array, targets: jax.Array) -> jax.Array:
        """Return φ = Log(q ⊗ q*⁻¹); the signs of both quaternions do not matter."""
        return quaternions.log(quaternions.product(estimates, quaternions.inverse(targets)))

    def perturb(self, targets: jax.Array, errors: jax.Array) -> jax.Array:
        """Return Exp(φ) ⊗ q*."""
        return quaternions.product(quaternions.exp(errors), targets)

    def mean(self, estimates: jax.Array) -> jax.Array:
        """Return the eigenvector of Σ q qᵀ with the largest eigenvalue."""
        return quaternions.mean(estimates)

    def squared(self, errors: jax.Array) -> jax.Array:
        """Return φᵀ φ."""
        return jnp.sum(errors**2, axis=-1)

    def whiten(self, raw: jax.Array, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the errors in units of their σ, and ½ ln |Σ|, as ``TriangularCovariance`` does."""
        return self._covariance.whiten(raw, errors)

    def covariance(self, raw: AnyArray) -> FloatArray:
        """Return Σ, [..., 3, 3], rad²."""
        return self._covariance.covariance(raw)

    @property
    def _covariance(self) -> TriangularCovariance:
        return TriangularCovariance(
            dof=3, least=MIN_SIGMA_RAD, most=MAX_SIGMA_RAD, first=self.first_sigma_rad
        )


class SmallRotationTargets(RotationTargets):
    """Rotations from one image to the next: a head gives a rotation vector in units of 0.01 rad.

    Near the identity this is better conditioned than a quaternion whose length does not matter.
    """

    num_outputs = 3
    first_sigma_rad = 2e-3
    unit_rad = 0.01

    def estimate(self, outputs: jax.Array) -> jax.Array:
        """Return q = Exp(0.01 o), [..., 4], of outputs [..., 3]."""
        return quaternions.exp(self.unit_rad * outputs)
