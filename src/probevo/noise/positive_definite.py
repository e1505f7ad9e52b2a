"""The check of a covariance that a noise model is given, or that its file holds."""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray
from probevo.errors import InputError, brief


def is_positive_definite(array: AnyArray, size: int) -> bool:
    """Return whether an array is a symmetric positive definite matrix [size, size] of float64."""
    if array.shape != (size, size) or array.dtype != np.float64 or not np.isfinite(array).all():
        return False
    # The eigenvalues are computed from the lower triangle alone, so symmetry is checked by itself.
    is_symmetric = np.allclose(array, array.T, rtol=1e-9, atol=0.0)
    return is_symmetric and bool(np.linalg.eigvalsh(array)[0] > 0.0)


def check_positive_definite(given: object, name: str, size: int) -> None:
    """Refuse what is no symmetric positive definite matrix [size, size].

    Raises:
        InputError: says what it is.
    """
    try:
        array = np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.empty(0)
    if not is_positive_definite(array, size):
        raise InputError(
            "noise model",
            f"its {name} is {brief(given)}.",
            f"Give a symmetric positive definite matrix, {size} × {size}, px².",
        )
