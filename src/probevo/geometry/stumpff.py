"""Stumpff functions, in which the closed forms of the Jacobians of SO(3) and SE(3) are free of singularities."""

from __future__ import annotations

from math import factorial

import numpy as np

from probevo.arrays import FloatArray

_SERIES = [
    [(-1) ** k / factorial(2 * k + order) for k in reversed(range(9))] for order in range(6)
]  # the first term left out is below 1e-17 of the sum for angles under 1 rad


def stumpff(order: int, angle_sq: FloatArray) -> FloatArray:
    """c_n(θ) = Σ_k (−1)^k θ^{2k} / (2k + n)!, to 1e-13 relative for θ ≤ π.

    c_0 = cos θ, c_1 = sin θ / θ, c_2 = (1 − cos θ) / θ², c_3 = (θ − sin θ) / θ³, and on: c_{n+2} = (1/n! − c_n) / θ².
    That recursion cancels near 0, where the series takes over.

    Args:
        order: n, 0 … 5.
        angle_sq: θ², [...], rad².
    """
    small_sq = np.minimum(angle_sq, 1.0)
    series = np.full_like(small_sq, _SERIES[order][0])
    for coefficient in _SERIES[order][1:]:
        series = series * small_sq + coefficient
    is_large = angle_sq > 1.0
    if not is_large.any():
        return series
    large_sq = np.maximum(angle_sq, 1.0)
    angle = np.sqrt(large_sq)
    closed_form = np.sin(angle) / angle if order % 2 else np.cos(angle)
    for n in range(order % 2, order, 2):
        closed_form = (1.0 / factorial(n) - closed_form) / large_sq
    return np.where(is_large, closed_form, series)
