"""Detection of new corners, spread over the image by a grid of cells (bucketing)."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.compiled import compiled
from probevo.config import TrackingConfig
from probevo.tracking.fast_corners import CornerGrid, strongest_of_cells

FEATURES_PER_CELL = 2
"""Features wanted in each cell; the size of the cells follows from it."""
AROUND_WINDOW_PX = 3
"""Margin around the window of a corner, so that the window can move a little inside the image."""


def strongest_corners(
    image: Image, config: TrackingConfig, usable: BoolArray | None = None
) -> FloatArray:
    """Detect the strongest FAST corners of each grid cell.

    Args:
        image: [height, width], uint8.
        config: number of features, threshold, window.
        usable: where corners may be, [height, width]; None for everywhere.

    Returns:
        (u, v) of the corners, [rows, columns, FEATURES_PER_CELL, 2], px, the strongest first; NaN
        where a cell has no more.
    """
    return strongest_of_cells(
        image,
        corner_grid(image.shape, config),
        threshold=config.fast_threshold,
        per_cell=FEATURES_PER_CELL,
        border_px=config.window_px // 2 + AROUND_WINDOW_PX,
        usable=usable,
    )


def corners_in_free_cells(
    strongest: FloatArray, occupied_px: FloatArray, shape: tuple[int, int], config: TrackingConfig
) -> FloatArray:
    """Choose new corners that do not overlap, to fill each cell up to FEATURES_PER_CELL.

    Args:
        strongest: strongest corners of each cell, as from ``strongest_corners``.
        occupied_px: (u, v) of the features already tracked, [N, 2], px.
        shape: (height, width) of the image.
        config: the settings of ``strongest_corners``.

    Returns:
        (u, v) of the new corners, [M, 2], px.
    """
    # Count the features of each cell
    grid = corner_grid(shape, config)
    last_cell = [grid.columns - 1, grid.rows - 1]
    column, row = np.clip(occupied_px // grid.cell_px, 0, last_cell).astype(np.int64).T
    num_cells = grid.rows * grid.columns
    # Cells are numbered row by row.
    taken = np.bincount(row * grid.columns + column, minlength=num_cells)
    free = FEATURES_PER_CELL - taken.reshape(grid.rows, grid.columns, 1)
    # Fill the cells with their strongest corners
    is_chosen = (np.arange(FEATURES_PER_CELL) < free) & np.isfinite(strongest[..., 0])
    corners: FloatArray = strongest[is_chosen]
    # Drop those that overlap with a feature, or with a corner before them
    keep = non_overlapping(np.vstack([occupied_px, corners]), shape, config)
    return corners[keep[len(occupied_px) :]]


def non_overlapping(
    pixels: FloatArray, shape: tuple[int, int], config: TrackingConfig
) -> BoolArray:
    """Find the features whose window does not overlap by half with one that was kept before.

    The errors of two features that share most of their window are equal. Counted as two, they
    would make the covariance of the motion too small.

    Args:
        pixels: (u, v) of the features, [N, 2], px.
        shape: (height, width) of the image.
        config: with the size of the window.

    Returns:
        Mask of the features to keep, [N].
    """
    keep = np.empty(len(pixels), np.bool_)
    _fill_non_overlapping(
        np.round(pixels).astype(np.int64),
        config.window_px // 2 + 1,
        np.zeros(shape, np.bool_),
        keep=keep,
    )
    return keep


@compiled
def _fill_non_overlapping(pixels: IntArray, reach: int, taken: BoolArray, keep: BoolArray) -> None:
    """Mark the square around each feature that is kept in ``taken``, [height, width]."""
    height, width = taken.shape
    for n in range(len(pixels)):
        u = min(max(pixels[n, 0], 0), width - 1)
        v = min(max(pixels[n, 1], 0), height - 1)
        # Overlapping by half: the centre lies in the square around an earlier feature
        keep[n] = not taken[v, u]
        if keep[n]:
            for row in range(max(v - reach, 0), min(v + reach + 1, height)):
                for column in range(max(u - reach, 0), min(u + reach + 1, width)):
                    taken[row, column] = True


def corner_grid(shape: tuple[int, int], config: TrackingConfig) -> CornerGrid:
    """Return the grid whose cells, with FEATURES_PER_CELL each, hold the number wanted.

    Args:
        shape: (height, width) of the image.
        config: with the number of features.
    """
    height, width = shape
    # Cells of this side cover the image with num_features / FEATURES_PER_CELL of them.
    cell_px = math.sqrt(FEATURES_PER_CELL * width * height / config.num_features)
    return CornerGrid(
        cell_px=cell_px, rows=math.ceil(height / cell_px), columns=math.ceil(width / cell_px)
    )
