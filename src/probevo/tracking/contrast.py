"""Compensation of other exposures: the contrast of one image is adapted to another image.

Lucas–Kanade assumes that a point looks the same in both images. The high-pass filter removes an
offset of the grey levels, but not a gain. After an exposure jump, or where both cameras are exposed
differently, even correct tracks would therefore differ by more than the threshold that rejects
wrong ones.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray
from probevo.sequences.prepared_images import Pyramid

MIN_GAIN = 1.25
"""Ratio of the contrasts that counts as an exposure jump. Without one, it is at most 1.11 from
frame to frame on KITTI, Karlsruhe and EuRoC."""
MIN_GAIN_IN_STEREO = 1.15
"""Ratio of the contrasts that counts as different exposures of the two cameras. With equal ones,
what only one of them sees makes it at most 1.12 on KITTI, Karlsruhe and EuRoC."""
CELL_PX = 64
"""Side of a cell whose contrast is compared, px: larger than most disparities and motions."""
MIN_CELL_PX = 4
"""Smallest side of a cell in the coarsest level of a pyramid, px."""
MAX_GAIN = 8.0
"""Largest gain; beyond it, one of the two images is practically black or white."""


def with_contrast_of(template: Pyramid, image: Pyramid, *, least_gain: float = MIN_GAIN) -> Pyramid:
    """Return the template with mean and contrast of the image.

    It is returned unchanged if it is empty, or if the ratio of the contrasts is not between
    ``least_gain`` and MAX_GAIN.

    Args:
        template: pyramid of the image that is adapted.
        image: pyramid of the image that it is adapted to.
        least_gain: ratio of the contrasts, above 1, that counts as another exposure.
    """
    if not template:
        return template
    image_cells = _cells(image)
    template_cells = _cells(template)
    gain = _gain(template_cells, image_cells)
    if not least_gain < symmetric_gain(gain) < MAX_GAIN:
        return template
    offset = float(np.median(image_cells.mean - gain * template_cells.mean))
    return tuple(
        np.asarray(cv2.addWeighted(level, gain, level, 0.0, offset), dtype=np.uint8)
        for level in template
    )


def symmetric_gain(gain: float) -> float:
    """Return the larger one of a gain and its inverse."""
    return max(gain, 1.0 / max(gain, 1e-9))


def contrast_ratio(template: Pyramid, image: Pyramid) -> float:
    """Return the contrast of the image over the template's; NaN if one of them has none."""
    return _gain(_cells(template), _cells(image))


class _Cells(NamedTuple):
    """Grey levels of an image, cell by cell."""

    mean: FloatArray
    """Mean grey level of each cell, [N]."""
    contrast: FloatArray
    """Standard deviation of the grey levels in each cell, [N]."""


def _cells(pyramid: Pyramid) -> _Cells:
    """Divide the coarsest level into cells of ``CELL_PX``, without the rest at its border."""
    level = pyramid[-1]
    height, width = level.shape
    side = max(CELL_PX >> (len(pyramid) - 1), MIN_CELL_PX)
    rows = max(height // side, 1)
    columns = max(width // side, 1)
    inside = level[: rows * (height // rows), : columns * (width // columns)].astype(np.float32)
    mean = _mean_of_cells(inside, columns, rows)
    mean_square = _mean_of_cells(inside * inside, columns, rows)
    return _Cells(mean, np.sqrt(np.maximum(mean_square - mean * mean, 0.0)))


def _mean_of_cells(values: NDArray[np.float32], columns: int, rows: int) -> FloatArray:
    """Return the mean of an image over each cell, [columns rows]."""
    # INTER_AREA with whole factors is the mean over a cell.
    means = cv2.resize(values, (columns, rows), interpolation=cv2.INTER_AREA)
    return means.ravel().astype(np.float64)


def _gain(template: _Cells, image: _Cells) -> float:
    """Return the median ratio of the contrasts of two images; NaN if they have none in common.

    A cell counts by its contrast in both. What covers a part of one of them, such as a finger, dirt
    or a thing nearby, changes the contrast of the whole image, but is no exposure.
    """
    weight = np.sqrt(template.contrast * image.contrast)
    seen = np.flatnonzero(weight)
    if not len(seen):
        return math.nan
    ratio = image.contrast[seen] / template.contrast[seen]
    ascending = np.argsort(ratio)
    cumulated = np.cumsum(weight[seen][ascending])
    middle = int(np.searchsorted(cumulated, 0.5 * cumulated[-1]))
    return float(ratio[ascending][middle])
