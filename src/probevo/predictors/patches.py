"""Where the patch around a feature begins, and a copy of it to work on."""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray, Image
from probevo.compiled import compiled


@compiled
def patch_start(center_px: float, before_px: int, patch_px: int, image_px: int) -> int:
    """First pixel, along one axis, of the patch around a feature; −1 where it leaves the image.

    Args:
        center_px: feature, px; the patch is centred on the nearest pixel. If not finite, the patch
            is nowhere.
        before_px: pixels of the patch before that one.
        patch_px: all pixels of the patch.
        image_px: those of the image.
    """
    first = np.floor(center_px + 0.5) - before_px
    return int(first) if 0.0 <= first <= image_px - patch_px else -1


@compiled
def copy_patch(image: Image, top: int, left: int, patch: AnyArray) -> None:
    """Fill a patch, [rows, columns], with the image from (top, left) on; it goes on beyond its
    border as it is there.

    The arithmetic that follows on a small copy of a wider type is vectorised; on the image itself
    it would not be.
    """
    height, width = image.shape
    rows, columns = patch.shape
    if top >= 0 and left >= 0 and top + rows <= height and left + columns <= width:
        for i in range(rows):
            for j in range(columns):
                patch[i, j] = image[top + i, left + j]
    else:
        for i in range(rows):
            row = min(max(top + i, 0), height - 1)
            for j in range(columns):
                patch[i, j] = image[row, min(max(left + j, 0), width - 1)]
