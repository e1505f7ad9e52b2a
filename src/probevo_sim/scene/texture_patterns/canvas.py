"""Drawing on a tile that wraps around: noise of a given spectrum, polygons and strokes.

Lengths are in texels; x is the column, y the row, which grows upwards on a wall. Shapes are drawn
on a canvas of twice the tile's resolution, and ``downsampled`` takes the mean of 2×2, so that edges
are smooth (supersampling). Grey values are around 0 … 1.
"""

from __future__ import annotations

import cv2
import numpy as np
import scipy.fft
from numpy.typing import ArrayLike, NDArray

from probevo.arrays import FloatArray

SIDE = 512
"""Texels along one side of a tile."""
FINE = 2
"""Canvas pixels along one side of a texel."""

Tile = FloatArray
"""Grey values: [SIDE, SIDE] of a tile, [FINE · SIDE, FINE · SIDE] of a canvas."""

_SUBPIXEL_BITS = 4
"""Fractional bits of the coordinates that OpenCV gets."""


def noise(
    rng: np.random.Generator,
    slope: float,
    low: float = 1.0,
    high: float = SIDE / 2,
    *,
    stretch: tuple[float, float] = (1.0, 1.0),
) -> Tile:
    """Draw Gaussian noise of zero mean, unit variance and a power-law spectrum, [SIDE, SIDE].

    The noise is periodic, because it is made in the frequency domain.

    Args:
        rng: source of the noise.
        slope: the amplitude falls with frequency to the power −slope: 0 is white, 1 looks like
            soil, 2 like clouds.
        low: lowest frequency, in cycles per tile.
        high: highest frequency, in cycles per tile.
        stretch: how many times longer features are along x and y.
    """
    f_x = scipy.fft.rfftfreq(SIDE, 1 / SIDE).astype(np.float32) * stretch[0]
    f_y = scipy.fft.fftfreq(SIDE, 1 / SIDE).astype(np.float32)[:, None] * stretch[1]
    frequency = np.hypot(f_x, f_y)

    # Shape a white spectrum by the power law within the band; the mean is left out.
    frequency[0, 0] = np.inf
    kept = (frequency >= low) & (frequency <= high)
    gain = np.where(kept, np.maximum(frequency, 0.5) ** np.float32(-slope), np.float32(0))
    spectrum = rng.standard_normal((*gain.shape, 2), dtype=np.float32).view(np.complex64)[..., 0]
    tile: Tile = scipy.fft.irfft2(gain * spectrum, s=(SIDE, SIDE)).astype(np.float64)
    return tile / float(tile.std())


def blank(value: float, side: int = SIDE) -> Tile:
    """Return a canvas of one grey for a tile of ``side`` × ``side`` texels."""
    return np.full((FINE * side, FINE * side), value)


def downsampled(canvas: Tile) -> Tile:
    """Return the mean of each 2×2: the tile of a canvas, or the next mip level of a tile."""
    rows = canvas[::2] + canvas[1::2]
    return 0.25 * (rows[:, ::2] + rows[:, 1::2])


def upsampled(tile: Tile) -> Tile:
    """Return the canvas of a tile: each value 2×2 times."""
    return tile.repeat(FINE, axis=0).repeat(FINE, axis=1)


def rectangle(
    canvas: Tile, left: float, bottom: float, *, right: float, top: float, value: ArrayLike
) -> None:
    """Fill a rectangle with a grey or with what broadcasts to its canvas pixels."""
    rows = np.arange(round(FINE * bottom), round(FINE * top)) % len(canvas)
    columns = np.arange(round(FINE * left), round(FINE * right)) % len(canvas)
    canvas[np.ix_(rows, columns)] = value


def polygon(canvas: Tile, points: ArrayLike, value: float) -> None:
    """Fill a polygon with corners (x, y), [K, 2]."""
    for copy in _wrapped_copies(canvas, points, 0.0):
        cv2.fillPoly(canvas, [copy], value, shift=_SUBPIXEL_BITS)


def stroke(
    canvas: Tile, points: ArrayLike, width: float, value: float, *, closed: bool = False
) -> None:
    """Draw a line ``width`` texels thick through points (x, y), [K, 2]."""
    for copy in _wrapped_copies(canvas, points, width):
        cv2.polylines(
            canvas,
            [copy],
            closed,
            value,
            thickness=max(1, round(FINE * width)),
            shift=_SUBPIXEL_BITS,
        )


def _wrapped_copies(canvas: Tile, points: ArrayLike, width: float) -> list[NDArray[np.int32]]:
    """Return the points in OpenCV's fixed-point numbers, and copies where they cross the edge.

    A shape that crosses an edge of the tile comes in again at the opposite side.
    """
    unit = 2**_SUBPIXEL_BITS
    fixed = np.rint((FINE * np.asarray(points, dtype=np.float64) - 0.5) * unit).astype(np.int32)
    side = unit * len(canvas)
    margin = int(unit * FINE * width)
    left, bottom = (fixed.min(axis=0) - margin).tolist()
    right, top = (fixed.max(axis=0) + margin).tolist()

    # Shifts by whole tiles that move some part of the shape onto the canvas.
    along_x = range(-(right // side), 1 - left // side)
    along_y = range(-(top // side), 1 - bottom // side)
    return [
        fixed + np.array([side * i, side * j], dtype=np.int32) for i in along_x for j in along_y
    ]


def ellipse(
    x: float,
    y: float,
    radius_x: float,
    *,
    radius_y: float,
    angle_rad: float = 0.0,
    corners: int = 24,
) -> FloatArray:
    """Return the outline of an ellipse around (x, y), rotated counter-clockwise: [corners, 2]."""
    around = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    along = radius_x * np.cos(around)
    across = radius_y * np.sin(around)
    cosine = np.cos(angle_rad)
    sine = np.sin(angle_rad)
    return np.stack(
        [x + cosine * along - sine * across, y + sine * along + cosine * across], axis=1
    )


def random_walk(
    rng: np.random.Generator, steps: int, *, step: float, bend_rad: float
) -> FloatArray:
    """Return a path of steps of one length, each rotated at random, like a crack: [steps, 2].

    It starts at a random place.
    """
    heading = rng.uniform(0, 2 * np.pi) + np.cumsum(rng.normal(scale=bend_rad, size=steps))
    moves = step * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return rng.uniform(0, SIDE, size=2) + np.cumsum(moves, axis=0)


def relief(height: Tile) -> Tile:
    """Return the shading of a surface of this height lit from the upper left: its slope there."""
    return (np.roll(height, -1, 1) - np.roll(height, 1, 1)) - (
        np.roll(height, -1, 0) - np.roll(height, 1, 0)
    )
