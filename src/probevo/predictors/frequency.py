"""Low and high spatial frequencies of the patch around a feature (PROBE IV-C.5)."""

from __future__ import annotations

import math
from functools import cache

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.compiled import compiled
from probevo.predictors.base import Needs, Predictor
from probevo.predictors.patches import copy_patch, patch_start

BAND = 4
"""Number of frequencies of a band, along each axis."""
SIZE_PX = 20
"""Side of a patch; below 12 px the bands would overlap."""


def frequency(left: Image, uv: FloatArray) -> FloatArray:
    """Compute the mean of ln(1 + |F|) over a low and a high band of the patch's Fourier transform.

    F is the two-dimensional Fourier transform of the patch around a feature, unitary and unshifted.
    The low band has the frequencies 0 … 3 along each axis except F₀₀, since brightness is no
    texture. The high band has the four around Nyquist, ``SIZE_PX`` // 2 − 2 … + 1.

    PROBE does not define the bands. Its own code took the low one in the same way, with F₀₀; its
    high band, from the end of an unshifted spectrum, was the mirrored low one.

    Args:
        left: image, [height, width], uint8.
        uv: features, [N, 2], px; the pixel nearest to the feature is the first of the second half
            of the patch, along each axis.

    Returns:
        Low and high, [N, 2], ln(1 + grey levels); NaN where the patch leaves the image.
    """
    values = np.full((len(uv), 2), np.nan)
    _fill_frequency(np.ascontiguousarray(left), np.ascontiguousarray(uv), _waves(), values=values)
    return values


@cache
def _waves() -> FloatArray:
    """Return the cosines, then the sines, of the low, then of the high band.

    Returns:
        [4 · BAND, SIZE_PX], scaled such that the transform is unitary.
    """
    # Numbers of cycles in the patch; a multiple of the side is a full turn, taken off to keep the
    # angles small
    low = np.arange(BAND)
    high = SIZE_PX // 2 + np.arange(BAND) - BAND // 2
    cycles = np.stack([low, high])[:, :, None] * np.arange(SIZE_PX) % SIZE_PX
    angle = 2.0 * np.pi / SIZE_PX * cycles
    waves = np.stack([np.cos(angle), np.sin(angle)], axis=1) / math.sqrt(SIZE_PX)
    return waves.reshape(4 * BAND, SIZE_PX)


@compiled
def _fill_frequency(image: Image, uv: FloatArray, waves: FloatArray, values: FloatArray) -> None:
    """Fill values, [N, 2], for the features uv, [N, 2], whose patch lies in the image."""
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
            # Transform along u, then along v, at the frequencies of the two bands only
            np.dot(patch, waves_u, along_u)
            np.dot(waves, along_u, spectrum)
            # The rows and columns of ``spectrum`` follow ``waves``: cos low, sin low, cos high, sin
            # high. The real part of F₀₀ is [0, 0]; the other three parts have a sine of zero.
            spectrum[0, 0] = 0.0  # brightness is no texture
            values[n, 0] = _log_sum(spectrum, 0) / (BAND * BAND - 1)
            values[n, 1] = _log_sum(spectrum, 2 * BAND) / (BAND * BAND)


@compiled
def _log_sum(spectrum: FloatArray, first: int) -> float:
    """Sum ln(1 + |F|) over the band whose waves begin at index ``first``.

    This is one logarithm of the product, which stays far from overflow.
    """
    product = 1.0
    for k in range(first, first + BAND):
        for j in range(first, first + BAND):
            # cos·cos − sin·sin and cos·sin + sin·cos: the transform of a real patch
            real = spectrum[k, j] - spectrum[k + BAND, j + BAND]
            imaginary = spectrum[k, j + BAND] + spectrum[k + BAND, j]
            product *= 1.0 + math.sqrt(real * real + imaginary * imaginary)
    return math.log(product)


FREQUENCY = Predictor(
    name="frequency",
    columns={"low_frequency": "ln(1 + grey levels)", "high_frequency": "ln(1 + grey levels)"},
    source="PROBE IV-C.5",
    needs=Needs.LEFT,
    compute=lambda step: frequency(step.left, step.uv),
    undefined="where the patch leaves the image",
)
