"""Transfer of features by a predicted motion, for predictors that compare it with the
observation."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera

MIN_DEPTH_RATIO = 0.05
"""Smallest new depth over the old one.

A feature that would come nearer, or behind the camera, is given this depth, which puts it far from
where it is observed."""


def predicted_place(
    prev_px: FloatArray, T_curr_prev: FloatArray, camera: StereoCamera
) -> FloatArray:
    """Transfer features to the current frame by a motion.

    Args:
        prev_px: features in the previous frame, [N, 4], px.
        T_curr_prev: the motion, [4, 4].
        camera: the rectified camera.

    Returns:
        Normalized image coordinates x and y, and inverse depth, 1/m, in the current frame, [3, N].
    """
    # Points over their old depth: the third coordinate is the new depth over the old one
    q, inverse_depth = camera.moved_rays(prev_px, T_curr_prev)
    # (x, y) = (q_x, q_y)/q_z, and the inverse depth ρ in a becomes ρ/q_z
    depth_ratio = np.maximum(q[2], MIN_DEPTH_RATIO)
    q[2] = inverse_depth
    place: FloatArray = q / depth_ratio
    return place
