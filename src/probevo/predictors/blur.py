"""Blur of the patch around a feature (Crete et al. 2007; PROBE IV-C.3)."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray, Image, IntArray

TAPS = 9
"""Of the box that blurs the image once more."""


def blur(left: Image, uv: FloatArray, *, half_size_px: int = 10) -> FloatArray:
    """No-reference perceptual blur of the patch around each feature.

    Blurring a sharp image changes how neighbouring pixels differ, blurring a blurred one hardly does. Along each axis
    the metric is the share of the differences between neighbours that a 9-tap box along that axis leaves; the patch
    is as blurred as along its worse axis. An axis along which the patch is constant does not count, and a patch that is
    constant altogether is blurred. The box takes in what lies around the patch; the image goes on beyond its border
    as it is there.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; patches are centred on the nearest pixel.
        half_size_px: patches are squares of 2 · this + 1 pixels.

    Returns:
        [N], 0 (sharp) … 1 (blurred); NaN where the patch leaves the image.
    """
    center = np.floor(np.where(np.isfinite(uv), uv, -1e6) + 0.5)
    top_left = np.clip(center - half_size_px, -1, 1e6).astype(np.int64)
    size_px = np.array(left.shape[::-1])
    inside = np.all((top_left >= 0) & (top_left + 2 * half_size_px < size_px), axis=1)
    values = np.full(len(uv), np.nan)
    if inside.any():
        corner, patch_px = top_left[inside], 2 * half_size_px + 1
        values[inside] = _worse(_kept(left, corner, patch_px), _kept(left.T, corner[:, ::-1], patch_px))
    return values


def _worse(along_u: FloatArray, along_v: FloatArray) -> FloatArray:
    """The larger of two shares, of those that are defined; 1 where neither is."""
    worse: FloatArray = np.fmax(along_u, along_v)
    return np.where(np.isnan(worse), 1.0, worse)


def _kept(image: Image, corner: IntArray, patch_px: int) -> FloatArray:
    """Share of the differences along the rows that a box along the rows leaves; NaN where there are none.

    Args:
        image: [height, width].
        corner: (column, row) of the first pixel of each patch, [N, 2], all within the image.
        patch_px: side of a patch.
    """
    image = np.ascontiguousarray(image)
    box = cv2.blur(image.astype(np.float32) * TAPS, (TAPS, 1), borderType=cv2.BORDER_REPLICATE)
    before = TAPS * cv2.absdiff(image[:, 1:], image[:, :-1]).astype(np.float32)
    after = np.abs(np.rint(box[:, 1:]) - np.rint(box[:, :-1]))  # sums of grey levels, and so whole numbers
    lost = np.maximum(before - after, 0.0)
    total, lost_total = (_patch_sums(part, corner, patch_px - 1, patch_px) for part in (before, lost))
    return 1.0 - lost_total / np.where(total > 0.0, total, np.nan)


def _patch_sums(values: NDArray[np.float32], corner: IntArray, width: int, height: int) -> FloatArray:
    """Sum over the rectangle at each corner (column, row), [N]."""
    sums = cv2.integral(values, sdepth=cv2.CV_64F)
    (left, top), (right, bottom) = corner.T, (corner + np.array([width, height])).T
    total: FloatArray = sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left]
    return total
