"""Rigid motion between two sets of matched points in closed form, every point trusted alike (PROBE eqs. 5-6)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3


def direct_motion(
    points_prev: FloatArray, points_curr: FloatArray, C_curr_prev: FloatArray | None = None
) -> FloatArray:
    """T_curr_prev, [..., 4, 4], that takes the points seen in the previous frame to those in the current one.

    The rotated centroid must fall on the other: t = u_curr − C_curr_prev u_prev, which is PROBE eq. (5) for
    t = −C_ba r_a^ba. Batched over leading dimensions, so that RANSAC solves all its samples at once.

    Args:
        points_prev, points_curr: the same points in either frame, [..., N, 3], m, N ≥ 1.
        C_curr_prev: known rotation, such as the gyro's, [..., 3, 3]; with None it is the least-squares one, for which
            at least three points that are not on one line are needed, or else it is one of many.
    """
    u_prev, u_curr = points_prev.mean(axis=-2), points_curr.mean(axis=-2)
    if C_curr_prev is None:
        C_curr_prev = _least_squares_rotation(points_prev - u_prev[..., None, :], points_curr - u_curr[..., None, :])
    return se3.from_parts(C_curr_prev, u_curr - (C_curr_prev @ u_prev[..., None])[..., 0])


def _least_squares_rotation(vectors_prev: FloatArray, vectors_curr: FloatArray) -> FloatArray:
    """The C that minimises Σ ‖v_curr − C v_prev‖², never a reflection: [..., N, 3] to [..., 3, 3].

    Umeyama: "Least-squares estimation of transformation parameters between two point patterns", PAMI 1991, eq. (43).
    """
    U, _, Vt = np.linalg.svd(vectors_curr.mT @ vectors_prev)
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]
    rotation: FloatArray = U @ Vt
    return rotation
