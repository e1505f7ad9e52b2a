"""Rotations SO(3) and their tangent vectors φ (thesis section 2.2).

Functions are batched over leading dimensions. The adjoint of a rotation is the matrix itself:
Exp(Cφ) = C Exp(φ) Cᵀ.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry.logarithms import log_rotations
from probevo.geometry.so3_numba import exp_rotations, left_jacobians

ROTATION_TOLERANCE = 1e-3
"""Largest entry of C Cᵀ − 1 that rounding in a text file explains."""


def wedge(phi: FloatArray) -> FloatArray:
    """Return φ^, [..., 3, 3], the skew-symmetric matrix with φ^ p = φ × p (thesis eq. 2.4)."""
    matrix = np.zeros((*phi.shape, 3))
    matrix[..., 2, 1] = phi[..., 0]
    matrix[..., 0, 2] = phi[..., 1]
    matrix[..., 1, 0] = phi[..., 2]
    return matrix - matrix.mT


def exp(phi: FloatArray) -> FloatArray:
    """Return C = Exp(φ), [..., 3, 3], of rotation vectors [..., 3], rad (thesis eq. 2.3)."""
    phi = np.array(phi, np.float64, order="C")
    C = np.empty((*phi.shape, 3))
    exp_rotations(phi.reshape(-1, 3), C.reshape(-1, 3, 3))
    return C


def log(C: FloatArray) -> FloatArray:
    """Return φ = Log(C), [..., 3], rad, of rotations [..., 3, 3] (thesis eq. 2.5).

    Its length is at most π. The result is accurate to rounding at every angle, 0 and π included; at
    π, where φ and −φ are the same rotation, it is either of the two. A matrix of NaN, an unknown
    rotation, gives a vector of NaN.
    """
    rotations = np.ascontiguousarray(C, np.float64).reshape(-1, 3, 3)
    phi = np.empty((len(rotations), 3))
    log_rotations(rotations, phi)
    return phi.reshape(C.shape[:-1])


def left_jacobian(phi: FloatArray) -> FloatArray:
    """Return J(φ), [..., 3, 3], with Exp(φ + δ) ≈ Exp(J δ) Exp(φ) (thesis eqs. 2.15, 2.20)."""
    phi = np.array(phi, np.float64, order="C")
    jacobian = np.empty((*phi.shape, 3))
    left_jacobians(phi.reshape(-1, 3), jacobian.reshape(-1, 3, 3))
    return jacobian


def most_aligned(outer_products: FloatArray) -> FloatArray:
    """Return the rotations C, [..., 3, 3], that maximise Σ bᵢᵀ C aᵢ, given Σ bᵢ aᵢᵀ, [..., 3, 3].

    Wahba's problem, by singular values (Kabsch 1976; Markley 1988; Umeyama 1991).
    """
    # Σ bᵢ aᵢᵀ = U S Vᵀ, with the last axis reversed where U Vᵀ is a reflection.
    U, _, Vt = np.linalg.svd(outer_products)
    U[..., :, 2] *= np.linalg.det(U @ Vt)[..., None]
    C: FloatArray = U @ Vt
    return C


def check_rotation(C: FloatArray, where: str | Path) -> FloatArray:
    """Return the rotations nearest to the matrices C, [..., 3, 3].

    Raises:
        InputError: a matrix differs from a rotation by more than rounding.
    """
    C = np.asarray(C, np.float64)  # not all of linear algebra knows other types
    deviation = np.abs(C @ C.mT - np.eye(3)).max(axis=(-2, -1))
    bad = np.flatnonzero(~(deviation < ROTATION_TOLERANCE) | ~(np.linalg.det(C) > 0))
    if len(bad):
        what = (
            "this is not a rotation matrix"
            if C.ndim == 2
            else f"pose {bad[0]} (from 0) holds no rotation matrix"
        )
        raise InputError(where, f"{what}: its columns must be orthonormal and right-handed.")
    return Rotation.from_matrix(C).as_matrix()
