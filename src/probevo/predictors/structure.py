"""How well the window around a feature holds a tracker: eigenvalues of its structure tensor (Shi
and Tomasi 1994)."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.compiled import compiled
from probevo.predictors.patches import copy_patch, patch_start

HALF_SIZE_PX = 5
"""Windows are squares of 2 · this + 1 pixels, as tracking's are by default; gradients take in one
more around them."""


def structure(left: Image, uv: FloatArray) -> FloatArray:
    """ln(1 + λ) of both eigenvalues λ of the mean structure tensor over the Lucas–Kanade window
    around each feature.

    Over the noise of the grey levels, the tensor is the information that the window has about its
    displacement (Shi and Tomasi, "Good features to track", CVPR 1994): both eigenvalues are small
    where there is no texture, the smaller alone along an edge. They span several orders of
    magnitude, hence the logarithm. Gradients are central differences.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; windows are centred on the nearest pixel.

    Returns:
        Of the smaller and of the larger eigenvalue, [N, 2], λ in (grey levels/px)²; NaN where the
        window with the pixel around it leaves the image.
    """
    values = np.full((len(uv), 2), np.nan)
    _structure(np.ascontiguousarray(left), np.ascontiguousarray(uv), HALF_SIZE_PX, values=values)
    return values


@compiled
def _structure(image: Image, uv: FloatArray, half: int, values: FloatArray) -> None:
    size = 2 * half + 1
    patch = np.empty((size + 2, size + 2), np.int32)
    for n in range(len(uv)):
        left = patch_start(uv[n, 0], half + 1, size + 2, image_px=image.shape[1])
        top = patch_start(uv[n, 1], half + 1, size + 2, image_px=image.shape[0])
        if left >= 0 and top >= 0:
            copy_patch(image, top, left, patch=patch)
            a = b = c = 0  # sums over [[a, b], [b, c]]
            for v in range(size):
                for u in range(size):
                    along_u = patch[v + 1, u + 2] - patch[v + 1, u]
                    along_v = patch[v + 2, u + 1] - patch[v, u + 1]
                    a += along_u * along_u
                    b += along_u * along_v
                    c += along_v * along_v
            smaller, larger = _eigenvalues(float(a), float(b), float(c))
            scale = 1.0 / (4 * size * size)  # the mean of halved differences, squared
            values[n, 0] = math.log1p(scale * smaller)
            values[n, 1] = math.log1p(scale * larger)


@compiled
def _eigenvalues(a: float, b: float, c: float) -> tuple[float, float]:
    """The smaller and the larger eigenvalue of [[a, b], [b, c]], which is positive semidefinite."""
    larger = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    # det/larger, as the difference of two large numbers would leave nothing of a small eigenvalue
    return max(a * c - b * b, 0.0) / larger if larger > 0.0 else 0.0, larger
