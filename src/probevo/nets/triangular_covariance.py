"""Covariances that a head of a network may give: positive definite whatever its outputs are."""

from __future__ import annotations

import math
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from probevo.arrays import AnyArray, FloatArray


@dataclass(frozen=True)
class TriangularCovariance:
    """Σ of an error of d dimensions, by Σ⁻¹ = Uᵀ diag(1/σ²) U.

    A head gives d numbers for σ on a logarithmic scale between two bounds, and those below the
    diagonal of U, row by row: a lower triangular matrix with ones on its diagonal, whose entries
    are between −1 and 1. So the condition number is bounded, too.
    """

    dof: int
    """d."""
    least: float
    """Least σ, before U mixes the axes."""
    most: float
    """Largest σ."""
    first: float
    """σ that an output of zero stands for."""

    @property
    def num_outputs(self) -> int:
        """Numbers that a head gives."""
        return self.dof * (self.dof + 1) // 2

    def whiten(self, raw: jax.Array, errors: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Return diag(1/σ) U e, [..., d], and ½ ln |Σ|, [...], which is Σ ln σ since |U| = 1.

        Args:
            raw: outputs of the head, [..., num_outputs].
            errors: e, [..., d].
        """
        share = jax.nn.sigmoid(raw[..., : self.dof] + self._offset)
        log_sigma = math.log(self.least) + self._log_range * share
        below_diagonal = jnp.tanh(raw[..., self.dof :])
        # U e, row by row
        mixed = []
        first = 0
        for row in range(self.dof):
            entries = below_diagonal[..., first : first + row]
            mixed.append(errors[..., row] + jnp.sum(entries * errors[..., :row], axis=-1))
            first += row
        return jnp.stack(mixed, axis=-1) * jnp.exp(-log_sigma), jnp.sum(log_sigma, axis=-1)

    def covariance(self, raw: AnyArray) -> FloatArray:
        """Return Σ = U⁻¹ diag(σ²) U⁻ᵀ, [..., d, d], in float64, of outputs [..., num_outputs]."""
        raw = np.asarray(raw, np.float64)
        # The logistic function of ``whiten``, without overflow
        share = 0.5 * (1.0 + np.tanh(0.5 * (raw[..., : self.dof] + self._offset)))
        sigma = np.exp(math.log(self.least) + self._log_range * share)
        rows, columns = np.tril_indices(self.dof, -1)
        unit = np.broadcast_to(np.eye(self.dof), (*raw.shape[:-1], self.dof, self.dof)).copy()
        unit[..., rows, columns] = np.tanh(raw[..., self.dof :])
        # The root U⁻¹ diag(σ) of Σ has the columns of U⁻¹ times σ.
        root = np.linalg.inv(unit) * sigma[..., None, :]
        covariance: FloatArray = root @ root.mT
        return covariance

    @property
    def _log_range(self) -> float:
        return math.log(self.most / self.least)

    @property
    def _offset(self) -> float:
        """Offset of the outputs for σ, so that zero stands for ``first``."""
        share = math.log(self.first / self.least) / self._log_range
        return math.log(share / (1.0 - share))
