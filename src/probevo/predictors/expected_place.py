"""Where a motion takes features; for the predictors that compare this with what was seen."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera

MIN_DEPTH = 0.05
"""Least new depth over the old one: what would come behind the camera is put here, and so far off.
"""


def moved_by(pixels: FloatArray, T_curr_prev: FloatArray, camera: StereoCamera) -> FloatArray:
    """Where a motion takes features [N, 4]: x, y and inverse depth, 1/m, in the current frame, [3,
    N]."""
    q, rho = camera.moved_rays(pixels, T_curr_prev)
    depth = np.maximum(q[2], MIN_DEPTH)
    q[2] = rho
    place: FloatArray = q / depth
    return place
