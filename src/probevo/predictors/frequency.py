"""Low and high frequencies of the patch around a feature (PROBE IV-C.5)."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.compiled import compiled
from probevo.predictors.patches import copy_patch, patch_start

BAND = 4
"""Frequencies of a band, along each axis."""
SIZE_PX = 20
"""Side of a patch; below 12 the bands would overlap."""


def frequency(left: Image, uv: FloatArray) -> FloatArray:
    """Low- and high-frequency coefficient of the patch around each feature: the mean of ln(1 + |F|)
    over each band.

    F is the patch's two-dimensional Fourier transform, unitary and unshifted. The low band is the
    frequencies 0 … 3 along each axis but for F₀₀: brightness is no texture. The high band is the
    four around Nyquist, ``SIZE_PX`` // 2 − 2 … + 1. PROBE does not define the two. Its own
    experiments took the low one alike, with F₀₀; their high one, from the end of an unshifted
    spectrum, was the mirrored low one.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; patches are centred on the nearest pixel, which of an even number
            of pixels is the first of the second half.

    Returns:
        Low and high, [N, 2], |F| in grey levels; NaN where the patch leaves the image.
    """
    values = np.full((len(uv), 2), np.nan)
    _frequency(np.ascontiguousarray(left), np.ascontiguousarray(uv), _waves(), values=values)
    return values


def _waves() -> FloatArray:
    """Cosines, then sines, of the low frequencies, then of the high ones, [4 · BAND, SIZE_PX],
    unitary."""
    low = np.arange(BAND)
    high = SIZE_PX // 2 + np.arange(BAND) - BAND // 2
    cycles = np.stack([low, high])[:, :, None] * np.arange(SIZE_PX) % SIZE_PX
    angle = 2.0 * np.pi / SIZE_PX * cycles
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=1) / math.sqrt(SIZE_PX)
    return waves.reshape(4 * BAND, SIZE_PX)


@compiled
def _frequency(image: Image, uv: FloatArray, waves: FloatArray, values: FloatArray) -> None:
    count, size = waves.shape
    patch = np.empty((size, size))
    along_u = np.empty((size, count))
    spectrum = np.empty((count, count))
    waves_u = np.ascontiguousarray(waves.T)
    for n in range(len(uv)):
        left = patch_start(uv[n, 0], size // 2, size, image_px=image.shape[1])
        top = patch_start(uv[n, 1], size // 2, size, image_px=image.shape[0])
        if left >= 0 and top >= 0:
            copy_patch(image, top, left, patch=patch)
            np.dot(patch, waves_u, along_u)
            np.dot(waves, along_u, spectrum)
            spectrum[0, 0] = 0.0  # brightness
            values[n, 0] = _log_sum(spectrum, 0) / (BAND * BAND - 1)
            values[n, 1] = _log_sum(spectrum, 2 * BAND) / (BAND * BAND)


@compiled
def _log_sum(spectrum: FloatArray, first: int) -> float:
    """Sum of ln(1 + |F|) over the band whose waves begin there: one logarithm, of a product that
    stays far from ∞."""
    product = 1.0
    for k in range(first, first + BAND):
        for j in range(first, first + BAND):
            real = spectrum[k, j] - spectrum[k + BAND, j + BAND]
            imaginary = spectrum[k, j + BAND] + spectrum[k + BAND, j]
            product *= 1.0 + math.sqrt(real * real + imaginary * imaginary)
    return math.log(product)
