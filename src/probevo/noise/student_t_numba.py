"""Compiled inner loops of the Student-t fits."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled, copy_into, factor, invert_symmetric_4

LEAST_DOF = 1.0
MOST_DOF = 200.0
"""Of a fit: below, a mean says nothing; above, the data cannot tell it from a Gaussian."""
DOF_TOLERANCE = 1e-9
"""Of ln ν."""
LEAST_SIGMA_PX = 1e-3
"""No error is known better: added to each axis, so that errors all zero, or all alike, leave a
distribution."""
MANTISSA = np.int64(2**52 - 1)
ONE = np.int64(1023 << 52)
"""Bits of a double's mantissa, and those of 1.0."""
TO_52 = np.int64((1023 + 52) << 52)
"""Bits of 2^52, under which a small whole number can be added to it by its bits."""
ROOT_2 = math.sqrt(2.0)
LOG_2 = math.log(2.0)


@compiled
def _dof_slope(dof: float) -> float:
    """The likelihood's derivative by ν is this plus the mean of ln w − w; ψ(ν/2 + 2) − ψ(ν/2) = 2/ν
    + 2/(ν + 2)."""
    return 1.0 + 2.0 / dof + 2.0 / (dof + 2.0) - math.log(1.0 + 4.0 / dof)


@compiled
def _dof_of(mean_log_weight: float) -> float:
    """ν at which the derivative is zero: its only root from LEAST_DOF on, by false position in ln ν
    (Illinois)."""
    low = math.log(LEAST_DOF)
    high = math.log(MOST_DOF)
    above = _dof_slope(LEAST_DOF) + mean_log_weight
    below = _dof_slope(MOST_DOF) + mean_log_weight
    if below >= 0.0:
        return MOST_DOF
    if above <= 0.0:
        return LEAST_DOF
    middle = low
    side = 0
    for _ in range(60):
        before = middle
        middle = (low * below - high * above) / (below - above)
        if abs(middle - before) < DOF_TOLERANCE:
            break
        value = _dof_slope(math.exp(middle)) + mean_log_weight
        if value > 0.0:
            low = middle
            above = value
            below = below * 0.5 if side == 1 else below
            side = 1
        else:
            high = middle
            below = value
            above = above * 0.5 if side == -1 else above
            side = -1
    return math.exp(middle)


@compiled
def _gather(
    errors: FloatArray,
    spread: FloatArray,
    index: IntArray,
    errors_of: FloatArray,
    spread_of: FloatArray,
) -> None:
    """The errors that are asked for, and their spread, as rows: loops over a row do several errors
    at once."""
    for m in range(len(index)):
        for i in range(4):
            errors_of[i, m] = errors[index[m], i]
    if len(spread):
        for m in range(len(index)):
            for i in range(10):
                spread_of[i, m] = spread[index[m], i]


@compiled
def _weigh(
    errors: FloatArray,
    spread: FloatArray,
    bias: FloatArray,
    W: FloatArray,
    dof: float,
    weight: FloatArray,
) -> None:
    """w = (ν + d)/(ν + (e − b)ᵀ W (e − b) + tr W S) of each error."""
    b0, b1, b2, b3 = bias
    w00 = W[0, 0]
    w11 = W[1, 1]
    w22 = W[2, 2]
    w33 = W[3, 3]
    w01 = W[0, 1]
    w02 = W[0, 2]
    w03 = W[0, 3]
    w12 = W[1, 2]
    w13 = W[1, 3]
    w23 = W[2, 3]
    x0 = errors[0]
    x1 = errors[1]
    x2 = errors[2]
    x3 = errors[3]
    s00 = spread[0]
    s01 = spread[1]
    s11 = spread[2]
    s02 = spread[3]
    s12 = spread[4]
    s22 = spread[5]
    s03 = spread[6]
    s13 = spread[7]
    s23 = spread[8]
    s33 = spread[9]
    for m in range(len(weight)):
        e0 = x0[m] - b0
        e1 = x1[m] - b1
        e2 = x2[m] - b2
        e3 = x3[m] - b3
        squared = (
            w00 * (e0 * e0 + s00[m])
            + w11 * (e1 * e1 + s11[m])
            + w22 * (e2 * e2 + s22[m])
            + w33 * (e3 * e3 + s33[m])
            + 2.0 * (w01 * (e0 * e1 + s01[m]) + w02 * (e0 * e2 + s02[m]) + w03 * (e0 * e3 + s03[m]))
            + 2.0 * (w12 * (e1 * e2 + s12[m]) + w13 * (e1 * e3 + s13[m]) + w23 * (e2 * e3 + s23[m]))
        )
        weight[m] = (dof + 4.0) / (dof + squared)


