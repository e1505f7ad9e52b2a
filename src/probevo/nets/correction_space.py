"""Pose corrections as what a network regresses: units and weights come from the training data.

The loss is ½ gᵀ Σ⁻¹ g with g = Log(Exp(ξ) T*⁻¹) (thesis chapter 6). With Σ = L Lᵀ, the covariance
of the training data, it is ½ |L⁻¹ g|². So errors here are L⁻¹ g, estimates ξ = L o of outputs o,
and a covariance head gives Σ in the same units: where none is learned, it is the one of the
training data.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import AnyArray, FloatArray
from probevo.nets.corrections import correction_error
from probevo.nets.triangular_covariance import TriangularCovariance

MIN_SIGMA = 1e-3
MAX_SIGMA = 10.0
"""Learned standard deviations lie between these, in units of the training data's."""
ALL_AXES = (0, 1, 2, 3, 4, 5)
ROTATION_AXES = (3, 4, 5)


@dataclass(frozen=True)
class CorrectionTargets:
    """Corrections ξ = [ρ; φ], [6], m and rad, of which some axes may be left at zero."""

    root: tuple[tuple[float, ...], ...]
    """L, [d, d], lower triangular."""
    axes: tuple[int, ...] = ALL_AXES
    """Axes that are corrected."""

    size = 6
    least_variance = 1.0

    @property
    def dof(self) -> int:
        """The number d of axes."""
        return len(self.axes)

    @property
    def num_outputs(self) -> int:
        """Numbers that a head gives."""
        return self.dof

    @property
    def num_covariance(self) -> int:
        """Numbers that a covariance head gives."""
        return self._covariance.num_outputs

    def estimate(self, outputs: jax.Array) -> jax.Array:
        """Return ξ, [..., 6], of outputs [..., d]."""
        root = jnp.asarray(self.root, outputs.dtype)
        xi = jnp.zeros((*outputs.shape[:-1], 6), outputs.dtype)
        return xi.at[..., jnp.array(self.axes)].set(outputs @ root.T)

    def difference(self, estimates: jax.Array, targets: jax.Array) -> jax.Array:
        """Return L⁻¹ g, [..., d]."""
        shape = jnp.broadcast_shapes(estimates.shape, targets.shape)
        xi = jnp.broadcast_to(estimates, shape).reshape(-1, 6)
        xi_true = jnp.broadcast_to(targets, shape).reshape(-1, 6)
        errors = _errors(xi, xi_true)[:, jnp.array(self.axes)]
        whitened = errors @ jnp.asarray(self._inverse_root, errors.dtype).T
        reshaped: jax.Array = whitened.reshape(*shape[:-1], self.dof)
        return reshaped

    def perturb(self, targets: jax.Array, errors: jax.Array) -> jax.Array:
        """Return ξ* + L e: corrections are small."""
        return targets + self.estimate(errors)

    def mean(self, estimates: jax.Array) -> jax.Array:
        """Return the arithmetic mean: corrections are small."""
        return jnp.mean(estimates, axis=-2)

    def squared(self, errors: jax.Array) -> jax.Array:
        """Return |L⁻¹ g|²."""
        return jnp.sum(errors**2, axis=-1)

    def whiten(self, raw: jax.Array, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return the errors in units of their σ, and ½ ln |Σ|, as ``TriangularCovariance`` does."""
        return self._covariance.whiten(raw, errors)

    def covariance(self, raw: AnyArray) -> FloatArray:
        """Return Σ, [..., d, d], in units of L."""
        return self._covariance.covariance(raw)

    def in_metres_and_rad(self, covariances: FloatArray) -> FloatArray:
        """Return L Σ Lᵀ of covariances in units of L, [..., d, d]."""
        root = np.asarray(self.root)
        scaled: FloatArray = root @ covariances @ root.T
        return scaled

    @property
    def _covariance(self) -> TriangularCovariance:
        # An output of zero stands for the covariance of the training data.
        return TriangularCovariance(dof=self.dof, least=MIN_SIGMA, most=MAX_SIGMA, first=1.0)

    @cached_property
    def _inverse_root(self) -> FloatArray:
        inverse: FloatArray = np.linalg.inv(np.asarray(self.root))
        return inverse


@jax.jit
def _errors(xi: jax.Array, xi_true: jax.Array) -> jax.Array:
    """Return g of N estimates, [N, 6]: compiled, since a single one has hundreds of operations."""
    errors: jax.Array = jax.vmap(correction_error)(xi, xi_true)
    return errors
