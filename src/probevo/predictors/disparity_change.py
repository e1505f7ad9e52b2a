"""How far a feature's depth is from where the expected motion takes it."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.predictors.expected_place import moved_by


def disparity_change(
    previous_px: FloatArray, curr_px: FloatArray, expected: FloatArray, camera: StereoCamera
) -> FloatArray:
    """ln(1 + |d − d_expected|/px), d the current disparity, d_expected that to which the expected
    motion leads. Ours.

    Disparity is blind to small turns, and an error of the expected speed hardly shows in it: this
    needs no correction
    of the expected motion. It tells of oncoming cars, whose flow is like that of nearer things, and
    of stereo matches that jump.

    Args:
        previous_px: features in the previous frame, [N, 4], px.
        curr_px: the same in the current frame, [N, 4], px.
        expected: T_curr_prev, [4, 4].
        camera: the rectified camera.

    Returns:
        [N], ln(1 + px); always defined.
    """
    inverse_depth = moved_by(previous_px, expected, camera)[2]
    change: FloatArray = np.abs(
        curr_px[:, 0] - curr_px[:, 2] - camera.fu_px * camera.baseline_m * inverse_depth
    )
    return np.log1p(change)
