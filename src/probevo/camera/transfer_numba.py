"""The compiled transfer of a stereo observation from one camera frame to another: f(T g(y)).

A point is carried as its ray m and inverse depth ρ = d/(f_u b) rather than as p = m/ρ, so that T
acts as q = C m + ρ t. Nothing is singular for a point at infinity, and far features still
contribute to the rotation.
"""

from __future__ import annotations

from typing import NamedTuple

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.compiled import compiled

NEAREST = 1e-3
"""A point whose scaled depth q_z falls below this is behind the camera or in it, and does not
contribute."""


class Intrinsics(NamedTuple):
    """What the compiled loops need of a stereo camera."""

    fu: float
    fv: float
    cu: float
    cv: float
    fb: float
    """f_u b, the disparity of a point at 1 m, px m."""

    @staticmethod
    def of(camera: StereoCamera) -> Intrinsics:
        """Return the intrinsics of a camera."""
        return Intrinsics(
            fu=camera.fu_px,
            fv=camera.fv_px,
            cu=camera.cu_px,
            cv=camera.cv_px,
            fb=camera.fu_px * camera.baseline_m,
        )


@compiled
def velocity_over_depth(
    x: float, y: float, inverse_depth: float, twist: FloatArray
) -> tuple[float, float, float]:
    """Return ṗ/Z = ω × (x, y, 1) + v/Z of a point at rest, seen at (x, y), in the camera's frame.

    Args:
        x: u − c_u over f_u.
        y: v − c_v over f_v.
        inverse_depth: 1/Z.
        twist: (v, ω) of T_curr_prev per second, [6].
    """
    vx, vy, vz, wx, wy, wz = twist
    return (
        wy - wz * y + vx * inverse_depth,
        wz * x - wx + vy * inverse_depth,
        wx * y - wy * x + vz * inverse_depth,
    )


@compiled
def move_point(
    T: FloatArray, camera: Intrinsics, point: FloatArray
) -> tuple[float, float, float, float]:
    """Move a point (u, v, d), px, by T_b_a [4, 4]: return q = C m + ρ t and the inverse depth ρ.

    q is the point in frame b over its depth in frame a; in pixels relative to the principal point
    it is seen at u' = f_u q_x/q_z and v' = f_v q_y/q_z, with the disparity d' = f_u b ρ/q_z.
    """
    # The ray m = (mx, my, 1) and the inverse depth in frame a.
    mx = (point[0] - camera.cu) / camera.fu
    my = (point[1] - camera.cv) / camera.fv
    rho = point[2] / camera.fb
    X = T[0, 0] * mx + T[0, 1] * my + T[0, 2] + rho * T[0, 3]
    Y = T[1, 0] * mx + T[1, 1] * my + T[1, 2] + rho * T[1, 3]
    Z = T[2, 0] * mx + T[2, 1] * my + T[2, 2] + rho * T[2, 3]
    return X, Y, Z, rho
