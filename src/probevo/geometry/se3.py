"""Poses SE(3) and their tangent vectors ξ = [ρ; φ], translation first (thesis section 2.3).

Functions are batched over leading dimensions; poses compose with ``@``.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import so3
from probevo.geometry.logarithms import log_translations
from probevo.geometry.se3_numba import adjoints, invert_poses

SERIES_BELOW = 0.05
"""Length of ξ up to which the next term of the inverse Jacobian's series, a⁴/720, is below 1e-8."""


def from_parts(C_b_a: FloatArray, t_b: FloatArray) -> FloatArray:
    """Return T_b_a, [..., 4, 4], with p_b = C_b_a p_a + t_b.

    Args:
        C_b_a: rotations, [..., 3, 3].
        t_b: translations, [..., 3], m.
    """
    batch = np.broadcast_shapes(C_b_a.shape[:-2], t_b.shape[:-1])
    T_b_a = np.zeros((*batch, 4, 4))
    T_b_a[..., :3, :3] = C_b_a
    T_b_a[..., :3, 3] = t_b
    T_b_a[..., 3, 3] = 1.0
    return T_b_a


def transform(T_b_a: FloatArray, points_a: FloatArray) -> FloatArray:
    """Return p_b = T_b_a p_a, [..., 3], m (thesis eq. 2.18).

    One pose moves all points, or each pose its own point.
    """
    return (T_b_a[..., :3, :3] @ points_a[..., None])[..., 0] + T_b_a[..., :3, 3]


def inverse(T_b_a: FloatArray) -> FloatArray:
    """Return T_a_b = T_b_a⁻¹, [..., 4, 4]."""
    T_b_a = np.ascontiguousarray(T_b_a, np.float64)
    if not T_b_a.flags.writeable:  # a read-only array is of another type, to compile for
        T_b_a = T_b_a.copy()
    T_a_b = np.empty_like(T_b_a)
    invert_poses(T_b_a.reshape(-1, 4, 4), T_a_b.reshape(-1, 4, 4))
    return T_a_b


def chain_motions(T_curr_prev: Iterable[FloatArray]) -> FloatArray:
    """Compound K − 1 motions to the poses T_world_cam, [K, 4, 4]; world is the first camera.

    T_world_curr = T_world_prev T_curr_prev⁻¹.
    """
    poses = [np.eye(4)]
    for motion in T_curr_prev:
        poses.append(poses[-1] @ inverse(motion))
    return np.array(poses)


def exp(xi: FloatArray) -> FloatArray:
    """Return T = Exp(ξ), [..., 4, 4], of tangent vectors [..., 6], m and rad (thesis eq. 2.14)."""
    rho = xi[..., :3]
    phi = xi[..., 3:]
    return from_parts(so3.exp(phi), (so3.left_jacobian(phi) @ rho[..., None])[..., 0])


def log(T: FloatArray) -> FloatArray:
    """Return ξ = Log(T), [..., 6], m and rad, of poses [..., 4, 4]; its angle is at most π."""
    phi = so3.log(T[..., :3, :3])
    t = np.ascontiguousarray(T[..., :3, 3], np.float64)
    rho = np.empty_like(phi)
    log_translations(phi.reshape(-1, 3), t.reshape(-1, 3), rho.reshape(-1, 3))
    return np.concatenate([rho, phi], axis=-1)


def adjoint(T: FloatArray) -> FloatArray:
    """Return Ad(T) = [[C, t^ C], [0, C]], [..., 6, 6], with Exp(Ad(T) ξ) = T Exp(ξ) T⁻¹."""
    T = np.array(T, np.float64, order="C")
    matrix = np.empty((*T.shape[:-2], 6, 6))
    adjoints(T.reshape(-1, 4, 4), matrix.reshape(-1, 6, 6))
    return matrix


def left_jacobian(xi: FloatArray) -> FloatArray:
    """Return the left Jacobian of SE(3), [..., 6, 6] (Barfoot 2017 eq. 7.83).

    Exp(ξ + δ) ≈ Exp(J δ) Exp(ξ), and Exp(ξ + δ) ≈ Exp(ξ) Exp(J_r δ) with J_r(ξ) = J(−ξ). It is the
    integral of Exp(a ad(ξ)) over a from 0 to 1: the series Σ ad(ξ)ⁿ / (n + 1)!.

    Args:
        xi: tangent vectors [ρ; φ], [..., 6], m and rad; the angle is a few rad at most.
    """
    # ad(ξ) = [[φ^, ρ^], [0, φ^]].
    ad = np.zeros((*xi.shape[:-1], 6, 6))
    ad[..., :3, :3] = so3.wedge(xi[..., 3:])
    ad[..., 3:, 3:] = ad[..., :3, :3]
    ad[..., :3, 3:] = so3.wedge(xi[..., :3])
    # SciPy's expm would wait for the threads of BLAS, on a busy machine for 20 ms a call.
    total = np.broadcast_to(np.eye(6), ad.shape).copy()
    term = total
    for n in range(2, 80):
        term = ad @ term / n
        total = total + term
        if not np.abs(term).max(initial=0.0) > 1e-17:
            break
    return total


def inverse_left_jacobian(xi: FloatArray) -> FloatArray:
    """Return the inverse of the left Jacobian of one tangent vector [ρ; φ], [6, 6].

    Log(Exp(δ) Exp(ξ)) ≈ ξ + J⁻¹ δ. Of a short ξ it is the series 1 − a/2 + a²/12 with a = ad(ξ),
    which is ten times as fast.
    """
    if xi @ xi > SERIES_BELOW**2:
        return np.asarray(np.linalg.inv(left_jacobian(xi)))
    ad = np.zeros((6, 6))
    ad[:3, :3] = so3.wedge(xi[3:])
    ad[3:, 3:] = ad[:3, :3]
    ad[:3, 3:] = so3.wedge(xi[:3])
    inverse: FloatArray = np.eye(6) - 0.5 * ad + ad @ ad / 12.0
    return inverse


def check_transform(T: FloatArray, where: str | Path) -> FloatArray:
    """Return the rigid transform nearest to a matrix, [4, 4].

    Raises:
        InputError: it is no [4, 4] matrix of finite numbers, its last row is not 0 0 0 1, or its
            3×3 block is not a rotation up to rounding.
    """
    matrix = np.asarray(T)
    if matrix.shape != (4, 4) or matrix.dtype.kind not in "iuf":
        what = f"this is {matrix.dtype} of shape {matrix.shape}."
        raise InputError(where, what, "Give a rigid transform, [4, 4]: [C, t; 0 0 0 1].")
    if not np.isfinite(matrix).all():
        raise InputError(where, "an entry of this transform is not finite.")
    if not np.array_equal(matrix[3], [0.0, 0.0, 0.0, 1.0]):
        raise InputError(where, "the last row of this transform is not 0 0 0 1.")
    return from_parts(so3.check_rotation(matrix[:3, :3], where), matrix[:3, 3])
