"""Compiled helpers of the predictors that use an image patch: its position, and a copy of it."""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray, Image
from probevo.compiled import compiled


@compiled
def patch_start(center_px: float, before_px: int, patch_px: int, image_px: int) -> int:
    """Return the first pixel, along one axis, of the patch around a feature; −1 if it is outside.

    Args:
        center_px: feature, px; the patch is centred on the nearest pixel. A feature that is not
            finite has no patch.
        before_px: number of the patch's pixels that precede the central one.
        patch_px: size of the patch.
        image_px: size of the image.
    """
    # NaN fails both comparisons
    first = np.floor(center_px + 0.5) - before_px
    return int(first) if 0.0 <= first <= image_px - patch_px else -1


@compiled
def copy_patch(image: Image, top: int, left: int, patch: AnyArray) -> None:
    """Fill a patch, [rows, columns], with the image from (top, left) on.

    Beyond the border of the image its last pixels are repeated. Working on a small copy of a wider
    type lets the compiler vectorise the arithmetic that follows; on the image itself it does not.
    """
    height, width = image.shape
    rows, columns = patch.shape
    # Inside the image no index needs clamping, which would prevent vectorisation
    if top >= 0 and left >= 0 and top + rows <= height and left + columns <= width:
        for i in range(rows):
            for j in range(columns):
                patch[i, j] = image[top + i, left + j]
    else:
        for i in range(rows):
            row = min(max(top + i, 0), height - 1)
            for j in range(columns):
                patch[i, j] = image[row, min(max(left + j, 0), width - 1)]
