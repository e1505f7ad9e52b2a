"""Arguments of measurements: transforms, rotations, arrays and numbers, checked."""

from __future__ import annotations

from typing import SupportsFloat

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError, brief
from probevo.geometry import se3, so3


def as_transform(T: object, where: str) -> FloatArray:
    """Return the rigid transform nearest to a matrix, [4, 4]; NaN is what a sensor without a fix
    gives.

    Raises:
        InputError: it is of another kind or shape, or no rigid transform up to rounding.
    """
    matrix = as_array(T, (4, 4), where)
    if np.isfinite(matrix).all():
        C = so3.check_rotation(matrix[:3, :3], where)
        if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > so3.ROTATION_TOLERANCE:
            raise InputError(where, "the last row of this transform is not 0 0 0 1.")
        matrix = se3.from_parts(C, matrix[:3, 3])
    return matrix


def as_rotation(C: object, where: str) -> FloatArray:
    """Return the rotation nearest to a matrix, [3, 3]; NaN is what a sensor without a fix gives.

    Raises:
        InputError: it is of another kind or shape, or no rotation up to rounding.
    """
    matrix = as_array(C, (3, 3), where)
    if np.isfinite(matrix).all():
        matrix = so3.check_rotation(matrix, where)
    return matrix


def as_array(values: object, shape: tuple[int, ...], where: str) -> FloatArray:
    """Return what a measurement is made of as an array of floats.

    Raises:
        InputError: it holds something else than numbers, or has another shape.
    """
    needed = f"Give numbers, [{', '.join(map(str, shape))}]."
    try:
        array = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise InputError(where, f"it is {brief(values)}.", needed) from None
    if array.shape != shape:
        raise InputError(where, f"it has shape {array.shape}.", needed)
    return array


def as_number(value: object, where: str) -> float:
    """Return a number as a float; NaN is what a sensor without a fix gives.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(value, SupportsFloat) or getattr(value, "shape", ()) != ():
        raise InputError(where, f"is {brief(value)}.", "Give a number.")
    return float(value)


def as_sigma(value: object, where: str) -> float:
    """Return a standard deviation as a float.

    Raises:
        InputError: it is no number, or not positive.
    """
    sigma = as_number(value, where)
    if not sigma > 0.0:
        raise InputError(where, f"is {sigma}.", "It must be positive.")
    return sigma
