"""Where a motion takes features; for the predictors that compare this with what was seen."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer import seen_from_left, transfer

MIN_DEPTH = 0.05
"""Least new depth over the old one: what would come behind the camera is put here, and so far off.
"""


def moved_by(pixels: FloatArray, T_curr_prev: FloatArray, camera: StereoCamera) -> FloatArray:
    """Where a motion takes features [N, 4]: x, y and inverse depth, 1/m, in the current frame, [3,
    N]."""
    moved = transfer(seen_from_left(pixels), T_curr_prev, camera)
    x, y, depth_ratio = moved.scaled_points
    place: FloatArray = np.stack([x, y, moved.inverse_depth_a]) / np.maximum(depth_ratio, MIN_DEPTH)
    return place
