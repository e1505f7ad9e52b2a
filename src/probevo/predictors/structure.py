"""Eigenvalues of the structure tensor around a feature (Shi and Tomasi 1994)."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.compiled import compiled
from probevo.predictors.base import Needs, Predictor
from probevo.predictors.patches import copy_patch, patch_start

HALF_SIZE_PX = 5
"""Windows are squares of 2 · HALF_SIZE_PX + 1 pixels, the default of tracking."""


def structure(left: Image, uv: FloatArray) -> FloatArray:
    """Compute ln(1 + λ) of both eigenvalues λ of the mean structure tensor over a window.

    The tensor is the mean of ∇I ∇Iᵀ, with central differences, over the Lucas–Kanade window around
    the feature. Divided by the variance of the grey levels, it is the information that the window
    has about its displacement (Shi, Tomasi, "Good features to track", CVPR 1994): both eigenvalues
    are small without texture, only the smaller one along an edge. The logarithm is taken because
    they span several orders of magnitude.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; windows are centred on the nearest pixel.

    Returns:
        ln(1 + λ) of the smaller and of the larger eigenvalue, [N, 2], λ in (grey levels/px)². NaN
        where the window, or the ring of one pixel around it that the gradients need, leaves the
        image.
    """
    values = np.full((len(uv), 2), np.nan)
    _fill_structure(
        np.ascontiguousarray(left), np.ascontiguousarray(uv), HALF_SIZE_PX, values=values
    )
    return values


@compiled
def _fill_structure(image: Image, uv: FloatArray, half: int, values: FloatArray) -> None:
    """Fill values, [N, 2], for the features uv, [N, 2], whose window lies in the image."""
    size = 2 * half + 1
    patch = np.empty((size + 2, size + 2), np.int32)
    for n in range(len(uv)):
        left = patch_start(uv[n, 0], half + 1, size + 2, image_px=image.shape[1])
        top = patch_start(uv[n, 1], half + 1, size + 2, image_px=image.shape[0])
        if left >= 0 and top >= 0:
            copy_patch(image, top, left, patch=patch)
            # Sum the tensor [[a, b], [b, c]] = Σ ∇I ∇Iᵀ of doubled gradients, in whole numbers
            a = b = c = 0
            for v in range(size):
                for u in range(size):
                    along_u = patch[v + 1, u + 2] - patch[v + 1, u]
                    along_v = patch[v + 2, u + 1] - patch[v, u + 1]
                    a += along_u * along_u
                    b += along_u * along_v
                    c += along_v * along_v
            smaller, larger = _eigenvalues(float(a), float(b), float(c))
            # Halve the differences, which are squared, and take the mean over the window
            scale = 1.0 / (4 * size * size)
            values[n, 0] = math.log1p(scale * smaller)
            values[n, 1] = math.log1p(scale * larger)


@compiled
def _eigenvalues(a: float, b: float, c: float) -> tuple[float, float]:
    """Return the smaller and the larger eigenvalue of [[a, b], [b, c]], positive semidefinite."""
    larger = 0.5 * (a + c) + math.hypot(0.5 * (a - c), b)
    # The determinant over the larger one, since the difference of two large numbers would leave
    # nothing of a small eigenvalue
    return max(a * c - b * b, 0.0) / larger if larger > 0.0 else 0.0, larger


STRUCTURE = Predictor(
    name="structure",
    columns={
        "structure_min": "ln(1 + (grey level/px)²)",
        "structure_max": "ln(1 + (grey level/px)²)",
    },
    source="Shi & Tomasi 1994",
    needs=Needs.LEFT,
    compute=lambda step: structure(step.left, step.uv),
    undefined="where the patch leaves the image",
)
