"""Compiled exponentials of rotations, and their left Jacobians; ``geometry.so3`` has the rest.

A step of the odometry takes some fifty of them, of one or ten rotations at a time. NumPy or SciPy
would take 10 to 50 µs for each.
"""

from __future__ import annotations

import math

from probevo.arrays import FloatArray
from probevo.compiled import compiled

SMALL_SQ = 1.0
"""θ², rad², up to which the series is accurate to a double. Beyond, cancellation costs the closed
forms one digit at most."""


@compiled
def exp_coefficients(squared: float) -> tuple[float, float, float]:
    """Return sin θ / θ, (1 − cos θ) / θ² and (θ − sin θ) / θ³ for θ², rad².

    With φ^ the matrix of the cross product by the rotation vector, Exp is I + a φ^ + b φ^ φ^, and
    its left Jacobian I + b φ^ + c φ^ φ^ (thesis eqs. 2.3, 2.15).
    """
    if squared < SMALL_SQ:
        # Σ_k (−θ²)^k / (2k + n)!, by Horner's rule from the ninth term on.
        a = b = c = 0.0
        for k in range(8, -1, -1):
            a = 1.0 - squared / ((2 * k + 2) * (2 * k + 3)) * a
            b = 1.0 - squared / ((2 * k + 3) * (2 * k + 4)) * b
            c = 1.0 - squared / ((2 * k + 4) * (2 * k + 5)) * c
        return a, 0.5 * b, c / 6.0
    angle = math.sqrt(squared)
    a = math.sin(angle) / angle
    return a, (1.0 - math.cos(angle)) / squared, (1.0 - a) / squared


@compiled
def exp_rotations(phi: FloatArray, C: FloatArray) -> None:
    """Compute C = Exp(φ) = I + a φ^ + b φ^ φ^ of N rotation vectors, [N, 3], rad, to [N, 3, 3]."""
    for n in range(len(phi)):
        a, b, _ = exp_coefficients(_squared_length(phi[n]))
        _fill(phi[n], a, b, C[n])


@compiled
def left_jacobians(phi: FloatArray, jacobian: FloatArray) -> None:
    """Compute J(φ) = I + b φ^ + c φ^ φ^ of N rotation vectors, [N, 3], rad, to [N, 3, 3]."""
    for n in range(len(phi)):
        _, b, c = exp_coefficients(_squared_length(phi[n]))
        _fill(phi[n], b, c, jacobian[n])


@compiled
def _squared_length(vector: FloatArray) -> float:
    """Return the squared length of a vector, [3]."""
    return float(vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2])


@compiled
def _fill(phi: FloatArray, first: float, second: float, matrix: FloatArray) -> None:
    """Fill a matrix, [3, 3], with I + first · φ^ + second · φ^ φ^, where φ^ φ^ = φ φᵀ − θ²."""
    x = phi[0]
    y = phi[1]
    z = phi[2]
    matrix[0, 0] = 1.0 - second * (y * y + z * z)
    matrix[1, 1] = 1.0 - second * (x * x + z * z)
    matrix[2, 2] = 1.0 - second * (x * x + y * y)
    matrix[0, 1] = second * x * y - first * z
    matrix[1, 0] = second * x * y + first * z
    matrix[0, 2] = second * x * z + first * y
    matrix[2, 0] = second * x * z - first * y
    matrix[1, 2] = second * y * z - first * x
    matrix[2, 1] = second * y * z + first * x
