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
MOST_PX = 1e12
"""No error is larger: its square would overflow before long."""
DIM = 4
_ROW, _COLUMN = np.tril_indices(DIM)


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
    _fit(
        np.ascontiguousarray(errors, np.float64),
        np.zeros((0, 10)) if spread is None else np.ascontiguousarray(spread[:, _ROW, _COLUMN], np.float64),
        near.first.astype(np.int64),
        near.index.astype(np.int64),
        near.kernel.astype(np.float64),
        floored(np.asarray(prior.scale, np.float64)),
        (float(prior.dof), float(prior.counts), float(prior.dof_counts), float(prior.bias_counts)),
        iterations if robust else 1,
        robust,
        scale,
        dof,
        bias,
    )
    return Students(floored(scale), dof, bias)


def floored(scale: FloatArray) -> FloatArray:
    """Matrices [..., 4, 4], px², positive semidefinite but for rounding, made positive definite in double precision."""
    least = LEAST_SIGMA_PX**2 + 1e-12 * np.trace(scale, axis1=-2, axis2=-1)
    floor: FloatArray = scale + least[..., None, None] * np.eye(DIM)
    return floor


def fit_static(errors: FloatArray, spread: FloatArray | None = None, iterations: int = 50) -> Students:
    """The one Student-t of all errors [N, 4], px, without bias: C = 1.

    Raises:
        InputError: there is no error, one is not finite, or a spread is not.
    """
    check_errors(errors, spread)
    start = np.diag(np.maximum(np.median(errors**2, axis=0), LEAST_SIGMA_PX**2))
    # The prior counts as a hundredth of an error: enough for a distribution, too little to be noticed.
    prior = StudentPrior(start, dof=5.0, counts=0.01, dof_counts=0.01, bias_counts=np.inf)
    return fit_students(errors, Neighborhoods.all_of(len(errors)), prior, spread=spread, iterations=iterations)


def check_errors(errors: FloatArray, spread: FloatArray | None = None) -> None:
    """Refuse what no distribution can be fitted to.

    Raises:
        InputError: a shape is wrong, there is no error, or one is not finite or absurd, or its spread is not finite.
    """
    if errors.ndim != 2 or errors.shape[1] != DIM:
        raise InputError("residuals", f"their shape is {errors.shape}, where [N, {DIM}] is expected.")
    if not len(errors):
        raise InputError("residuals", "there is none.", "Give at least one.")
    known = np.abs(errors) < MOST_PX
    if not known.all():
        row = int(np.argwhere(~known)[0, 0])
        raise InputError("residuals", f"that of feature {row} (from 0) is {errors[row]}.", "Leave out what is unknown.")
    if spread is None:
        return
    if spread.shape != (len(errors), DIM, DIM):
        expected = f"{(len(errors), DIM, DIM)} is expected"
        raise InputError("spread", f"its shape is {spread.shape}, where {expected}.")
    if not (np.abs(spread) < MOST_PX**2).all():
        raise InputError("spread", "it is not finite.", "Leave out what is unknown.")


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
    """The scale is divided by Σ k w rather than Σ k (PX-EM; Liu, Rubin & Wu 1998): the same limit, far sooner."""
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
