"""The transfer of stereo observations by a motion: y' = f(T g(y)).

A point is represented by its ray and inverse depth, so that points at infinity, and those that
noise puts a little beyond it, need no special case.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.stereo import StereoCamera

NEAREST_DEPTH_RATIO = 1e-3
"""Least depth in b over the depth in a at which a point counts as in front of camera b."""


@dataclass(frozen=True)
class TransferredPoints:
    """N points seen in frame a, as a motion T_b_a takes them to frame b."""

    pixels: FloatArray
    """Predicted observations (u_l, v_l, u_r, v_r) in b, [N, 4], px; NaN where not in front."""
    in_front: BoolArray
    """Which points are in front of camera b, [N]."""
    scaled_points: FloatArray
    """q = C m + ρ t with the ray m = (x, y, 1) in a: the points in b, each divided by its depth in
    a, [3, N]."""
    inverse_depth_a: FloatArray
    """ρ, the inverse of the depth in a, [N], 1/m; 0 at infinity."""

    @property
    def depth_ratio(self) -> FloatArray:
        """q_z, the depth in b over the depth in a, [N]."""
        depth_ratio: FloatArray = self.scaled_points[2]
        return depth_ratio


def transfer(pixels: FloatArray, T_b_a: FloatArray, camera: StereoCamera) -> TransferredPoints:
    """Predict where a motion takes observed points: f(T_b_a g(y)).

    As in g, the row of a point is the mean of its two rows.

    Args:
        pixels: observations y in a, [N, 4], px.
        T_b_a: motion, p_b = T_b_a p_a, [4, 4].
        camera: rectified stereo camera of both frames.
    """
    u_l, v_l, u_r, v_r = pixels.T
    disparity = u_l - u_r
    inverse_depth_a = disparity / (camera.fu_px * camera.baseline_m)
    rays = np.empty((3, len(pixels)))
    rays[0], rays[1] = camera.normalized(u_l, 0.5 * (v_l + v_r))
    rays[2] = 1.0
    # The moved points over their depths in a, [3, N]
    q = T_b_a[:3, :3] @ rays + T_b_a[:3, 3, None] * inverse_depth_a

    # The image does not depend on the scale of q. The disparity shrinks by the same ratio as the
    # depth grows: d' = d/q_z.
    in_front: BoolArray = q[2] >= NEAREST_DEPTH_RATIO
    depth_ratio = np.where(in_front, q[2], np.nan)
    u = camera.fu_px * q[0] / depth_ratio + camera.cu_px
    v = camera.fv_px * q[1] / depth_ratio + camera.cv_px
    return TransferredPoints(
        pixels=np.stack([u, v, u - disparity / depth_ratio, v], axis=1),
        in_front=in_front,
        scaled_points=q,
        inverse_depth_a=inverse_depth_a,
    )
