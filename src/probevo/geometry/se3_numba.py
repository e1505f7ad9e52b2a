"""Compiled perturbation and comparison of poses; ``geometry.se3`` has the rest of SE(3)."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled


@compiled
def exp_coefficients(squared: float) -> tuple[float, float, float]:
    """Return sin φ / φ, (1 − cos φ) / φ² and (φ − sin φ) / φ³ for φ², rad².

    With the matrix Φ of the cross product by the rotation vector, Exp is I + a Φ + b Φ² and its
    left Jacobian I + b Φ + c Φ² (thesis eqs. 2.3, 2.15).
    """
    if squared < 1e-6:  # series: the next terms are below the last bit
        return 1.0 - squared / 6.0, 0.5 - squared / 24.0, 1.0 / 6.0 - squared / 120.0
    angle = math.sqrt(squared)
    a = math.sin(angle) / angle
    return a, (1.0 - math.cos(angle)) / squared, (1.0 - a) / squared


@compiled
def perturb(xi: FloatArray, T: FloatArray, T_out: FloatArray) -> None:
    """Fill T_out with Exp(ξ) T, for ξ = [ρ; φ] (thesis eqs. 2.3, 2.14, 2.15)."""
    x = xi[3]
    y = xi[4]
    z = xi[5]
    squared = x * x + y * y + z * z
    a, b, c = exp_coefficients(squared)
    wedge = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    wedge_2 = np.array(
        [
            [x * x - squared, x * y, x * z],
            [x * y, y * y - squared, y * z],
            [x * z, y * z, z * z - squared],
        ]
    )
    T_out[3, 0] = T_out[3, 1] = T_out[3, 2] = 0.0
    T_out[3, 3] = 1.0
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
def rotation_error(C: FloatArray, C_prior: FloatArray, error: FloatArray) -> None:
    """Fill error [3] with φ = Log(C C_priorᵀ), the angle from both sine and cosine.

    C must not be half a turn away from C_prior; of both, the upper left [3, 3] counts.
    """
    D = np.zeros((3, 3))  # C C_priorᵀ
    for i in range(3):
        for j in range(3):
            for k in range(3):
                D[i, j] += C[i, k] * C_prior[j, k]
    x = 0.5 * (D[2, 1] - D[1, 2])
    y = 0.5 * (D[0, 2] - D[2, 0])
    z = 0.5 * (D[1, 0] - D[0, 1])
    sine = math.sqrt(x * x + y * y + z * z)
    cosine = 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0)
    ratio = math.atan2(sine, cosine) / sine if sine > 1e-9 else 1.0
    error[0] = ratio * x
    error[1] = ratio * y
    error[2] = ratio * z
