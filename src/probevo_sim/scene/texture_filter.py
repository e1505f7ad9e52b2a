"""The mean of a texture over the footprint of a ray."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import IntArray
from probevo.compiled import compiled
from probevo_sim.scene.textures import SIZE

MAX_TAPS = 8
"""Samples along the longer side of a footprint; one longer than so many times its shorter side is
blurred."""
LEVELS = SIZE.bit_length()

Texels = NDArray[np.uint8]


@compiled
def sample(
    texels: Texels,
    layer: int,
    level_start: IntArray,
    a: float,
    b: float,
    au: float,
    av: float,
    bu: float,
    bv: float,
) -> float:
    """Mean of a texture, from -1 to 1, over the footprint around (a, b) that (au, bu) and (av, bv)
    span, texels.

    Along its longer side the footprint is sampled several times; the levels of the pyramid do the
    rest.

    Args:
        texels: pyramids of all textures, [L, M].
        layer: which of them.
        level_start: where each of its levels begins.
        a, b, au, av, bu, bv: of the finest level.
    """
    across_2 = au * au + bu * bu
    along_2 = av * av + bv * bv
    long_a = av
    long_b = bv
    if across_2 > along_2:
        across_2, along_2, long_a, long_b = along_2, across_2, au, bu
    across_2 = max(across_2, 1.0)
    along_2 = max(along_2, 1.0)
    taps = min(math.ceil(math.sqrt(along_2 / across_2)), MAX_TAPS)
    level, blend = _level(math.sqrt(max(along_2 / (taps * taps), across_2)))
    total = 0.0
    for k in range(taps):
        offset = (k + 0.5) / taps - 0.5
        at_a = a + offset * long_a
        at_b = b + offset * long_b
        fine = _texel(texels, layer, level_start[level], level=level, a=at_a, b=at_b)
        total += fine + blend * (
            _texel(texels, layer, level_start[level + 1], level=level + 1, a=at_a, b=at_b) - fine
        )
    return total / (127.5 * taps) - 1.0


@compiled
def sample_square(
    texels: Texels, layer: int, level_start: IntArray, a: float, b: float, side: float
) -> float:
    """The same over a square footprint, with a single sample."""
    level, blend = _level(max(side, 1.0))
    fine = _texel(texels, layer, level_start[level], level=level, a=a, b=b)
    coarse = _texel(texels, layer, level_start[level + 1], level=level + 1, a=a, b=b)
    return (fine + blend * (coarse - fine)) / 127.5 - 1.0


@compiled
def _level(texels: float) -> tuple[int, float]:
    """The level whose texels are up to so many of the finest wide, and how far to blend into the
    next one."""
    mantissa, exponent = math.frexp(texels)
    if exponent > LEVELS - 1:
        return LEVELS - 2, 1.0
    return exponent - 1, 2.0 * mantissa - 1.0


@compiled
def _texel(texels: Texels, layer: int, start: int, level: int, a: float, b: float) -> float:
    """Bilinear sample of one level, 0 … 255; the texel of index i is centred on i + ½."""
    size = SIZE >> level
    scale = 1.0 / (1 << level)
    a = a * scale - 0.5
    b = b * scale - 0.5
    left = math.floor(a)
    low = math.floor(b)
    share_a = a - left
    share_b = b - low
    column = int(left) & (size - 1)
    row = int(low) & (size - 1)
    right = (column + 1) & (size - 1)
    high = (row + 1) & (size - 1)
    low_row = start + row * size
    high_row = start + high * size
    low_left = np.float64(texels[layer, low_row + column])
    low_right = np.float64(texels[layer, low_row + right])
    high_left = np.float64(texels[layer, high_row + column])
    high_right = np.float64(texels[layer, high_row + right])
    lower = low_left + share_a * (low_right - low_left)
    upper = high_left + share_a * (high_right - high_left)
    return lower + share_b * (upper - lower)
