"""Entropy of the grey levels around a feature (PROBE IV-C.2)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.compiled import compiled
from probevo.predictors.patches import patch_start

BINS = 256
"""One a grey level."""
HALF_SIZE_PX = 10
"""Patches are squares of 2 · this + 1 pixels."""


def entropy(left: Image, uv: FloatArray) -> FloatArray:
    """Entropy of the grey levels of the patch around each feature: −Σ c_i log₂ c_i, PROBE eq. (16).

    c_i is the share of the patch's pixels that have grey level i. PROBE prints their number, but
    the sum over numbers is no entropy: it is negative and grows with the patch. For patches of one
    size it is a linear map of this one.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; patches are centred on the nearest pixel.

    Returns:
        [N], bits, 0 (constant) … 8 (all grey levels alike); NaN where the patch leaves the image.
    """
    values = np.full(len(uv), np.nan)
    share = np.arange(1, (2 * HALF_SIZE_PX + 1) ** 2 + 1) / (2 * HALF_SIZE_PX + 1) ** 2
    terms = np.concatenate([[0.0], -share * np.log2(share)])
    _entropy(
        np.ascontiguousarray(left),
        np.ascontiguousarray(uv),
        HALF_SIZE_PX,
        terms=terms,
        values=values,
    )
    return values


@compiled
def _entropy(
    image: Image, uv: FloatArray, half: int, terms: FloatArray, values: FloatArray
) -> None:
    """Sum the terms −c log₂ c, given for every number of pixels in a bin, over the bins."""
    size = 2 * half + 1
    counts = np.zeros(BINS, np.int32)
    for n in range(len(uv)):
        left = patch_start(uv[n, 0], half, size, image_px=image.shape[1])
        top = patch_start(uv[n, 1], half, size, image_px=image.shape[0])
        if left >= 0 and top >= 0:
            for v in range(top, top + size):
                for u in range(left, left + size):
                    counts[image[v, u]] += 1
            total = 0.0
            for level in range(BINS):
                total += terms[counts[level]]
                counts[level] = 0
            values[n] = total
