"""The transfer of stereo observations by a motion: y' = f(T g(y)).

A point is represented by its ray and inverse depth, so that points at infinity, and those that
noise puts a little beyond it, need no special case.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import NEAREST


def transfer(pixels: FloatArray, T_b_a: FloatArray, camera: StereoCamera) -> FloatArray:
    """Predict where a motion takes observed points: f(T_b_a g(y)).

    As in g, the row of a point is the mean of its two rows.

    Args:
        pixels: observations y in a, [N, 4], px.
        T_b_a: motion, p_b = T_b_a p_a, [4, 4].
        camera: rectified stereo camera of both frames.

    Returns:
        Observations (u_l, v_l, u_r, v_r) in b, [N, 4], px; NaN for points that are not in front of
        its camera.
    """
    u_l, v_l, u_r, v_r = pixels.T
    disparity = u_l - u_r
    inverse_depth = disparity / (camera.fu_px * camera.baseline_m)
    rays = np.empty((3, len(pixels)))
    rays[0], rays[1] = camera.normalized(u_l, 0.5 * (v_l + v_r))
    rays[2] = 1.0
    # The moved points, each divided by its depth z in a, [3, N]: q = C m + t/z, with the ray m.
    q = T_b_a[:3, :3] @ rays + T_b_a[:3, 3, None] * inverse_depth

    # The image does not depend on the scale of q. The disparity shrinks by the same ratio as the
    # depth grows: d' = d/q_z.
    depth_ratio = np.where(q[2] >= NEAREST, q[2], np.nan)
    u = camera.fu_px * q[0] / depth_ratio + camera.cu_px
    v = camera.fv_px * q[1] / depth_ratio + camera.cv_px
    return np.stack([u, v, u - disparity / depth_ratio, v], axis=1)
