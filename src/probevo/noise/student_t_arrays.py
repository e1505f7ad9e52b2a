"""The arrays of many Student-t fits: the errors, their neighbourhoods, the prior and the results.

They are ``NamedTuple``s, which the compiled loops take as they are.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import BoolArray, FloatArray, IntArray

DIM = 4
"""Dimension d of an error: (u_l, v_l, u_r, v_r)."""
ROW, COLUMN = np.tril_indices(DIM)
"""Rows and columns of the lower triangle of a symmetric matrix, in the order of packing."""
NUM_PARAMETERS = 15
"""Number of log-Cholesky parameters of a Student-t: bias [4], Cholesky factor [10] and ln ν."""
LOG_PARAMETERS = [4, 6, 9, 13, 14]
"""Which of these are logarithms: the diagonal of the Cholesky factor, and ν."""


class StudentTBatch(NamedTuple):
    """C Student-t distributions t_ν(b, Σ)."""

    scale: FloatArray
    """Scale matrices Σ, [C, 4, 4], px²."""
    dof: FloatArray
    """Degrees of freedom ν, [C]."""
    bias: FloatArray
    """Biases b, [C, 4], px."""

    def log_cholesky(self) -> NDArray[np.float32]:
        """Return parameters of which every weighted mean is a valid distribution again.

        The scale is parametrised by its Cholesky factor L with the logarithm of the diagonal
        (Pinheiro & Bates 1996), so that any mean gives a positive definite Σ = L Lᵀ.

        Returns:
            Bias [4], L [10] in the order of ``ROW`` and ``COLUMN``, and ln ν, as [C, 15].
        """
        lower = np.linalg.cholesky(self.scale)[:, ROW, COLUMN]
        diagonal = ROW == COLUMN
        lower[:, diagonal] = np.log(lower[:, diagonal])
        parameters = np.column_stack([self.bias, lower, np.log(self.dof)])
        return np.ascontiguousarray(parameters, np.float32)

    def replaced(self, chosen: BoolArray, by: StudentTBatch) -> StudentTBatch:
        """Return the distributions with those chosen, [C], replaced by a single one."""
        if not chosen.any():
            return self
        return StudentTBatch(
            scale=np.where(chosen[:, None, None], by.scale, self.scale),
            dof=np.where(chosen, by.dof, self.dof),
            bias=np.where(chosen[:, None], by.bias, self.bias),
        )


class StudentTPrior(NamedTuple):
    """The prior of a fit: a Student-t without bias, and how many errors each part counts for."""

    scale: FloatArray
    """Prior scale matrix, [4, 4], px²."""
    dof: float
    """Prior degrees of freedom; finite, if the fit is to be robust."""
    counts: float
    """Pseudo-counts of the scale: the number of errors that it counts for."""
    dof_counts: float
    """Pseudo-counts of the degrees of freedom; np.inf holds them at the prior."""
    bias_counts: float
    """Pseudo-counts of the bias, whose prior is zero; np.inf holds it there."""


class PackedErrors(NamedTuple):
    """N errors, each known exactly or with a covariance."""

    errors: FloatArray
    """[N, 4], px."""
    packed_cov: FloatArray
    """Lower triangle of the covariance of each error, [N, 10], px²; [0, 10] if all are exact."""


class Neighborhoods(NamedTuple):
    """The errors that contribute to each of C fits, and the value of the kernel for each."""

    first: IntArray
    """Position in ``members`` at which each fit begins, and n at the end, [C + 1]."""
    members: IntArray
    """Indices of the errors, one fit after another, [n]."""
    kernel: FloatArray
    """Kernel k of each, 0 … 1, [n]."""

    @staticmethod
    def of_all(count: int) -> Neighborhoods:
        """Return the neighbourhood of a single fit to all errors, each with k = 1."""
        return Neighborhoods(
            first=np.array([0, count]), members=np.arange(count), kernel=np.ones(count)
        )

    @property
    def counts(self) -> FloatArray:
        """Effective number of errors Σ k of each fit, [C]."""
        sums = np.concatenate([[0.0], np.cumsum(self.kernel)])
        counts: FloatArray = np.diff(sums[self.first])
        return counts
