"""A stereo pair that was prepared for tracking ahead of time; a frame may contain it."""

from __future__ import annotations

from dataclasses import dataclass

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.config import TrackingConfig

Pyramid = tuple[Image, ...]
"""An image and its halved versions, level by level, [height / 2^level, width / 2^level], uint8."""


@dataclass(frozen=True)
class PreparedImages:
    """A stereo pair in the form in which it is tracked; ``tracking.preparation`` makes it."""

    left: Pyramid
    """Left image minus its local mean, and the pyramid levels above it."""
    right: Pyramid
    """Right image in the same form."""
    left_spline: FloatArray
    """Coefficients of the spline of the left image minus its local mean, [height, width]."""
    right_spline: FloatArray
    """The same of the right image."""
    corners: FloatArray
    """The strongest corners of each cell of the left image, as from ``strongest_corners``."""
    left_usable: BoolArray | None
    """Where the window of a feature lies within the mask of the left image, [height, width]; None
    without a mask."""
    right_usable: BoolArray | None
    """The same for the right image."""
    config: TrackingConfig
    """The settings that the pair was prepared with."""