@compiled
def log_sum(values: FloatArray, factors: FloatArray, scratch: FloatArray) -> float:
    """Σ factor · ln value, of normal positive numbers, to 1e-12 a term; several at once, where
    math.log does one.

    ln(2ᵏ m) = k ln 2 + ln √2 + 2 artanh((m − √2)/(m + √2)), by seven terms of its series.

    Args:
        values, factors: [n].
        scratch: [2, n] at least.
    """
    bits = values.view(np.int64)
    split = scratch.view(np.int64)
    for m in range(len(values)):
        split[0, m] = (bits[m] & MANTISSA) | ONE
        split[1, m] = (bits[m] >> 52) | TO_52
    powers = rest = 0.0
    for m in range(len(values)):
        powers += factors[m] * (
            scratch[1, m] - (2.0**52 + 1023.0)
        )  # apart: another constant would be added to this
        t = (scratch[0, m] - ROOT_2) / (scratch[0, m] + ROOT_2)
        y = t * t
        series = 1.0 + y * (
            1 / 3 + y * (1 / 5 + y * (1 / 7 + y * (1 / 9 + y * (1 / 11 + y * (1 / 13)))))
        )
        rest += factors[m] * (0.5 * LOG_2 + 2.0 * t * series)
    return LOG_2 * powers + rest


@compiled
def floor(scale: FloatArray) -> None:
    """Make a matrix [4, 4], px², positive semidefinite but for rounding, positive definite in
    double precision."""
    least = LEAST_SIGMA_PX**2 + 1e-12 * (scale[0, 0] + scale[1, 1] + scale[2, 2] + scale[3, 3])
    for i in range(4):
        scale[i, i] += least


@compiled
def measure(
    scale: FloatArray, errors: FloatArray, squared: FloatArray, log_det: FloatArray
) -> None:
    """eᵀ Σ⁻¹ e and ln |Σ| of each of N errors, [N, 4], under its own scale, [N, 4, 4]; NaN where Σ
    is singular."""
    lower = np.zeros((4, 4))
    white = np.empty(4)
    for n in range(len(errors)):
        if not factor(scale[n], 4, lower):
            squared[n] = log_det[n] = np.nan
            continue
        squares = 0.0
        determinant = 1.0
        for i in range(4):
            white[i] = errors[n, i]
            for j in range(i):
                white[i] -= lower[i, j] * white[j]
            white[i] /= lower[i, i]
            squares += white[i] * white[i]
            determinant *= lower[i, i]
        squared[n] = squares
        log_det[n] = 2.0 * math.log(determinant)


