"""Names for the array types that appear in signatures.

Each docstring gives the shapes and units of its arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
Image = NDArray[np.uint8]
"""Grayscale image, [height, width], uint8."""
SingleArray = NDArray[np.float32]
AnyArray = NDArray[Any]

StructOfArrays = TypeVar("StructOfArrays", bound="DataclassInstance")
"""A dataclass whose fields are all arrays."""


def evenly(count: int, most: int) -> IntArray:
    """Return at most ``most`` of the indices 0 … count − 1, evenly spread from first to last."""
    indices: IntArray = np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
    return indices


def rows_of(ids: IntArray, known: IntArray) -> IntArray:
    """Return the place of each identity, [N], among different known ones, [K]; −1 where missing."""
    if not len(known):
        return np.full(len(ids), -1)
    # By bisection among the sorted ones. For one that is missing this finds another one.
    order = np.argsort(known)
    place = np.searchsorted(known, ids, sorter=order)
    rows: IntArray = order[np.minimum(place, len(order) - 1)]
    return np.where(known[rows] == ids, rows, -1)


def concatenated(parts: Sequence[StructOfArrays]) -> StructOfArrays:
    """Concatenate the arrays of at least one struct of arrays, field by field."""
    names = [field.name for field in fields(parts[0])]
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in names}
    return replace(parts[0], **arrays)
