"""Pose corrections as what a network regresses: units and weights come from the training data.

The loss is ½ gᵀ Σ⁻¹ g with g = Log(Exp(ξ) T*⁻¹) (thesis chapter 6). With Σ = L Lᵀ, the covariance
of the training data, it is ½ |L⁻¹ g|². So errors here are L⁻¹ g, estimates ξ = L o of outputs o,
and a covariance head gives Σ in the same units: where none is learned, it is that of the training
data.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import AnyArray, FloatArray
from probevo.nets.corrections import correction_error

LEAST_SIGMA = 1e-3
MOST_SIGMA = 10.0
"""Learned standard deviations lie between these, in units of the training data's."""
ALL_AXES = (0, 1, 2, 3, 4, 5)
ROTATION_AXES = (3, 4, 5)


@dataclass(frozen=True)
class CorrectionTargets:
    """Corrections ξ = [ρ; φ], [6], m and rad, of which some axes may be left at zero.

    A covariance head gives d numbers for σ on a logarithmic scale between 1e-3 and 10, and a unit
    lower triangular matrix U with entries between −1 and 1; Σ⁻¹ = Uᵀ diag(1/σ²) U in units of L.
    """

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
        return self.dof * (self.dof + 1) // 2

    def estimate(self, outputs: jax.Array) -> jax.Array:
        """Return ξ, [..., 6], of outputs [..., d]."""
        root = jnp.asarray(self.root, outputs.dtype)
        found = jnp.zeros((*outputs.shape[:-1], 6), outputs.dtype)
        return found.at[..., jnp.array(self.axes)].set(outputs @ root.T)

    def difference(self, estimates: jax.Array, targets: jax.Array) -> jax.Array:
        """Return L⁻¹ g, [..., d]."""
        shape = jnp.broadcast_shapes(estimates.shape, targets.shape)
        flat = (jnp.broadcast_to(each, shape).reshape(-1, 6) for each in (estimates, targets))
        errors = _errors(*flat)[:, jnp.array(self.axes)]
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
        """Return diag(1/σ) U e, and Σ log σ."""
        log_sigma = _LOG_LEAST + _LOG_RANGE * jax.nn.sigmoid(raw[..., : self.dof] + _FIRST)
        lower = jnp.tanh(raw[..., self.dof :])
        # U e row by row; ``lower`` holds the rows of U below its diagonal of ones, one after
        # another.
        mixed = []
        first = 0
        for row in range(self.dof):
            last = first + row
            entries = lower[..., first:last]
            mixed.append(errors[..., row] + jnp.sum(entries * errors[..., :row], axis=-1))
            first = last
        return jnp.stack(mixed, axis=-1) * jnp.exp(-log_sigma), jnp.sum(log_sigma, axis=-1)

    def covariance(self, raw: AnyArray) -> FloatArray:
        """Return Σ, [..., d, d], in units of L, in float64."""
        raw = np.asarray(raw, np.float64)
        # A logistic function without overflow, the sigmoid of ``whiten``
        share = 0.5 * (1.0 + np.tanh(0.5 * (raw[..., : self.dof] + _FIRST)))
        sigma = np.exp(_LOG_LEAST + _LOG_RANGE * share)
        rows, columns = np.tril_indices(self.dof, -1)
        unit = np.broadcast_to(np.eye(self.dof), (*raw.shape[:-1], self.dof, self.dof)).copy()
        unit[..., rows, columns] = np.tanh(raw[..., self.dof :])
        # With Σ⁻¹ = Uᵀ diag(1/σ²) U, the root U⁻¹ diag(σ) of Σ has its columns scaled.
        root = np.linalg.inv(unit) * sigma[..., None, :]
        covariance: FloatArray = root @ root.mT
        return covariance

    def in_metres_and_rad(self, covariances: FloatArray) -> FloatArray:
        """Return L Σ Lᵀ of covariances in units of L, [..., d, d]."""
        root = np.asarray(self.root)
        scaled: FloatArray = root @ covariances @ root.T
        return scaled

    @cached_property
    def _inverse_root(self) -> FloatArray:
        inverse: FloatArray = np.linalg.inv(np.asarray(self.root))
        return inverse


@jax.jit
def _errors(xi: jax.Array, xi_true: jax.Array) -> jax.Array:
    """Return g of N estimates, [N, 6]: compiled, since a single one has hundreds of operations."""
    errors: jax.Array = jax.vmap(correction_error)(xi, xi_true)
    return errors


_LOG_LEAST = math.log(LEAST_SIGMA)
_LOG_RANGE = math.log(MOST_SIGMA / LEAST_SIGMA)
_FIRST_SHARE = -_LOG_LEAST / _LOG_RANGE
_FIRST = math.log(_FIRST_SHARE / (1.0 - _FIRST_SHARE))
"""Added to the outputs for σ, so that zeros mean 1."""
