"""Inverses of covariances and information matrices, scaled to a unit diagonal first.

The variances of a state differ by many decades, as metres, radians and standard deviations of the
jitter do. On a diagonal of ones they count alike, so that neither the rounding of the inverse nor
the test whether there is one depends on the units.
"""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, invert_positive_definite

MIN_EIGENVALUE = 1e-10
"""Smallest eigenvalue, on a unit diagonal, that is not a matter of rounding: between the rounding
of a sum, 1e-16 times a few hundred, and what a measurement adds."""


def scaled_inverse(matrix: FloatArray) -> FloatArray:
    """Invert a symmetric matrix, [n, n], whose diagonal is positive; the inverse is symmetric.

    Raises:
        numpy.linalg.LinAlgError: it is singular.
    """
    scale = 1.0 / np.sqrt(np.diagonal(matrix))
    inverse: FloatArray = np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale
    return 0.5 * (inverse + inverse.T)


def scaled_pseudo_inverse(matrix: FloatArray) -> FloatArray:
    """Invert a symmetric positive semi-definite matrix, [n, n], whose diagonal is positive, in its
    range only.

    Eigenvalues of the scaled matrix below ``MIN_EIGENVALUE`` count as zero. If the matrix is a
    block M_bb of a semi-definite one, the columns of M_ba lie in its range, and the Schur
    complement M_aa − M_ab M_bb⁺ M_ba is that of any state that gives M_bb an inverse.
    """
    scale = 1.0 / np.sqrt(np.diagonal(matrix))
    values, directions = np.linalg.eigh(matrix * scale[:, None] * scale)
    is_known = values > MIN_EIGENVALUE
    known = directions[:, is_known] * scale[:, None]
    inverse: FloatArray = (known / values[is_known]) @ known.T
    return 0.5 * (inverse + inverse.T)


def inverse_or_nan(information: FloatArray) -> FloatArray:
    """Return the inverse, [n, n], or NaN where the information is not positive definite to working
    precision."""
    inverse = np.empty(information.shape)
    if not _invert_positive_definite(information, inverse):
        inverse[:] = np.nan
    return inverse


@compiled
def _invert_positive_definite(information: FloatArray, inverse: FloatArray) -> bool:
    """Fill in the inverse; False where the scaled information is not positive definite.

    A diagonal entry that is not positive makes all NaN, which fails the test.
    """
    n = len(information)
    sigma = np.empty(n)
    for i in range(n):
        sigma[i] = 1.0 / math.sqrt(information[i, i]) if information[i, i] > 0.0 else math.nan
    scaled = np.empty((n, n))
    for i in range(n):
        for j in range(n):
            scaled[i, j] = information[i, j] * sigma[i] * sigma[j]
    if not invert_positive_definite(scaled, np.zeros((n, n)), inverse):
        return False
    for i in range(n):
        for j in range(n):
            inverse[i, j] *= sigma[i] * sigma[j]
    return True
