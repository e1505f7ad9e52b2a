"""Compiled perturbation, inverses and adjoints of poses; ``geometry.se3`` has the rest of SE(3)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled
from probevo.geometry.so3_numba import exp_coefficients


@compiled
def perturb(xi: FloatArray, T: FloatArray, T_out: FloatArray) -> None:
    """Fill T_out with Exp(ξ) T, for ξ = [ρ; φ] (thesis eqs. 2.3, 2.14, 2.15)."""
    x = xi[3]
    y = xi[4]
    z = xi[5]
    squared = x * x + y * y + z * z
    a, b, c = exp_coefficients(squared)
    wedge = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    # φ^ φ^ = φ φᵀ − θ² 1.
    wedge_2 = np.array(
        [
            [x * x - squared, x * y, x * z],
            [x * y, y * y - squared, y * z],
            [x * z, y * z, z * z - squared],
        ]
    )
    T_out[3, 0] = T_out[3, 1] = T_out[3, 2] = 0.0
    T_out[3, 3] = 1.0
    # Exp(ξ) = (C_ξ, J ρ), so that C = C_ξ C̄ and t = C_ξ t̄ + J ρ, with C_ξ = 1 + a φ^ + b φ^ φ^
    # and J = 1 + b φ^ + c φ^ φ^.
    for i in range(3):
        moved = 0.0
        for k in range(3):
            rotated = a * wedge[i, k] + b * wedge_2[i, k]
            left_jacobian = b * wedge[i, k] + c * wedge_2[i, k]
            if i == k:
                rotated += 1.0
                left_jacobian += 1.0
            moved += rotated * T[k, 3] + left_jacobian * xi[k]
        T_out[i, 3] = moved
        for j in range(3):
            total = T[i, j]
            for k in range(3):
                total += (a * wedge[i, k] + b * wedge_2[i, k]) * T[k, j]
            T_out[i, j] = total


@compiled
def invert_poses(T: FloatArray, inverse: FloatArray) -> None:
    """Invert N rigid transforms, [N, 4, 4]: (Cᵀ, −Cᵀ t)."""
    for n in range(len(T)):
        for i in range(3):
            moved = 0.0
            for k in range(3):
                inverse[n, i, k] = T[n, k, i]
                moved -= T[n, k, i] * T[n, k, 3]
            inverse[n, i, 3] = moved
            inverse[n, 3, i] = 0.0
        inverse[n, 3, 3] = 1.0


@compiled
def adjoints(T: FloatArray, adjoint: FloatArray) -> None:
    """Compute Ad(T) = [[C, t^ C], [0, C]] of N poses, [N, 4, 4] to [N, 6, 6]."""
    for n in range(len(T)):
        x = T[n, 0, 3]
        y = T[n, 1, 3]
        z = T[n, 2, 3]
        for j in range(3):
            for i in range(3):
                adjoint[n, i, j] = adjoint[n, 3 + i, 3 + j] = T[n, i, j]
                adjoint[n, 3 + i, j] = 0.0
            adjoint[n, 0, 3 + j] = y * T[n, 2, j] - z * T[n, 1, j]
            adjoint[n, 1, 3 + j] = z * T[n, 0, j] - x * T[n, 2, j]
            adjoint[n, 2, 3 + j] = x * T[n, 1, j] - y * T[n, 0, j]
