"""The range of gray values of a 16-bit recording, and its reduction to 8 bits.

Everything downstream works on 8 bits. The range is taken from frames all over the recording, the
first of which may be dark, and then fixed: a range of each frame would change the brightness of a
point from frame to frame, which the tracker assumes to be constant.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from probevo.arrays import AnyArray, Image

NUM_FRAMES = 9
"""Frames whose gray values set the range."""
LOW_PERCENT = 0.5
HIGH_PERCENT = 99.5
"""Percentiles of the gray values that become 0 and 255: hot pixels and the sun are left out."""


def spread_indices(count: int) -> list[int]:
    """Return the indices of up to ``NUM_FRAMES`` of ``count`` images: the first, the last, and
    those evenly between them."""
    spread = np.linspace(0, count - 1, NUM_FRAMES).round().astype(int)
    return [int(index) for index in np.unique(spread)]


@dataclass(frozen=True)
class GrayRange:
    """The 16-bit values that become 0 and 255 in 8 bits."""

    low: int
    high: int
    """More than ``low``."""

    @staticmethod
    def of(images: Sequence[AnyArray]) -> GrayRange:
        """Return the range of some 16-bit images, left and right together.

        Both cameras get the same range, so that a point keeps its brightness from left to right.
        """
        values = np.concatenate([np.ravel(image) for image in images])
        low, high = np.percentile(values, [LOW_PERCENT, HIGH_PERCENT])
        # An 8-bit range at least: a wall of one colour must not become amplified noise.
        return GrayRange(low=int(low), high=max(int(np.ceil(high)), int(low) + 255))

    def to_8_bits(self, image: AnyArray) -> Image:
        """Return a 16-bit image, [height, width], with values outside the range clipped."""
        above_low = cv2.subtract(image, np.full_like(image, self.low))  # clips at zero
        scaled = cv2.convertScaleAbs(above_low, alpha=255.0 / (self.high - self.low))
        return np.asarray(scaled, dtype=np.uint8)


def common_range(images: Iterable[AnyArray]) -> GrayRange | None:
    """Return the range of some images of a recording; None if one of them has 8 bits."""
    deep = []
    for image in images:
        if image.dtype != np.uint16:
            return None
        deep.append(image)
    return GrayRange.of(deep) if deep else None
