"""Names for the array types that appear in signatures.

Each docstring gives the shapes and units of its arrays.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Image = NDArray[np.uint8]
"""Grayscale image, [height, width], uint8."""
AnyArray = NDArray[Any]


def evenly(count: int, most: int) -> IntArray:
    """Return at most ``most`` of the indices 0 … count − 1, evenly spread from first to last."""
    indices: IntArray = np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
    return indices
