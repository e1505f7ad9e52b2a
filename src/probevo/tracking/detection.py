"""New corners where the image has none yet."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.compiled import compiled
from probevo.config import TrackingConfig
from probevo.tracking.fast_corners import strongest_of_cells

FEATURES_PER_CELL = 2
"""Cells are as large as it takes for this many features each to make the number wanted."""
AROUND_WINDOW_PX = 3
"""Corners whose window comes closer to the border than this could not be tracked with all of it."""


def strongest_corners(image: Image, config: TrackingConfig) -> FloatArray:
    """The strongest FAST corners of each grid cell.

    Args:
        image: [height, width], uint8.
        config: number of features, threshold, window.

    Returns:
        (u, v) of the corners, [rows, columns, FEATURES_PER_CELL, 2], px, the strongest first; NaN
        where a cell has no more.
    """
    grid = _grid(image.shape, config)
    border_px = config.window_px // 2 + AROUND_WINDOW_PX
    return strongest_of_cells(image, config.fast_threshold, *grid, FEATURES_PER_CELL, border_px)


def corners_in_room(
    strongest: FloatArray, occupied_px: FloatArray, shape: tuple[int, int], config: TrackingConfig
) -> FloatArray:
    """Of each cell's strongest corners, those that are apart, as many as fill the share that the
    features there leave.

    Args:
        strongest: from ``strongest_corners``.
        occupied_px: (u, v) of the features already there, [N, 2], px.
        shape: [height, width] of the image.
        config: the same settings.

    Returns:
        (u, v) of the new corners, [M, 2], px.
    """
    cell_px, rows, columns = _grid(shape, config)
    column, row = np.clip(occupied_px // cell_px, 0, [columns - 1, rows - 1]).astype(np.int64).T
    taken = np.bincount(row * columns + column, minlength=rows * columns).reshape(rows, columns, 1)
    chosen = (np.arange(FEATURES_PER_CELL) < FEATURES_PER_CELL - taken) & np.isfinite(
        strongest[..., 0]
    )
    corners: FloatArray = strongest[chosen]
    return corners[apart(np.vstack([occupied_px, corners]), shape, config)[len(occupied_px) :]]


def apart(pixels: FloatArray, shape: tuple[int, int], config: TrackingConfig) -> BoolArray:
    """Which features do not share most of their window with one before them that is kept, [N].

    Two that do are one: their errors are alike, and counted as two they would make the motion look
    surer than it is.

    Args:
        pixels: (u, v) of the features, [N, 2], px.
        shape: [height, width] of the image.
        config: with the window.
    """
    keep = np.empty(len(pixels), np.bool_)
    _keep_apart(
        np.round(pixels).astype(np.int64),
        config.window_px // 2 + 1,
        np.zeros(shape, np.bool_),
        keep=keep,
    )
    return keep


@compiled
def _keep_apart(pixels: IntArray, reach: int, taken: BoolArray, keep: BoolArray) -> None:
    """Mark the square around each feature that is kept."""
    height, width = taken.shape
    for n in range(len(pixels)):
        u = min(max(pixels[n, 0], 0), width - 1)
        v = min(max(pixels[n, 1], 0), height - 1)
        keep[n] = not taken[v, u]
        if keep[n]:
            for row in range(max(v - reach, 0), min(v + reach + 1, height)):
                for column in range(max(u - reach, 0), min(u + reach + 1, width)):
                    taken[row, column] = True


def _grid(shape: tuple[int, int], config: TrackingConfig) -> tuple[float, int, int]:
    """Side of the square cells, px, and how many rows and columns of them there are."""
    height, width = shape
    cell_px = math.sqrt(FEATURES_PER_CELL * width * height / config.num_features)
    return cell_px, math.ceil(height / cell_px), math.ceil(width / cell_px)
