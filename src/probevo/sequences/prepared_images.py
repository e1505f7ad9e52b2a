"""A stereo pair that was prepared for tracking ahead of time; a frame may contain it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.config import TrackingConfig

Pyramid = tuple[Image, ...]
"""An image and its halved versions, level by level, [height / 2^level, width / 2^level], uint8."""


NONE_SATURATED: Image = np.zeros((0, 0), np.uint8)
"""The map of saturated pixels of an image that has none."""


class SplineImage(NamedTuple):
    """An image, and the spline through its pixels; ``tracking.spline`` makes it."""

    pixels: Image
    """Grey levels, [height, width], uint8."""
    coefficients: FloatArray
    """Coefficients of the cubic B-spline, [height, width], float32, grey levels."""
    saturated: Image
    """1 where a pixel is saturated, else 0, [height, width], uint8; empty if none is."""


@dataclass(frozen=True)
class PreparedImages:
    """A stereo pair in the form in which it is tracked; ``tracking.preparation`` makes it."""

    left: Pyramid
    """Left image minus its local mean, and the pyramid levels above it."""
    right: Pyramid
    """Right image in the same form."""
    left_spline: SplineImage
    """Left image minus its local mean, with the spline through its pixels."""
    right_spline: SplineImage
    """Right image in the same form."""
    corners: FloatArray
    """The strongest corners of each cell of the left image, as from ``strongest_corners``."""
    left_usable: BoolArray | None
    """Where the window of a feature lies within the mask of the left image, [height, width]; None
    without a mask."""
    right_usable: BoolArray | None
    """The same for the right image."""
    config: TrackingConfig
    """The settings that the pair was prepared with."""
