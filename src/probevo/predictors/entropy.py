"""Entropy of the grey levels around a feature (PROBE IV-C.2)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.compiled import compiled
from probevo.predictors.base import Needs, Predictor
from probevo.predictors.patches import patch_start

BINS = 256
"""One bin for each grey level."""
HALF_SIZE_PX = 10
"""Patches are squares of 2 · HALF_SIZE_PX + 1 pixels."""


def entropy(left: Image, uv: FloatArray) -> FloatArray:
    """Compute the entropy −Σ c_i log₂ c_i of the patch around each feature (PROBE eq. 16).

    c_i is the share of the patch's pixels that have grey level i. The paper prints the number of
    pixels instead, but such a sum is no entropy: it is negative and grows with the patch. For
    patches of one size it is a linear map of this one.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; patches are centred on the nearest pixel.

    Returns:
        [N], bits, 0 (constant) … 8 (all grey levels equally frequent); NaN where the patch leaves
        the image.
    """
    # The term −c log₂ c for every number of pixels that a bin can hold, so that no logarithm is
    # needed for a feature
    num_pixels = (2 * HALF_SIZE_PX + 1) ** 2
    share = np.arange(1, num_pixels + 1) / num_pixels
    terms = np.concatenate([[0.0], -share * np.log2(share)])
    values = np.full(len(uv), np.nan)
    _fill_entropy(
        np.ascontiguousarray(left),
        np.ascontiguousarray(uv),
        HALF_SIZE_PX,
        terms=terms,
        values=values,
    )
    return values


@compiled
def _fill_entropy(
    image: Image, uv: FloatArray, half: int, terms: FloatArray, values: FloatArray
) -> None:
    """Sum the terms of all bins, for the features uv, [N, 2], whose patch lies in the image."""
    size = 2 * half + 1
    counts = np.zeros(BINS, np.int32)
    for n in range(len(uv)):
        left = patch_start(uv[n, 0], half, size, image_px=image.shape[1])
        top = patch_start(uv[n, 1], half, size, image_px=image.shape[0])
        if left >= 0 and top >= 0:
            # Histogram of the patch
            for v in range(top, top + size):
                for u in range(left, left + size):
                    counts[image[v, u]] += 1
            # Sum over the bins, which are emptied for the next feature
            total = 0.0
            for level in range(BINS):
                total += terms[counts[level]]
                counts[level] = 0
            values[n] = total


ENTROPY = Predictor(
    name="entropy",
    columns={"entropy": "bit"},
    source="PROBE eq. (16)",
    needs=Needs.LEFT,
    compute=lambda step: entropy(step.left, step.uv),
    undefined="where the patch leaves the image",
)
