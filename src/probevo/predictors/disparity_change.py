"""How far a feature's depth is from where the expected motion takes it."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera

MIN_DEPTH = 0.05
"""Least new depth over the old one: what would come behind the camera is put here, and so far off."""


def disparity_change(
    previous_px: FloatArray, curr_px: FloatArray, expected: FloatArray, camera: StereoCamera
) -> FloatArray:
    """ln(1 + |d − d_expected|/px), d the current disparity, d_expected that to which the expected motion leads. Ours.

    Disparity is blind to small turns, and an error of the expected speed hardly shows in it: this needs no correction
    of the expected motion. It tells of oncoming cars, whose flow is like that of nearer things, and of stereo matches
    that jump.

    Args:
        previous_px: features in the previous frame, [N, 4], px.
        curr_px: the same in the current frame, [N, 4], px.
        expected: T_curr_prev, [4, 4].
        camera: the rectified camera.

    Returns:
        [N], ln(1 + px); always defined.
    """
    before = np.maximum(previous_px[:, 0] - previous_px[:, 2], 0.0)
    rho = before / (camera.fu_px * camera.baseline_m)
    x, y = (previous_px[:, 0] - camera.cu_px) / camera.fu_px, (previous_px[:, 1] - camera.cv_px) / camera.fv_px
    c_x, c_y, c_z, t = expected[2]
    depth = c_x * x + c_y * y + c_z + t * rho  # of the point over what it was
    after = curr_px[:, 0] - curr_px[:, 2]
    change: FloatArray = np.abs(after - before / np.maximum(depth, MIN_DEPTH))
    return np.log1p(change)
