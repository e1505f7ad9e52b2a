"""Compiled loops of the Student-t fits (see ``student_t_fit``).

The errors of a fit are gathered as rows, one row a coordinate, and the loops over them are written
out coordinate by coordinate, so that they run on several errors at once (SIMD).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled, copy_into, factor, invert_symmetric_4, sum_in_lanes
from probevo.noise.student_t_arrays import Neighborhoods, PackedErrors, StudentTBatch, StudentTPrior

MIN_DOF = 1.0
MAX_DOF = 200.0
"""Bounds of a fitted ν. Below, a mean carries no information; above, it is as a Gaussian."""
DOF_TOLERANCE = 1e-9
"""Accuracy of the root, of ln ν."""
MIN_SIGMA_PX = 1e-3
"""Standard deviation added to each axis, so that errors that are all zero, or all alike, still give
a distribution."""
MANTISSA = np.int64(2**52 - 1)
ONE = np.int64(1023 << 52)
"""Bits of the mantissa of a double, and the bits of 1.0."""
TO_52 = np.int64((1023 + 52) << 52)
"""Bits of 2⁵²: a small integer in the lowest bits adds to it exactly."""
ROOT_2 = math.sqrt(2.0)
LOG_2 = math.log(2.0)


class _Rows(NamedTuple):
    """The errors of one fit as rows; the arrays may be longer than the fit has errors."""

    errors: FloatArray
    """[4, n], px."""
    packed_cov: FloatArray
    """Lower triangle of each covariance, [10, n], px²; zero if the errors are exact."""


@compiled
def _dof_slope(dof: float) -> float:
    """Return the part of the derivative of the likelihood by ν that does not depend on the errors.

    The derivative is, but for a factor, this plus the mean of ln w − w. The digamma functions have
    cancelled: ψ(ν/2 + 2) − ψ(ν/2) = 2/ν + 2/(ν + 2).
    """
    return 1.0 + 2.0 / dof + 2.0 / (dof + 2.0) - math.log(1.0 + 4.0 / dof)


@compiled
def _dof_root(mean_log_weight: float) -> float:
    """Find the ν at which the derivative is zero, by false position in ln ν (Illinois algorithm).

    There is one root at most from MIN_DOF on. Without any within the bounds, the nearer bound is
    returned.

    Args:
        mean_log_weight: mean of ln w − w.
    """
    # Bracket the root; without a change of sign, the likelihood is largest at a bound.
    low = math.log(MIN_DOF)
    high = math.log(MAX_DOF)
    slope_at_low = _dof_slope(MIN_DOF) + mean_log_weight
    slope_at_high = _dof_slope(MAX_DOF) + mean_log_weight
    if slope_at_high >= 0.0:
        return MAX_DOF
    if slope_at_low <= 0.0:
        return MIN_DOF
    middle = low
    # The end that the last iteration has not moved: 1 the high one, −1 the low one.
    unchanged_end = 0
    for _ in range(60):
        prev_middle = middle
        middle = (low * slope_at_high - high * slope_at_low) / (slope_at_high - slope_at_low)
        if abs(middle - prev_middle) < DOF_TOLERANCE:
            break
        # The root is between low, where the derivative is positive, and high, where it is negative.
        # Illinois: halve the value at an end that stays for two iterations, so that both converge.
        slope = _dof_slope(math.exp(middle)) + mean_log_weight
        if slope > 0.0:
            low = middle
            slope_at_low = slope
            slope_at_high = slope_at_high * 0.5 if unchanged_end == 1 else slope_at_high
            unchanged_end = 1
        else:
            high = middle
            slope_at_high = slope
            slope_at_low = slope_at_low * 0.5 if unchanged_end == -1 else slope_at_low
            unchanged_end = -1
    return math.exp(middle)


@compiled
def _gather(samples: PackedErrors, members: IntArray, rows: _Rows) -> None:
    """Copy the errors of one fit, and their covariances, into rows."""
    for m in range(len(members)):
        for i in range(4):
            rows.errors[i, m] = samples.errors[members[m], i]
    if len(samples.packed_cov):
        for m in range(len(members)):
            for i in range(10):
                rows.packed_cov[i, m] = samples.packed_cov[members[m], i]


@compiled
def _weigh(rows: _Rows, bias: FloatArray, W: FloatArray, dof: float, weight: FloatArray) -> None:
    """Compute the weight w = (ν + d)/(ν + (e − b)ᵀ W (e − b) + tr W U) of each error.

    W = Σ⁻¹ is [4, 4]; U is the covariance of the error.
    """
    # Every entry has a name, so that the loop below contains no inner loop and vectorises. The
    # packed order is that of ``student_t_arrays.ROW`` and ``COLUMN``.
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
    x0 = rows.errors[0]
    x1 = rows.errors[1]
    x2 = rows.errors[2]
    x3 = rows.errors[3]
    u00 = rows.packed_cov[0]
    u01 = rows.packed_cov[1]
    u11 = rows.packed_cov[2]
    u02 = rows.packed_cov[3]
    u12 = rows.packed_cov[4]
    u22 = rows.packed_cov[5]
    u03 = rows.packed_cov[6]
    u13 = rows.packed_cov[7]
    u23 = rows.packed_cov[8]
    u33 = rows.packed_cov[9]
    for m in range(len(weight)):
        e0 = x0[m] - b0
        e1 = x1[m] - b1
        e2 = x2[m] - b2
        e3 = x3[m] - b3
        squared = (
            w00 * (e0 * e0 + u00[m])
            + w11 * (e1 * e1 + u11[m])
            + w22 * (e2 * e2 + u22[m])
            + w33 * (e3 * e3 + u33[m])
            + 2.0 * (w01 * (e0 * e1 + u01[m]) + w02 * (e0 * e2 + u02[m]) + w03 * (e0 * e3 + u03[m]))
            + 2.0 * (w12 * (e1 * e2 + u12[m]) + w13 * (e1 * e3 + u13[m]) + w23 * (e2 * e3 + u23[m]))
        )
        weight[m] = (dof + 4.0) / (dof + squared)


@compiled
def weighted_log_sum(values: FloatArray, factors: FloatArray, scratch: FloatArray) -> float:
    """Compute Σ factor · ln value of normal positive numbers, to 1e-12 a term.

    ``math.log`` takes one number at a time; this loop takes several:
    ln(2ᵏ m) = k ln 2 + ln √2 + 2 artanh((m − √2)/(m + √2)), with seven terms of the series.

    Args:
        values, factors: [n].
        scratch: work space, [2, n] at least.
    """
    # Split each number into its mantissa, as a double from 1 to 2, and its exponent, as 2⁵² + k,
    # by operations on integers only.
    bits = values.view(np.int64)
    split = scratch.view(np.int64)
    for m in range(len(values)):
        split[0, m] = (bits[m] & MANTISSA) | ONE
        split[1, m] = (bits[m] >> 52) | TO_52
    # The terms replace the parts, in loops of their own: a sum would keep them from vectorising.
    for m in range(len(values)):
        scratch[1, m] = factors[m] * (scratch[1, m] - (2.0**52 + 1023.0))
    for m in range(len(values)):
        # ln m, by the series of artanh around m = √2.
        t = (scratch[0, m] - ROOT_2) / (scratch[0, m] + ROOT_2)
        y = t * t
        series = 1.0 + y * (
            1 / 3 + y * (1 / 5 + y * (1 / 7 + y * (1 / 9 + y * (1 / 11 + y * (1 / 13)))))
        )
        scratch[0, m] = factors[m] * (0.5 * LOG_2 + 2.0 * t * series)
    powers = sum_in_lanes(scratch[1, : len(values)])
    rest = sum_in_lanes(scratch[0, : len(values)])
    return LOG_2 * powers + rest


@compiled
def regularize(scale: FloatArray) -> None:
    """Add to the diagonal of a matrix [4, 4], px², in place, what makes it positive definite.

    It is positive semidefinite but for rounding; the sum is so in double precision.
    """
    least = MIN_SIGMA_PX**2 + 1e-12 * (scale[0, 0] + scale[1, 1] + scale[2, 2] + scale[3, 3])
    for i in range(4):
        scale[i, i] += least


@compiled
def mahalanobis_and_log_det(
    scale: FloatArray, errors: FloatArray, squared: FloatArray, log_det: FloatArray
) -> None:
    """Fill in eᵀ Σ⁻¹ e and ln |Σ| of N errors [N, 4], each under its own Σ, [N, 4, 4].

    Both are NaN where Σ is singular.
    """
    lower = np.zeros((4, 4))
    white = np.empty(4)
    for n in range(len(errors)):
        if not factor(scale[n], 4, lower):
            squared[n] = np.nan
            log_det[n] = np.nan
            continue
        # Forward substitution: with Σ = L Lᵀ, the norm of L⁻¹ e is the Mahalanobis distance.
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
    rows: _Rows, bias: FloatArray, weight: FloatArray, first: FloatArray, second: FloatArray
) -> float:
    """Compute the weighted moments of the errors around the bias, and return Σ w.

    ``first`` becomes Σ w (e − b), [4]; ``second`` becomes the upper triangle of
    Σ w ((e − b)(e − b)ᵀ + U), [4, 4].
    """
    # As in ``_weigh``, every entry has a name, so that the loop vectorises.
    b0, b1, b2, b3 = bias
    x0 = rows.errors[0]
    x1 = rows.errors[1]
    x2 = rows.errors[2]
    x3 = rows.errors[3]
    u00 = rows.packed_cov[0]
    u01 = rows.packed_cov[1]
    u11 = rows.packed_cov[2]
    u02 = rows.packed_cov[3]
    u12 = rows.packed_cov[4]
    u22 = rows.packed_cov[5]
    u03 = rows.packed_cov[6]
    u13 = rows.packed_cov[7]
    u23 = rows.packed_cov[8]
    u33 = rows.packed_cov[9]
    # a: Σ w ((e − b)(e − b)ᵀ + U); p: Σ w (e − b).
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
        a00 += w * (e0 * e0 + u00[m])
        a01 += w * (e0 * e1 + u01[m])
        a02 += w * (e0 * e2 + u02[m])
        a03 += w * (e0 * e3 + u03[m])
        a11 += w * (e1 * e1 + u11[m])
        a12 += w * (e1 * e2 + u12[m])
        a13 += w * (e1 * e3 + u13[m])
        a22 += w * (e2 * e2 + u22[m])
        a23 += w * (e2 * e3 + u23[m])
        a33 += w * (e3 * e3 + u33[m])
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
    samples: PackedErrors,
    near: Neighborhoods,
    prior: StudentTPrior,
    iterations: int,
    robust: bool,
    fitted: StudentTBatch,
) -> None:
    """Fill in ``fitted`` with the fit to each neighbourhood.

    The scale is divided by Σ k w rather than Σ k (PX-EM; Liu, Rubin & Wu 1998), which takes far
    fewer iterations. Without a prior, the limit is the same. The prior counts as errors of weight
    one whose mean square is its scale; against Σ k w, it counts less than against Σ k where the
    errors are far smaller than it says, since their weights are then up to (ν + d)/ν.
    """
    has_bias = robust and prior.bias_counts < np.inf
    learns_dof = robust and prior.dof_counts < np.inf
    # Mean of ln w − w of the errors that the prior ν counts as: those for which it is the root.
    prior_mean_log_weight = -_dof_slope(prior.dof) if learns_dof else 0.0
    # Work space for the largest neighbourhood.
    W = np.empty((4, 4))
    lower = np.zeros((4, 4))
    first_moment = np.zeros(4)
    most = 0
    for c in range(len(fitted.dof)):
        most = max(most, near.first[c + 1] - near.first[c])
    rows = _Rows(np.empty((4, most)), np.zeros((10, most)))
    weight_of = np.ones(most)
    scratch = np.empty((2, most))
    for c in range(len(fitted.dof)):
        # Start from the prior.
        S = fitted.scale[c]
        b = fitted.bias[c]
        nu = prior.dof
        copy_into(S, prior.scale)
        k = near.kernel[near.first[c] : near.first[c + 1]]
        weight = weight_of[: len(k)]
        _gather(samples, near.members[near.first[c] : near.first[c + 1]], rows)
        sum_kernel = k.sum()
        for _ in range(iterations if sum_kernel > 0.0 else 0):
            if not invert_symmetric_4(S, W, lower):
                break
            # E-step: the weights, and Σ k ln w, on which the estimate of ν depends.
            if robust:
                _weigh(rows, b, W, dof=nu, weight=weight)
            sum_log_weights = weighted_log_sum(weight, k, scratch) if learns_dof else 0.0
            # From here on, weight is k w, or k as published.
            for m in range(len(k)):
                weight[m] = k[m] * weight[m] if robust else k[m]
            # M-step for the scale: second moment around the present bias, shrunk to the prior, Σ ←
            # (Σ k w ((e − b)(e − b)ᵀ + U) + n₀ Σ₀)/(Σ k w + n₀).
            sum_weights = _moments(rows, b, weight, first=first_moment, second=S)
            for i in range(4):
                for j in range(i, 4):
                    S[i, j] = S[j, i] = (S[i, j] + prior.counts * prior.scale[i, j]) / (
                        sum_weights + prior.counts
                    )
            # M-step for the bias, which shrinks to zero: b ← Σ k w e/(Σ k w + n_b). The moment is
            # around the previous b, hence the second term.
            if has_bias:
                for i in range(4):
                    b[i] += (
                        first_moment[i] / (sum_weights + prior.bias_counts)
                        - prior.bias_counts / (sum_weights + prior.bias_counts) * b[i]
                    )
            # M-step for ν, whose prior counts as further errors.
            if learns_dof:
                nu = _dof_root(
                    (sum_log_weights - sum_weights + prior.dof_counts * prior_mean_log_weight)
                    / (sum_kernel + prior.dof_counts)
                )
        fitted.dof[c] = nu
