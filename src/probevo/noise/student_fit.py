"""Student-t distributions fitted to weighted errors, many at once (EM; Liu & Rubin 1995).

One pass serves them all: the static model is a fit to all errors alike, a generalized kernel one to the neighbours of
each place, with a prior that counts as so many errors seen before. The E-step gives every error the weight
w = (ν + d)/(ν + eᵀΣ⁻¹e); the M-step takes bias and scale as means under k w, k the kernel, and ν as the root of the
likelihood's derivative.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled, invert_symmetric_4
from probevo.errors import InputError

LEAST_DOF, MOST_DOF = 1.0, 200.0
"""Of a fit: below, a mean says nothing; above, the data cannot tell it from a Gaussian."""
LEAST_SIGMA_PX = 1e-3
"""No error is known better: added to each axis, so that errors that are all zero, or all alike, leave a distribution."""
DIM = 4


@dataclass(frozen=True)
class StudentPrior:
    """What is believed before any error is seen, and how many errors the belief counts for."""

    scale: FloatArray
    """[4, 4], px²."""
    dof: float
    counts: float
    """For scale."""
    dof_counts: float
    """For the degrees of freedom; np.inf holds them."""
    bias_counts: float
    """For the bias, which is zero; np.inf holds it there."""


@dataclass(frozen=True)
class Students:
    """C distributions."""

    scale: FloatArray
    """[C, 4, 4], px²."""
    dof: FloatArray
    """[C]."""
    bias: FloatArray
    """[C, 4], px."""


@dataclass(frozen=True)
class Neighborhoods:
    """Which errors each of C fits sees, and with what kernel."""

    first: IntArray
    """Where the errors of each begin, and the end of the last, [C + 1]."""
    index: IntArray
    """Of the errors, one fit after another, [n]."""
    kernel: FloatArray
    """k of each, 0 … 1, [n]."""

    @staticmethod
    def all_of(count: int) -> Neighborhoods:
        """One fit, to all errors alike."""
        return Neighborhoods(np.array([0, count]), np.arange(count), np.ones(count))

    @property
    def counts(self) -> FloatArray:
        """Σ k of each, [C]."""
        sums = np.concatenate([[0.0], np.cumsum(self.kernel)])
        counts: FloatArray = np.diff(sums[self.first])
        return counts


def fit_students(
    errors: FloatArray,
    near: Neighborhoods,
    prior: StudentPrior,
    *,
    spread: FloatArray | None = None,
    iterations: int = 12,
    robust: bool = True,
) -> Students:
    """A Student-t for each of C neighbourhoods.

    Args:
        errors: [N, 4], px.
        near: which errors each sees.
        prior: what it starts from, and shrinks towards.
        spread: covariance of what is not known of each error, [N, 4, 4], px²: in EM, what the doubt about the motion
            makes of it. None is exact.
        iterations: of EM.
        robust: weigh the errors; if not, this is the posterior mean of an inverse Wishart, Ψ*/(ν₀ + Σk)
            (PROBE-GK eqs. 8, 9), and bias and dof stay those of the prior.
    """
    count = len(near.first) - 1
    scale, dof, bias = np.empty((count, DIM, DIM)), np.empty(count), np.zeros((count, DIM))
    floor = LEAST_SIGMA_PX**2 * np.eye(DIM)
    _fit(
        np.ascontiguousarray(errors, np.float64),
        np.zeros((0, DIM, DIM)) if spread is None else np.ascontiguousarray(spread, np.float64),
        near.first.astype(np.int64),
        near.index.astype(np.int64),
        near.kernel.astype(np.float64),
        np.ascontiguousarray(prior.scale, np.float64) + floor,
        (float(prior.dof), float(prior.counts), float(prior.dof_counts), float(prior.bias_counts)),
        iterations if robust else 1,
        robust,
        scale,
        dof,
        bias,
    )
    return Students(scale + floor, dof, bias)


def fit_static(errors: FloatArray, spread: FloatArray | None = None, iterations: int = 50) -> Students:
    """The one Student-t of all errors [N, 4], px, without bias: C = 1.

    Raises:
        InputError: there is no error, or one is not finite.
    """
    check_errors(errors)
    start = np.diag(np.maximum(np.median(errors**2, axis=0), LEAST_SIGMA_PX**2))
    # The prior counts as a hundredth of an error: enough for a distribution, too little to be noticed.
    prior = StudentPrior(start, dof=5.0, counts=0.01, dof_counts=0.01, bias_counts=np.inf)
    return fit_students(errors, Neighborhoods.all_of(len(errors)), prior, spread=spread, iterations=iterations)


def check_errors(errors: FloatArray) -> None:
    """Refuse what no distribution can be fitted to.

    Raises:
        InputError: the shape is wrong, there is no error, or one is not finite.
    """
    if errors.ndim != 2 or errors.shape[1] != DIM:
        raise InputError("residuals", f"their shape is {errors.shape}, where [N, {DIM}] is expected.")
    if not len(errors):
        raise InputError("residuals", "there is none.", "Give at least one.")
    if not np.isfinite(errors).all():
        row = int(np.argwhere(~np.isfinite(errors))[0, 0])
        raise InputError("residuals", f"that of feature {row} (from 0) is {errors[row]}.", "Leave out what is unknown.")


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
    low, high = math.log(1.0), math.log(200.0)
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
def _fit(
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
    prior_dof, counts, dof_counts, bias_counts = prior
    has_spread, has_bias = len(spread) > 0, bias_counts < np.inf
    prior_log_weight = -_dof_slope(prior_dof)
    W, lower, A = np.empty((4, 4)), np.zeros((4, 4)), np.empty((4, 4))
    e, pulled = np.empty(4), np.empty(4)
    for c in range(len(dof)):
        S, b, nu = scale[c], bias[c], prior_dof
        S[:] = prior_scale
        total = 0.0
        for m in range(first[c], first[c + 1]):
            total += kernel[m]
        for _ in range(iterations if total > 0.0 else 0):
            if not invert_symmetric_4(S, W, lower):
                break
            for i in range(4):
                pulled[i] = 0.0
                for j in range(4):
                    A[i, j] = counts * prior_scale[i, j]
            weights, log_weights = 0.0, 0.0
            for m in range(first[c], first[c + 1]):
                n, w, s = index[m], 1.0, 0.0
                for i in range(4):
                    e[i] = errors[n, i] - b[i]
                if robust:
                    for i in range(4):
                        row = 0.0
                        for j in range(4):
                            row += W[i, j] * e[j]
                            if has_spread:
                                s += W[i, j] * spread[n, i, j]
                        s += row * e[i]
                    w = (nu + 4.0) / (nu + s)
                    log_weights += kernel[m] * (math.log(w) - w)
                w *= kernel[m]
                weights += w
                for i in range(4):
                    pulled[i] += w * errors[n, i]
                    for j in range(i + 1):
                        A[i, j] += w * (e[i] * e[j] + (spread[n, i, j] if has_spread else 0.0))
            for i in range(4):
                for j in range(i + 1):
                    S[i, j] = S[j, i] = A[i, j] / (counts + total)
                if has_bias:
                    b[i] = pulled[i] / (weights + bias_counts)
            if robust and dof_counts < np.inf:
                nu = _dof_of((log_weights + dof_counts * prior_log_weight) / (total + dof_counts))
        dof[c] = nu
