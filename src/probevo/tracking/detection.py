"""New corners where the image has none yet."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image, IntArray
from probevo.config import TrackingConfig

BORDER_PX = 8
"""Corners closer to the border than this could not be tracked with a whole window."""


def detect_corners(image: Image, occupied_px: FloatArray, config: TrackingConfig) -> FloatArray:
    """FAST corners, the strongest ones of each grid cell that has fewer than its share of features.

    Args:
        image: [height, width], uint8.
        occupied_px: (u, v) of the features already there, [N, 2], px.
        config: number of features, cell size, threshold.

    Returns:
        (u, v) of the new corners, [M, 2], px.
    """
    height, width = image.shape
    columns, rows = -(-width // config.cell_px), -(-height // config.cell_px)
    share = max(1, round(config.num_features / (columns * rows)))
    room = share - np.bincount(_cell_of(occupied_px, config.cell_px, columns, rows), minlength=columns * rows)
    keypoints = cv2.FastFeatureDetector.create(config.fast_threshold).detect(image)
    if not keypoints:
        return np.zeros((0, 2))
    corners = cv2.KeyPoint.convert(keypoints).astype(np.float64)
    strength = np.array([keypoint.response for keypoint in keypoints])
    inside = (corners > BORDER_PX).all(axis=1) & (corners < np.array([width, height]) - BORDER_PX - 1).all(axis=1)
    corners, strength = corners[inside], strength[inside]
    cell = _cell_of(corners, config.cell_px, columns, rows)
    best_first = np.lexsort((corners[:, 0], corners[:, 1], -strength, cell))
    cell = cell[best_first]
    starts = np.flatnonzero(np.r_[True, cell[1:] != cell[:-1]]) if len(cell) else np.zeros(0, np.int64)
    rank = np.arange(len(cell)) - np.repeat(starts, np.diff(np.r_[starts, len(cell)]))
    return corners[best_first[rank < room[cell]]]


def _cell_of(pixels: FloatArray, cell_px: int, columns: int, rows: int) -> IntArray:
    column = np.clip(pixels[:, 0] // cell_px, 0, columns - 1).astype(np.int64)
    row = np.clip(pixels[:, 1] // cell_px, 0, rows - 1).astype(np.int64)
    return row * columns + column