@compiled
def _moments(
    errors: FloatArray,
    spread: FloatArray,
    bias: FloatArray,
    weight: FloatArray,
    first: FloatArray,
    second: FloatArray,
) -> float:
    """Σ w; ``first`` ← Σ w (e − b), ``second`` ← Σ w ((e − b)(e − b)ᵀ + S), its upper half."""
    b0, b1, b2, b3 = bias
    x0 = errors[0]
    x1 = errors[1]
    x2 = errors[2]
    x3 = errors[3]
    s00 = spread[0]
    s01 = spread[1]
    s11 = spread[2]
    s02 = spread[3]
    s12 = spread[4]
    s22 = spread[5]
    s03 = spread[6]
    s13 = spread[7]
    s23 = spread[8]
    s33 = spread[9]
    a00 = a01 = a02 = a03 = a11 = a12 = a13 = a22 = a23 = a33 = 0.0
    p0 = p1 = p2 = p3 = total = 0.0
    for m in range(len(weight)):
        w = weight[m]
        e0 = x0[m] - b0
        e1 = x1[m] - b1
        e2 = x2[m] - b2
        e3 = x3[m] - b3
        total += w
        p0 += w * e0
        p1 += w * e1
        p2 += w * e2
        p3 += w * e3
        a00 += w * (e0 * e0 + s00[m])
        a01 += w * (e0 * e1 + s01[m])
        a02 += w * (e0 * e2 + s02[m])
        a03 += w * (e0 * e3 + s03[m])
        a11 += w * (e1 * e1 + s11[m])
        a12 += w * (e1 * e2 + s12[m])
        a13 += w * (e1 * e3 + s13[m])
        a22 += w * (e2 * e2 + s22[m])
        a23 += w * (e2 * e3 + s23[m])
        a33 += w * (e3 * e3 + s33[m])
    first[0] = p0
    first[1] = p1
    first[2] = p2
    first[3] = p3
    second[0, 0] = a00
    second[1, 1] = a11
    second[2, 2] = a22
    second[3, 3] = a33
    second[0, 1] = a01
    second[0, 2] = a02
    second[0, 3] = a03
    second[1, 2] = a12
    second[1, 3] = a13
    second[2, 3] = a23
    return total


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
    """The scale is divided by Σ k w rather than Σ k (PX-EM; Liu, Rubin & Wu 1998): the same limit,
    far sooner.

    The prior counts as errors of weight one whose mean square is its scale.
    """
    prior_dof, counts, dof_counts, bias_counts = prior
    has_bias = robust and bias_counts < np.inf
    learns_dof = robust and dof_counts < np.inf
    prior_log_weight = -_dof_slope(prior_dof) if learns_dof else 0.0
    W = np.empty((4, 4))
    lower = np.zeros((4, 4))
    mean = np.zeros(4)
    most = 0
    for c in range(len(dof)):
        most = max(most, first[c + 1] - first[c])
    near = np.empty((4, most))
    doubt = np.zeros((10, most))
    weight_of = np.ones(most)
    scratch = np.empty((2, most))
    for c in range(len(dof)):
        S = scale[c]
        b = bias[c]
        nu = prior_dof
        copy_into(S, prior_scale)
        k = kernel[first[c] : first[c + 1]]
        weight = weight_of[: len(k)]
        _gather(errors, spread, index[first[c] : first[c + 1]], errors_of=near, spread_of=doubt)
        total = k.sum()
        for _ in range(iterations if total > 0.0 else 0):
            if not invert_symmetric_4(S, W, lower):
                break
            if robust:
                _weigh(near, doubt, b, W=W, dof=nu, weight=weight)
            log_weights = log_sum(weight, k, scratch) if learns_dof else 0.0
            for m in range(len(k)):
                weight[m] = k[m] * weight[m] if robust else k[m]
            weights = _moments(near, doubt, b, weight=weight, first=mean, second=S)
            for i in range(4):
                for j in range(i, 4):
                    S[i, j] = S[j, i] = (S[i, j] + counts * prior_scale[i, j]) / (weights + counts)
            if has_bias:
                for i in range(4):
                    b[i] += (
                        mean[i] / (weights + bias_counts)
                        - bias_counts / (weights + bias_counts) * b[i]
                    )
            if learns_dof:
                nu = _dof_of(
                    (log_weights - weights + dof_counts * prior_log_weight) / (total + dof_counts)
                )
        dof[c] = nu
