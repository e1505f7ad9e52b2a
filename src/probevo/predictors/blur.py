"""Blur of the patch around a feature (Crete et al. 2007; PROBE IV-C.3)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import AnyArray, FloatArray, Image
from probevo.compiled import compiled
from probevo.predictors.base import Needs, Predictor
from probevo.predictors.patches import copy_patch, patch_start

TAPS = 9
"""Length of the box filter that blurs the image once more, px."""
REACH = TAPS // 2
"""Half length of the box filter, px."""
HALF_SIZE_PX = 10
"""Patches are squares of 2 · HALF_SIZE_PX + 1 pixels."""


def blur(left: Image, uv: FloatArray) -> FloatArray:
    """Compute the no-reference perceptual blur of the patch around each feature.

    Blurring a sharp image changes how neighbouring pixels differ; blurring a blurred one hardly
    does. Along each axis the metric is the share of the differences between neighbours that a 9-tap
    box filter along that axis leaves, and the blur of the patch is the larger of the two shares. An
    axis along which the patch is constant does not count, and a patch that is constant altogether
    is blurred. The filter also takes in pixels around the patch; beyond the border of the image
    the last pixels are repeated.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; patches are centred on the nearest pixel.

    Returns:
        [N], 0 (sharp) … 1 (blurred); NaN where the patch leaves the image.
    """
    values = np.full(len(uv), np.nan)
    _fill_blur(np.ascontiguousarray(left), np.ascontiguousarray(uv), HALF_SIZE_PX, values=values)
    return values


@compiled
def _fill_blur(image: Image, uv: FloatArray, half: int, values: FloatArray) -> None:
    """Fill values, [N], for the features uv, [N, 2], whose patch lies in the image."""
    size = 2 * half + 1
    # The patch with all pixels around it that the box filter takes in
    patch = np.empty((size + 2 * REACH, size + 2 * REACH), np.int32)
    transposed = np.empty_like(patch)
    for n in range(len(uv)):
        left = patch_start(uv[n, 0], half, size, image_px=image.shape[1])
        top = patch_start(uv[n, 1], half, size, image_px=image.shape[0])
        if left >= 0 and top >= 0:
            copy_patch(image, top - REACH, left - REACH, patch=patch)
            # Assigning to a slice instead would take Numba 3 s to compile
            for row in range(len(patch)):
                for column in range(len(patch)):
                    transposed[row, column] = patch[column, row]
            # The columns of an image are the rows of its transpose
            share = max(_share_kept_along_rows(patch), _share_kept_along_rows(transposed))
            values[n] = share if share >= 0.0 else 1.0


@compiled
def _share_kept_along_rows(patch: AnyArray) -> float:
    """Return the share of the differences along rows that the box filter leaves; −1 without any.

    Two neighbouring boxes differ by one pixel at each end only.
    """
    size = len(patch) - 2 * REACH
    total = lost = 0
    for v in range(size):
        for u in range(size - 1):
            # Difference of two neighbours, before and after the filter, both times TAPS
            sharp = TAPS * abs(patch[v + REACH, u + REACH + 1] - patch[v + REACH, u + REACH])
            blurred = abs(patch[v + REACH, u + TAPS] - patch[v + REACH, u])
            # The metric is 1 − Σ max(sharp − blurred, 0)/Σ sharp
            total += sharp
            lost += max(sharp - blurred, 0)
    return 1.0 - lost / total if total > 0 else -1.0


BLUR = Predictor(
    name="blur",
    columns={"blur": "0 sharp … 1 blurred"},
    source="PROBE IV-C.3; Crete et al. 2007",
    needs=Needs.LEFT,
    compute=lambda step: blur(step.left, step.uv),
    undefined="where the patch leaves the image",
)
