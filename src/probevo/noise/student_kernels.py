"""Compiled inner loops of the Student-t fits."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled, invert_symmetric_4

LEAST_DOF, MOST_DOF = 1.0, 200.0
"""Of a fit: below, a mean says nothing; above, the data cannot tell it from a Gaussian."""


@compiled
def digamma(x: float) -> float:
    """ψ(x) for x > 0, to 1e-10: recurrence up to 6, then the asymptotic series (Abramowitz & Stegun 6.3.18)."""
    value = 0.0
    while x < 6.0:
        value -= 1.0 / x
        x += 1.0
    y = 1.0 / (x * x)
    series = y * (1.0 / 12.0 - y * (1.0 / 120.0 - y * (1.0 / 252.0 - y * (1.0 / 240.0 - y / 132.0))))
    return value + math.log(x) - 0.5 / x - series


@compiled
def _dof_slope(dof: float) -> float:
    """The likelihood's derivative by ν is this plus the mean of ln w − w."""
    half, more = 0.5 * dof, 0.5 * (dof + 4.0)
    return math.log(half) - digamma(half) + digamma(more) - math.log(more) + 1.0


@compiled
def _dof_of(mean_log_weight: float) -> float:
    """ν at which the derivative is zero, by halving ln ν; it falls from the smallest ν on."""
    low, high = math.log(LEAST_DOF), math.log(MOST_DOF)
    if _dof_slope(math.exp(high)) + mean_log_weight >= 0.0:
        return math.exp(high)
    if _dof_slope(math.exp(low)) + mean_log_weight <= 0.0:
        return math.exp(low)
    for _ in range(40):
        middle = 0.5 * (low + high)
        if _dof_slope(math.exp(middle)) + mean_log_weight > 0.0:
            low = middle
        else:
            high = middle
    return math.exp(0.5 * (low + high))


@compiled
def fit_all(
    errors: FloatArray,
    spread: FloatArray,
    first: IntArray,
    index: IntArray,
    kernel: FloatArray,
    prior_scale: FloatArray,
    prior: tuple[float, float, float, float],
    iterations: int,
    robust: bool,
    scale: FloatArray,
    dof: FloatArray,
    bias: FloatArray,
) -> None:
    """The scale is divided by Σ k w rather than Σ k (PX-EM; Liu, Rubin & Wu 1998): the same limit, far sooner.

    The prior counts as errors of weight one whose mean square is its scale.
    """
    prior_dof, counts, dof_counts, bias_counts = prior
    has_spread, has_bias = len(spread) > 0, robust and bias_counts < np.inf
    learns_dof = robust and dof_counts < np.inf
    prior_log_weight = -_dof_slope(prior_dof) if learns_dof else 0.0
    W, lower, total = np.empty((4, 4)), np.zeros((4, 4)), 0.0
    for c in range(len(dof)):
        S, b, nu = scale[c], bias[c], prior_dof
        S[:] = prior_scale
        total = 0.0
        for m in range(first[c], first[c + 1]):
            total += kernel[m]
        for _ in range(iterations if total > 0.0 else 0):
            if not invert_symmetric_4(S, W, lower):
                break
            w00, w11, w22, w33 = W[0, 0], W[1, 1], W[2, 2], W[3, 3]
            w01, w02, w03, w12, w13, w23 = (
                2.0 * W[0, 1], 2.0 * W[0, 2], 2.0 * W[0, 3], 2.0 * W[1, 2], 2.0 * W[1, 3], 2.0 * W[2, 3],
            )  # fmt: skip
            b0, b1, b2, b3 = b
            a00 = a01 = a02 = a03 = a11 = a12 = a13 = a22 = a23 = a33 = 0.0
            p0 = p1 = p2 = p3 = weights = log_weights = 0.0
            for m in range(first[c], first[c + 1]):
                n = index[m]
                e0, e1, e2, e3 = errors[n, 0] - b0, errors[n, 1] - b1, errors[n, 2] - b2, errors[n, 3] - b3
                q00, q01, q02, q03, q11 = e0 * e0, e0 * e1, e0 * e2, e0 * e3, e1 * e1
                q12, q13, q22, q23, q33 = e1 * e2, e1 * e3, e2 * e2, e2 * e3, e3 * e3
                if has_spread:
                    q00 += spread[n, 0]
                    q01 += spread[n, 1]
                    q11 += spread[n, 2]
                    q02 += spread[n, 3]
                    q12 += spread[n, 4]
                    q22 += spread[n, 5]
                    q03 += spread[n, 6]
                    q13 += spread[n, 7]
                    q23 += spread[n, 8]
                    q33 += spread[n, 9]
                w = kernel[m]
                if robust:
                    squared = (
                        w00 * q00 + w11 * q11 + w22 * q22 + w33 * q33
                        + w01 * q01 + w02 * q02 + w03 * q03 + w12 * q12 + w13 * q13 + w23 * q23
                    )  # fmt: skip
                    robust_weight = (nu + 4.0) / (nu + squared)
                    if learns_dof:
                        log_weights += w * (math.log(robust_weight) - robust_weight)
                    w *= robust_weight
                weights += w
                p0 += w * e0
                p1 += w * e1
                p2 += w * e2
                p3 += w * e3
                a00 += w * q00
                a01 += w * q01
                a02 += w * q02
                a03 += w * q03
                a11 += w * q11
                a12 += w * q12
                a13 += w * q13
                a22 += w * q22
                a23 += w * q23
                a33 += w * q33
            S[0, 0], S[1, 1], S[2, 2], S[3, 3] = a00, a11, a22, a33
            S[0, 1], S[0, 2], S[0, 3], S[1, 2], S[1, 3], S[2, 3] = a01, a02, a03, a12, a13, a23
            for i in range(4):
                for j in range(i, 4):
                    S[i, j] = S[j, i] = (S[i, j] + counts * prior_scale[i, j]) / (weights + counts)
            if has_bias:
                share = 1.0 / (weights + bias_counts)
                b[0], b[1] = share * (p0 + weights * b0), share * (p1 + weights * b1)
                b[2], b[3] = share * (p2 + weights * b2), share * (p3 + weights * b3)
            if learns_dof:
                nu = _dof_of((log_weights + dof_counts * prior_log_weight) / (total + dof_counts))
        dof[c] = nu
