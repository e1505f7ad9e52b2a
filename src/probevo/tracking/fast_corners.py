"""FAST corners, the strongest of each cell only.

The same as OpenCV finds (cv2.FastFeatureDetector with non-maximum suppression, type 9-16: tested),
which makes a Python object of each of ten thousand corners, while all other threads wait, for the
six hundred that are wanted.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from probevo.arrays import AnyArray, FloatArray, Image, IntArray
from probevo.compiled import compiled

REACH_PX = 3
"""Radius of the ring of 16 pixels that a corner is compared with."""
HALF_RING = ((0, 3), (1, 3), (2, 2), (3, 1), (3, 0), (3, -1), (2, -2), (1, -3))
RING = HALF_RING + tuple((-du, -dv) for du, dv in HALF_RING)
"""(du, dv) of the ring's pixels, in turn."""


def strongest_of_cells(
    image: Image,
    threshold: int,
    cell_px: float,
    rows: int,
    columns: int,
    per_cell: int,
    border_px: int,
) -> FloatArray:
    """The strongest FAST corners of each cell (Rosten and Drummond 2006).

    "Machine learning for high-speed corner detection": a corner is brighter, or darker, than nine
    pixels in a row of the ring by more than a threshold; the largest such threshold is its
    strength, and no neighbor is as strong.

    Args:
        image: [height, width], uint8.
        threshold: difference that makes a corner, grey levels.
        cell_px: side of the square cells.
        rows: of cells.
        columns: of cells.
        per_cell: corners wanted of each.
        border_px: none is taken closer to the border, at least REACH_PX + 1.

    Returns:
        (u, v) of the corners, [rows, columns, per_cell, 2], px, the strongest first, of equals the
        upper and left one first; NaN where a cell has no more.
    """
    height, width = image.shape
    at = np.full((rows, columns, per_cell), -1)
    if min(height, width) > 2 * border_px:
        strength = np.zeros((rows, columns, per_cell), np.int64)
        ring = np.zeros(len(RING) + 8, np.int32)
        offsets = np.array([dv * width + du for du, dv in RING])
        pixels = np.ascontiguousarray(image).ravel()
        above = _bound(image)
        _fill(
            pixels,
            width,
            above,
            offsets=offsets,
            threshold=threshold,
            cell_px=cell_px,
            border_px=border_px,
            ring=ring,
            strength=strength,
            at=at,
        )
    corners: FloatArray = np.where(
        at[..., None] < 0, np.nan, np.stack([at % width, at // width], axis=-1)
    )
    return corners


def _bound(image: Image) -> Image:
    """Of each pixel REACH_PX from the border, at least its strength, [height − 6, width − 6].

    Nine in a row of sixteen hold one of each two that face each other. In whole images this takes
    0.5 ms.
    """
    height, width = image.shape

    def shifted(du: int, dv: int) -> Image:
        return image[REACH_PX + dv : height - REACH_PX + dv, REACH_PX + du : width - REACH_PX + du]

    center = shifted(0, 0)
    brighter = np.full(center.shape, 255, np.uint8)
    darker = np.zeros(center.shape, np.uint8)
    of_two = np.empty_like(brighter)
    for du, dv in HALF_RING:
        one = shifted(du, dv)
        other = shifted(-du, -dv)
        cv2.min(brighter, cv2.max(one, other, dst=of_two), dst=brighter)
        cv2.max(darker, cv2.min(one, other, dst=of_two), dst=darker)
    cv2.subtract(brighter, center, dst=brighter)
    cv2.subtract(center, darker, dst=darker)
    return np.asarray(cv2.max(brighter, darker, dst=of_two), dtype=np.uint8)


@compiled
def _fill(
    pixels: AnyArray,
    width: int,
    bound: Image,
    offsets: IntArray,
    threshold: int,
    cell_px: float,
    border_px: int,
    ring: AnyArray,
    strength: IntArray,
    at: IntArray,
) -> None:
    """Strength and place of each cell's strongest corners, [rows, columns, per_cell]; ``ring`` is
    work space."""
    rows, columns, per_cell = at.shape
    height = len(pixels) // width
    for row in range(rows):
        top, bottom = _inner(row, cell_px, height, border_px=border_px)
        for column in range(columns):
            first, last = _inner(column, cell_px, width, border_px=border_px)
            held = strength[row, column]
            places = at[row, column]
            least = threshold
            for v in range(top, bottom):
                bounds = bound[v - REACH_PX, first - REACH_PX : last - REACH_PX]
                for i in range(len(bounds)):
                    if bounds[i] <= least:
                        continue
                    u = first + i
                    found = _strength(pixels, v * width + u, offsets, least=least, ring=ring)
                    if found <= least or not _is_peak(
                        pixels, width, u, v=v, bound=bound, offsets=offsets, found=found, ring=ring
                    ):
                        continue
                    place = per_cell - 1
                    while place > 0 and held[place - 1] < found:
                        held[place] = held[place - 1]
                        places[place] = places[place - 1]
                        place -= 1
                    held[place] = found
                    places[place] = v * width + u
                    least = max(threshold, held[per_cell - 1])


@compiled
def _inner(cell: int, cell_px: float, side_px: int, border_px: int) -> tuple[int, int]:
    """First pixel of a cell, and the one after its last, along a side of the image, without the
    border."""
    first = max(border_px, math.ceil(cell * cell_px))
    return first, max(first, min(side_px - border_px, math.ceil((cell + 1) * cell_px)))


@compiled
def _is_peak(
    pixels: AnyArray,
    width: int,
    u: int,
    v: int,
    bound: Image,
    offsets: IntArray,
    found: int,
    ring: AnyArray,
) -> bool:
    """Whether none of the eight neighbors is as strong."""
    for dv in range(-1, 2):
        for du in range(-1, 2):
            if (du == 0 and dv == 0) or bound[v + dv - REACH_PX, u + du - REACH_PX] < found:
                continue
            if (
                _strength(pixels, (v + dv) * width + u + du, offsets, least=found - 1, ring=ring)
                >= found
            ):
                return False
    return True


@compiled
def _strength(pixels: AnyArray, at: int, offsets: IntArray, least: int, ring: AnyArray) -> int:
    """Strength of a pixel if it is more than ``least``, or else that."""
    center = np.int32(pixels[np.uint64(at)])
    brighter = 0
    darker = 0
    for k in range(16):
        ring[k] = np.int32(pixels[np.uint64(at + offsets[k])]) - center
        brighter |= (1 << k) if ring[k] > least else 0
        darker |= (1 << k) if ring[k] < -least else 0
    if _nine_in_a_row(darker):
        for k in range(16):
            ring[k] = -ring[k]
    elif not _nine_in_a_row(brighter):
        return least
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
def _nine_in_a_row(ring: int) -> bool:
    """Whether nine of sixteen bits in a ring stand together."""
    twice = ring | (ring << 16)
    two = twice & (twice >> 1)
    four = two & (two >> 2)
    return (four & (four >> 4) & (twice >> 8) & 0xFFFF) != 0
