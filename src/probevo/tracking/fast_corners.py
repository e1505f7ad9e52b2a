"""FAST corners, only the strongest of each grid cell (Rosten and Drummond 2006).

They are the corners of OpenCV (cv2.FastFeatureDetector with non-maximum suppression, type 9-16), as
a test checks. OpenCV makes a Python object of each of ten thousand corners, which blocks all other
threads, where six hundred are wanted.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.tracking.fast_corners_numba import REACH_PX, FlatImage, Strongest, fill_strongest

HALF_RING = ((0, 3), (1, 3), (2, 2), (3, 1), (3, 0), (3, -1), (2, -2), (1, -3))
RING = HALF_RING + tuple((-du, -dv) for du, dv in HALF_RING)
"""(du, dv) of the 16 pixels on the ring around a corner, in order."""


class CornerGrid(NamedTuple):
    """Square cells that cover an image."""

    cell_px: float
    """Side of a cell, px."""
    rows: int
    columns: int


def strongest_of_cells(
    image: Image,
    grid: CornerGrid,
    *,
    threshold: int,
    per_cell: int,
    border_px: int,
    usable: BoolArray | None = None,
) -> FloatArray:
    """Detect the strongest FAST corners of each cell.

    A corner is brighter, or darker, than nine consecutive pixels of the ring around it by more than
    a threshold. The largest such threshold is its strength, and no neighbour may be as strong
    (Rosten, Drummond, "Machine learning for high-speed corner detection", ECCV 2006).

    Args:
        image: [height, width], uint8.
        grid: the cells.
        threshold: difference that makes a corner, grey levels.
        per_cell: number of corners wanted in each cell.
        border_px: least distance of a corner from the border, at least REACH_PX + 1.
        usable: where corners may be, [height, width]; None for everywhere.

    Returns:
        (u, v) of the corners, [rows, columns, per_cell, 2], px, the strongest first, of equal ones
        the upper and left one first; NaN where a cell has no more.
    """
    height, width = image.shape
    shape = (grid.rows, grid.columns, per_cell)
    strongest = Strongest(strength=np.zeros(shape, np.int64), flat_index=np.full(shape, -1))
    if min(height, width) > 2 * border_px:
        # Two stages: a cheap bound of each pixel's strength, then the strength itself where the
        # bound does not rule the pixel out. Pixels that are not usable get the bound of no corner.
        bound = _strength_bound(image)
        if usable is not None:
            bound[~usable[REACH_PX:-REACH_PX, REACH_PX:-REACH_PX]] = 0
        flat_image = FlatImage(
            pixels=np.ascontiguousarray(image).ravel(),
            width=width,
            bound=bound,
            ring_offsets=np.array([dv * width + du for du, dv in RING]),
            ring=np.zeros(len(RING) + 8, np.int32),
        )
        fill_strongest(flat_image, grid.cell_px, threshold, border_px, strongest)
    u = strongest.flat_index % width
    v = strongest.flat_index // width
    is_missing = strongest.flat_index[..., None] < 0
    corners: FloatArray = np.where(is_missing, np.nan, np.stack([u, v], axis=-1))
    return corners


def _strength_bound(image: Image) -> Image:
    """Compute an upper bound of the strength of each pixel REACH_PX from the border.

    Nine consecutive pixels of the ring of sixteen contain one of each two that face each other.
    With every second pair, the bound lets more pixels through than with all eight, but takes half
    the time; together that is faster.

    Returns:
        [height − 6, width − 6], uint8.
    """
    height, width = image.shape

    def shifted(du: int, dv: int) -> Image:
        """View the pixels at (du, dv) from each that is not at the border."""
        return image[REACH_PX + dv : height - REACH_PX + dv, REACH_PX + du : width - REACH_PX + du]

    center = shifted(0, 0)
    brighter = np.full(center.shape, 255, np.uint8)
    darker = np.zeros(center.shape, np.uint8)
    extreme_of_pair = np.empty_like(brighter)
    # At least the larger (smaller) pixel of each facing pair must differ by the strength.
    for du, dv in HALF_RING[::2]:
        pixel = shifted(du, dv)
        facing = shifted(-du, -dv)
        cv2.min(brighter, cv2.max(pixel, facing, dst=extreme_of_pair), dst=brighter)
        cv2.max(darker, cv2.min(pixel, facing, dst=extreme_of_pair), dst=darker)
    # How much the nine are brighter, or darker, than the centre; negative bytes become 0.
    cv2.subtract(brighter, center, dst=brighter)
    cv2.subtract(center, darker, dst=darker)
    return np.asarray(cv2.max(brighter, darker, dst=extreme_of_pair), dtype=np.uint8)
