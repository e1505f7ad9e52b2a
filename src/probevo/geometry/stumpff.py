"""Stumpff functions: with them the closed forms of SO(3)'s Jacobians have no singularity."""

from __future__ import annotations

from math import factorial

import numpy as np

from probevo.arrays import FloatArray

MOST_ORDERS = 4
TERMS = 9
"""For angles below 1 rad, the first omitted term is below 1e-17 of the sum."""
_SERIES = np.array(
    [[(-1) ** k / factorial(2 * k + order) for k in range(TERMS)] for order in range(MOST_ORDERS)]
)
_EXPONENTS = np.arange(TERMS, dtype=np.float64)[:, None]


def stumpff(orders: tuple[int, ...], angle_sq: FloatArray) -> FloatArray:
    """Return c_n(θ) = Σ_k (−1)^k θ^{2k} / (2k + n)! of each order n, [len(orders), ...].

    c_0 = cos θ, c_1 = sin θ / θ, c_2 = (1 − cos θ) / θ², c_3 = (θ − sin θ) / θ³, and in general
    c_{n+2} = (1/n! − c_n) / θ². The relative error is below 1e-13 for θ ≤ π.

    Args:
        orders: n, each 0 … 3.
        angle_sq: θ², [...], rad².
    """
    # The recursion suffers from cancellation near 0; the series serves angles up to 1 rad.
    powers = np.minimum(angle_sq, 1.0).ravel() ** _EXPONENTS
    series: FloatArray = (_SERIES[list(orders)] @ powers).reshape(len(orders), *angle_sq.shape)
    is_large = angle_sq > 1.0
    if not is_large.any():
        return series
    large_sq = np.maximum(angle_sq, 1.0)
    angle = np.sqrt(large_sq)
    closed_form = [np.cos(angle), np.sin(angle) / angle]
    for n in range(max(orders) - 1):
        closed_form.append((1.0 / factorial(n) - closed_form[n]) / large_sq)
    return np.where(is_large, np.stack([closed_form[n] for n in orders]), series)
