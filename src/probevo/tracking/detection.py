"""New corners where the image has none yet."""

from __future__ import annotations

import math

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image, IntArray
from probevo.compiled import compiled
from probevo.config import TrackingConfig

FEATURES_PER_CELL = 2
"""Cells are as large as it takes for this many features each to make the number wanted."""
BORDER_PX = 8
"""Corners closer to the border than this could not be tracked with a whole window."""


def detect_corners(image: Image, occupied_px: FloatArray, config: TrackingConfig) -> FloatArray:
    """FAST corners, the strongest ones of each grid cell that has fewer than its share of features.

    Args:
        image: [height, width], uint8.
        occupied_px: (u, v) of the features already there, [N, 2], px.
        config: number of features, threshold.

    Returns:
        (u, v) of the new corners, [M, 2], px.
    """
    height, width = image.shape
    cell_px = math.sqrt(FEATURES_PER_CELL * width * height / config.num_features)
    columns, rows = math.ceil(width / cell_px), math.ceil(height / cell_px)
    room = np.full(columns * rows, FEATURES_PER_CELL, np.int64)
    occupied = np.clip(occupied_px // cell_px, 0, [columns - 1, rows - 1]).astype(np.int64)
    np.subtract.at(room, occupied[:, 1] * columns + occupied[:, 0], 1)
    keypoints = cv2.FastFeatureDetector.create(config.fast_threshold).detect(image)
    if not keypoints:
        return np.zeros((0, 2))
    corners = np.asarray(cv2.KeyPoint.convert(keypoints), np.float64)
    strength = np.array([keypoint.response for keypoint in keypoints])
    chosen = _strongest_per_cell(corners, strength, room, cell_px, columns, width, height)
    found: FloatArray = corners[chosen]
    return found


@compiled
def _strongest_per_cell(
    corners: FloatArray,
    strength: FloatArray,
    room: IntArray,
    cell_px: float,
    columns: int,
    width: int,
    height: int,
) -> IntArray:
    """Indices of the corners that fill each cell's room, strongest first; ties go to the earlier corner."""
    best = np.full((len(room), FEATURES_PER_CELL), -1)
    for n in range(len(corners)):
        u, v = corners[n, 0], corners[n, 1]
        if u < BORDER_PX or v < BORDER_PX or u >= width - BORDER_PX or v >= height - BORDER_PX:
            continue
        cell = int(v // cell_px) * columns + int(u // cell_px)
        candidate = n
        for place in range(room[cell]):
            holder = best[cell, place]
            if holder < 0 or strength[candidate] > strength[holder]:
                best[cell, place] = candidate
                if holder < 0:
                    break
                candidate = holder
    chosen: IntArray = best.ravel()[best.ravel() >= 0]
    return chosen
