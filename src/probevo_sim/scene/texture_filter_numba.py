"""Texture filtering: the mean of a texture over the footprint of a ray, as compiled loops.

Trilinear samples between two mip levels are averaged along the longer side of the footprint
(anisotropic filtering), so that surfaces seen at a slant are neither blurred nor aliased.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.compiled import compiled
from probevo_sim.scene.textures import SIZE, Mipmaps

MAX_TAPS = 8
"""Largest number of samples along the longer side of a footprint.

A footprint that is more than so many times as long as wide is blurred across.
"""
LEVELS = SIZE.bit_length()
"""Number of mip levels of a texture."""


class Footprint(NamedTuple):
    """The parallelogram on a texture that one ray sees, in texels of mip level 0.

    Texture coordinates are (a, b); image coordinates are (u, v). The sides of the parallelogram are
    the derivatives of the texture coordinates by the image coordinates times the ray's size.
    """

    a: float
    """Centre, first texture coordinate."""
    b: float
    """Centre, second texture coordinate."""
    a_by_u: float
    a_by_v: float
    b_by_u: float
    b_by_v: float


@compiled
def sample(mipmaps: Mipmaps, layer: int, footprint: Footprint) -> float:
    """Return the mean of texture ``layer`` over a footprint, from −1 to 1."""
    # Squared lengths of the two sides of the parallelogram; (long_a, long_b) is the longer side.
    short_2 = footprint.a_by_u * footprint.a_by_u + footprint.b_by_u * footprint.b_by_u
    long_2 = footprint.a_by_v * footprint.a_by_v + footprint.b_by_v * footprint.b_by_v
    long_a = footprint.a_by_v
    long_b = footprint.b_by_v
    if short_2 > long_2:
        short_2, long_2 = long_2, short_2
        long_a = footprint.a_by_u
        long_b = footprint.b_by_u
    short_2 = max(short_2, 1.0)
    long_2 = max(long_2, 1.0)

    # So many taps that each covers about a square, and the mip level whose texels are that large.
    taps = min(math.ceil(math.sqrt(long_2 / short_2)), MAX_TAPS)
    level, blend = _mip_level(math.sqrt(max(long_2 / (taps * taps), short_2)))

    total = 0.0
    for k in range(taps):
        offset = (k + 0.5) / taps - 0.5
        a = footprint.a + offset * long_a
        b = footprint.b + offset * long_b
        fine = _bilinear(mipmaps, layer, level, a=a, b=b)
        total += fine + blend * (_bilinear(mipmaps, layer, level + 1, a=a, b=b) - fine)
    return total / (127.5 * taps) - 1.0


@compiled
def sample_square(mipmaps: Mipmaps, layer: int, a: float, b: float, side: float) -> float:
    """Return the mean of a texture over a square, from −1 to 1, by one trilinear sample.

    The square is centred on (a, b) and ``side`` wide, all in texels of mip level 0.
    """
    level, blend = _mip_level(max(side, 1.0))
    fine = _bilinear(mipmaps, layer, level, a=a, b=b)
    coarse = _bilinear(mipmaps, layer, level + 1, a=a, b=b)
    return (fine + blend * (coarse - fine)) / 127.5 - 1.0


@compiled
def _mip_level(texels: float) -> tuple[int, float]:
    """Return the finer of the two mip levels to sample, and how far to blend into the next one.

    The finer level is the coarsest whose texels are at most ``texels`` texels of level 0 wide.
    """
    mantissa, exponent = math.frexp(texels)
    if exponent > LEVELS - 1:
        return LEVELS - 2, 1.0
    return exponent - 1, 2.0 * mantissa - 1.0


@compiled
def _bilinear(mipmaps: Mipmaps, layer: int, level: int, a: float, b: float) -> float:
    """Return the bilinear interpolation of one mip level at (a, b), 0 … 255.

    (a, b) are in texels of level 0; the texel with index i is centred on i + ½.
    """
    texels = mipmaps.texels
    start = mipmaps.level_start[level]
    size = SIZE >> level
    scale = 1.0 / (1 << level)
    a = a * scale - 0.5
    b = b * scale - 0.5
    left = math.floor(a)
    low = math.floor(b)
    share_a = a - left
    share_b = b - low

    # The size is a power of two, so masking wraps the indices around the tile.
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
