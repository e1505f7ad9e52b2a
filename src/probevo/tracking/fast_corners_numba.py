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
    """Width of the image, px."""
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


class CellCorners(NamedTuple):
    """The strongest corners of one cell, the strongest first; see ``Strongest``."""

    strength: IntArray
    """[per_cell], grey levels."""
    flat_index: IntArray
    """[per_cell]."""


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
    rows, columns, _ = strongest.flat_index.shape
    height = len(image.pixels) // image.width
    for row in range(rows):
        top, bottom = _extent(row, cell_px, height, border_px=border_px)
        for column in range(columns):
            first, last = _extent(column, cell_px, image.width, border_px=border_px)
            bound = image.bound[
                top - REACH_PX : bottom - REACH_PX, first - REACH_PX : last - REACH_PX
            ]
            corners = CellCorners(
                strength=strongest.strength[row, column],
                flat_index=strongest.flat_index[row, column],
            )
            # Most cells have corners at least half as strong as the bound, so weaker candidates
            # can be skipped. If that finds too few, repeat the search with the true threshold.
            least = max(threshold, _greatest(bound) // 2)
            if not _search_cell(image, top, first, bound=bound, least=least, corners=corners):
                corners.strength[:] = 0
                corners.flat_index[:] = -1
                _search_cell(image, top, first, bound=bound, least=threshold, corners=corners)


@compiled
def _search_cell(
    image: FlatImage, top: int, first: int, bound: Image, least: int, corners: CellCorners
) -> bool:
    """Fill in the strongest corners of one cell; False if fewer than asked for exceed ``least``.

    Args:
        image: the image.
        top: first row of the cell, px.
        first: its first column, px.
        bound: upper bound of the strength of its pixels, [height, width], grey levels.
        least: only stronger corners are looked for, grey levels.
        corners: in: no corners; out: the strongest ones.
    """
    height, width = bound.shape
    strengths = corners.strength
    indices = corners.flat_index
    for i in range(height):
        for j in range(width):
            if bound[i, j] <= least:
                continue
            index = (top + i) * image.width + first + j
            strength = _strength(image, index)
            if strength <= least:
                continue
            if not _is_local_maximum(image, first + j, top + i, strength=strength):
                continue
            # Insert it into the sorted list of this cell.
            rank = len(strengths) - 1
            while rank > 0 and strengths[rank - 1] < strength:
                strengths[rank] = strengths[rank - 1]
                indices[rank] = indices[rank - 1]
                rank -= 1
            strengths[rank] = strength
            indices[rank] = index
            # From now on, a corner must be stronger than the last of a full list.
            least = max(least, strengths[-1])
    is_full: bool = strengths[-1] > 0
    return is_full


@compiled
def _greatest(bound: Image) -> int:
    """Return the largest value of a cell, [height, width]; 0 of an empty one."""
    greatest = 0
    for i in range(len(bound)):
        row = bound[i]
        row_maximum = np.uint8(0)
        for j in range(len(row)):
            row_maximum = max(row_maximum, row[j])
        greatest = max(greatest, int(row_maximum))
    return greatest


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
            # The bound rules out most neighbours without computing their strength.
            is_center = du == 0 and dv == 0
            if is_center or image.bound[v + dv - REACH_PX, u + du - REACH_PX] < strength:
                continue
            if _strength(image, (v + dv) * image.width + u + du) >= strength:
                return False
    return True


@compiled
def _strength(image: FlatImage, index: int) -> int:
    """Return the strength of a pixel; 0 if it is no corner at any threshold.

    It is the largest minimum over nine consecutive pixels of the closed ring, of how much these are
    brighter than the central one, or how much darker.
    """
    ring = image.ring
    center = np.int32(image.pixels[np.uint64(index)])
    for k in range(16):
        ring[k] = np.int32(image.pixels[np.uint64(index + image.ring_offsets[k])]) - center
    # Repeated at its end, the closed ring can be read as a line.
    for k in range(8):
        ring[16 + k] = ring[k]
    strength = np.int32(0)
    for start in range(16):
        # Positive if all nine are brighter than the centre; −brightest, if all are darker.
        darkest = ring[start]
        brightest = ring[start]
        for k in range(1, 9):
            darkest = min(darkest, ring[start + k])
            brightest = max(brightest, ring[start + k])
        strength = max(strength, max(darkest, -brightest))
    return int(strength)
