"""Compiled loops of the FAST corner detector."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import AnyArray, Image, IntArray
from probevo.compiled import compiled

REACH_PX = 3
"""Radius of the ring of 16 pixels with which a corner is compared."""


class FlatImage(NamedTuple):
    """An image whose rows stand one after the other, and what belongs to it."""

    pixels: AnyArray
    """Grey levels, [height · width], uint8."""
    width: int
    """Of the image, px."""
    bound: Image
    """Upper bound of the strength of each pixel, [height − 6, width − 6], uint8."""
    ring_offsets: IntArray
    """Index of the ring's pixels relative to the central one, [16]."""
    ring: AnyArray
    """Work space, [16 + 8], int32."""


class Strongest(NamedTuple):
    """The strongest corners of each cell, the strongest first."""

    strength: IntArray
    """[rows, columns, per_cell], grey levels; 0 where there is no corner."""
    flat_index: IntArray
    """Index of the corner in the flat image, [rows, columns, per_cell]; −1 where there is none."""


@compiled
def fill_strongest(
    image: FlatImage, cell_px: float, threshold: int, border_px: int, strongest: Strongest
) -> None:
    """Fill in the strongest corners of each cell.

    Args:
        image: the image.
        cell_px: side of the square cells, px.
        threshold: difference that makes a corner, grey levels.
        border_px: least distance of a corner from the border.
        strongest: in: no corners; out: the strongest ones.
    """
    rows, columns, per_cell = strongest.flat_index.shape
    width = image.width
    height = len(image.pixels) // width
    for row in range(rows):
        top, bottom = _extent(row, cell_px, height, border_px=border_px)
        for column in range(columns):
            first, last = _extent(column, cell_px, width, border_px=border_px)
            strengths = strongest.strength[row, column]
            indices = strongest.flat_index[row, column]
            # Only pixels whose bound exceeds ``least`` can be among the strongest
            least = threshold
            for v in range(top, bottom):
                bounds = image.bound[v - REACH_PX, first - REACH_PX : last - REACH_PX]
                for i in range(len(bounds)):
                    if bounds[i] <= least:
                        continue
                    u = first + i
                    strength = _strength(image, v * width + u, least)
                    if strength <= least or not _is_local_maximum(image, u, v, strength=strength):
                        continue
                    # Insert it into the sorted list of this cell
                    place = per_cell - 1
                    while place > 0 and strengths[place - 1] < strength:
                        strengths[place] = strengths[place - 1]
                        indices[place] = indices[place - 1]
                        place -= 1
                    strengths[place] = strength
                    indices[place] = v * width + u
                    # From now on, a corner must be stronger than the last of a full list
                    least = max(threshold, strengths[per_cell - 1])


@compiled
def _extent(cell: int, cell_px: float, side_px: int, border_px: int) -> tuple[int, int]:
    """Return the first pixel of a cell along one side of the image, and that after its last.

    Pixels of the image's border belong to no cell.
    """
    first = max(border_px, math.ceil(cell * cell_px))
    return first, max(first, min(side_px - border_px, math.ceil((cell + 1) * cell_px)))


@compiled
def _is_local_maximum(image: FlatImage, u: int, v: int, strength: int) -> bool:
    """Tell whether none of the eight neighbours is as strong (non-maximum suppression)."""
    for dv in range(-1, 2):
        for du in range(-1, 2):
            is_center = du == 0 and dv == 0
            if is_center or image.bound[v + dv - REACH_PX, u + du - REACH_PX] < strength:
                continue
            if _strength(image, (v + dv) * image.width + u + du, strength - 1) >= strength:
                return False
    return True


@compiled
def _strength(image: FlatImage, index: int, least: int) -> int:
    """Return the strength of a pixel if it is more than ``least``, or else ``least``."""
    ring = image.ring
    # Which of the ring's pixels are brighter, or darker, as bits
    center = np.int32(image.pixels[np.uint64(index)])
    brighter = 0
    darker = 0
    for k in range(16):
        ring[k] = np.int32(image.pixels[np.uint64(index + image.ring_offsets[k])]) - center
        brighter |= (1 << k) if ring[k] > least else 0
        darker |= (1 << k) if ring[k] < -least else 0
    if _nine_consecutive(darker):
        for k in range(16):
            ring[k] = -ring[k]
    elif not _nine_consecutive(brighter):
        return least
    # The strength is the largest minimum over nine consecutive pixels of the closed ring
    for k in range(8):
        ring[16 + k] = ring[k]
    strongest = np.int32(least)
    for start in range(16):
        weakest = ring[start]
        for k in range(1, 9):
            weakest = min(weakest, ring[start + k])
        strongest = max(strongest, weakest)
    return int(strongest)


@compiled
def _nine_consecutive(ring: int) -> bool:
    """Tell whether nine consecutive bits of a ring of sixteen are set."""
    twice = ring | (ring << 16)
    two = twice & (twice >> 1)
    four = two & (two >> 2)
    return (four & (four >> 4) & (twice >> 8) & 0xFFFF) != 0
