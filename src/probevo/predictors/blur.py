"""Blur of the patch around a feature (Crete et al. 2007; PROBE IV-C.3)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray, FloatArray, Image
from probevo.compiled import compiled
from probevo.predictors.patches import copy_patch, patch_start

TAPS = 9
"""Of the box that blurs the image once more."""
REACH = TAPS // 2
HALF_SIZE_PX = 10
"""Patches are squares of 2 · this + 1 pixels."""


def blur(left: Image, uv: FloatArray) -> FloatArray:
    """No-reference perceptual blur of the patch around each feature.

    Blurring a sharp image changes how neighbouring pixels differ, blurring a blurred one hardly
    does. Along each axis the metric is the share of the differences between neighbours that a 9-tap
    box along that axis leaves; the patch is as blurred as along its worse axis. An axis along which
    the patch is constant does not count, and a patch that is constant altogether is blurred. The
    box takes in what lies around the patch; the image goes on beyond its border as it is there.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; patches are centred on the nearest pixel.

    Returns:
        [N], 0 (sharp) … 1 (blurred); NaN where the patch leaves the image.
    """
    values = np.full(len(uv), np.nan)
    _blur(np.ascontiguousarray(left), np.ascontiguousarray(uv), HALF_SIZE_PX, values=values)
    return values


@compiled
def _blur(image: Image, uv: FloatArray, half: int, values: FloatArray) -> None:
    size = 2 * half + 1
    patch = np.empty(
        (size + 2 * REACH, size + 2 * REACH), np.int32
    )  # with all that the boxes take in
    turned = np.empty_like(patch)
    for n in range(len(uv)):
        left = patch_start(uv[n, 0], half, size, image_px=image.shape[1])
        top = patch_start(uv[n, 1], half, size, image_px=image.shape[0])
        if left >= 0 and top >= 0:
            copy_patch(image, top - REACH, left - REACH, patch=patch)
            for row in range(
                len(patch)
            ):  # no slice as target: that alone would take Numba 3 s to compile
                for column in range(len(patch)):
                    turned[row, column] = patch[column, row]
            kept = max(_kept_along_rows(patch), _kept_along_rows(turned))
            values[n] = kept if kept >= 0.0 else 1.0


@compiled
def _kept_along_rows(patch: AnyArray) -> float:
    """Share of the differences along the rows that a box along the rows leaves; −1 where there are
    none.

    Two neighbouring boxes differ by the pixel that only the one has, at its end, and the one that
    only the other has.
    """
    size = len(patch) - 2 * REACH
    total = lost = 0
    for v in range(size):
        for u in range(size - 1):
            before = TAPS * abs(patch[v + REACH, u + REACH + 1] - patch[v + REACH, u + REACH])
            after = abs(patch[v + REACH, u + TAPS] - patch[v + REACH, u])
            total += before
            lost += max(before - after, 0)
    return 1.0 - lost / total if total > 0 else -1.0
