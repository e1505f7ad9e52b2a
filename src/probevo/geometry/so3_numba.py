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
    """Compute C = Exp(φ) of N rotation vectors, [N, 3], rad, to [N, 3, 3]."""
    for n in range(len(phi)):
        x = phi[n, 0]
        y = phi[n, 1]
        z = phi[n, 2]
        squared = x * x + y * y + z * z
        a, b, _ = exp_coefficients(squared)
        # I + a φ^ + b φ^ φ^, with φ^ φ^ = φ φᵀ − θ².
        C[n, 0, 0] = 1.0 - b * (y * y + z * z)
        C[n, 1, 1] = 1.0 - b * (x * x + z * z)
        C[n, 2, 2] = 1.0 - b * (x * x + y * y)
        C[n, 0, 1] = b * x * y - a * z
        C[n, 1, 0] = b * x * y + a * z
        C[n, 0, 2] = b * x * z + a * y
        C[n, 2, 0] = b * x * z - a * y
        C[n, 1, 2] = b * y * z - a * x
        C[n, 2, 1] = b * y * z + a * x


@compiled
def left_jacobians(phi: FloatArray, jacobian: FloatArray) -> None:
    """Compute J(φ) of N rotation vectors, [N, 3], rad, to [N, 3, 3]: I + b φ^ + c φ^ φ^."""
    for n in range(len(phi)):
        x = phi[n, 0]
        y = phi[n, 1]
        z = phi[n, 2]
        squared = x * x + y * y + z * z
        _, b, c = exp_coefficients(squared)
        jacobian[n, 0, 0] = 1.0 - c * (y * y + z * z)
        jacobian[n, 1, 1] = 1.0 - c * (x * x + z * z)
        jacobian[n, 2, 2] = 1.0 - c * (x * x + y * y)
        jacobian[n, 0, 1] = c * x * y - b * z
        jacobian[n, 1, 0] = c * x * y + b * z
        jacobian[n, 0, 2] = c * x * z + b * y
        jacobian[n, 2, 0] = c * x * z - b * y
        jacobian[n, 1, 2] = c * y * z - b * x
        jacobian[n, 2, 1] = c * y * z + b * x
