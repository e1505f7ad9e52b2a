"""The check of a covariance that a model file holds."""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray


def is_positive_definite(array: AnyArray, size: int) -> bool:
    """Return whether an array is a symmetric positive definite matrix [size, size] of float64."""
    if array.shape != (size, size) or array.dtype != np.float64 or not np.isfinite(array).all():
        return False
    # The eigenvalues are computed from the lower triangle alone, so symmetry is checked by itself.
    is_symmetric = np.allclose(array, array.T, rtol=1e-9, atol=0.0)
    return is_symmetric and bool(np.linalg.eigvalsh(array)[0] > 0.0)
