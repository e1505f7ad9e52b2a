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


def scaled_inverse(matrix: FloatArray) -> FloatArray:
    """Invert a symmetric matrix, [n, n], whose diagonal is positive; the inverse is symmetric.

    Raises:
        numpy.linalg.LinAlgError: it is singular.
    """
    scale = 1.0 / np.sqrt(np.diagonal(matrix))
    inverse: FloatArray = np.linalg.inv(matrix * scale[:, None] * scale) * scale[:, None] * scale
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
