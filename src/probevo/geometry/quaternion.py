"""Unit quaternions q = [w, x, y, z], scalar first (thesis section 2.2.1).

They cover SO(3) twice: q and −q are the same rotation. Functions are batched over leading dimensions.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray


def exp(phi: FloatArray) -> FloatArray:
    """q = Exp(φ) = [cos θ/2, a sin θ/2]: rotation vectors [..., 3], rad, to quaternions [..., 4] (thesis eq. 2.8)."""
    return Rotation.from_rotvec(phi).as_quat(scalar_first=True)


def log(q: FloatArray) -> FloatArray:
    """φ = Log(q): quaternions [..., 4] to rotation vectors [..., 3], rad, of length at most π (thesis eq. 2.9).

    q and −q give the same φ. (The small-angle form printed as thesis eq. 2.10 lacks the factor 2 of eq. 2.9.)
    """
    return Rotation.from_quat(q, scalar_first=True).as_rotvec()


def product(p: FloatArray, q: FloatArray) -> FloatArray:
    """p ⊗ q, Hamilton's product, which composes as matrices do: C(p ⊗ q) = C(p) C(q). [..., 4] each."""
    p_w, p_v = p[..., :1], p[..., 1:]
    q_w, q_v = q[..., :1], q[..., 1:]
    w = p_w * q_w - np.sum(p_v * q_v, axis=-1, keepdims=True)
    v = p_w * q_v + q_w * p_v + np.cross(p_v, q_v)
    return np.concatenate([w, v], axis=-1)


def inverse(q: FloatArray) -> FloatArray:
    """q⁻¹, the conjugate of a unit quaternion: [..., 4]."""
    conjugate: FloatArray = q * np.array([1.0, -1.0, -1.0, -1.0])
    return conjugate


def to_matrix(q: FloatArray) -> FloatArray:
    """The rotation matrix of each quaternion: [..., 4] to [..., 3, 3]."""
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


def from_matrix(C: FloatArray) -> FloatArray:
    """The quaternion with w ≥ 0 of each rotation matrix: [..., 3, 3] to [..., 4]."""
    return Rotation.from_matrix(C, assume_valid=True).as_quat(canonical=True, scalar_first=True)
