"""Student-t distributions fitted to weighted errors, many at once (EM; Liu & Rubin 1995).

One pass serves them all: the static model is a fit to all errors alike, a generalized kernel one to
the neighbours of
each place, with a prior that counts as so many errors seen before. The E-step gives every error the
weight w = (ν + d)/(ν + eᵀΣ⁻¹e); the M-step takes bias and scale as means under k w, k the kernel,
and ν as the root of the likelihood's derivative.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.noise.student_t_numba import LEAST_SIGMA_PX, fit_all

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
    """Finite, if the fit is to be robust."""
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

    @cached_property
    def mixable(self) -> NDArray[np.float32]:
        """Numbers whose every mean is a distribution: bias [4], Cholesky factor [10], and ln ν, [C,
        15].

        The factor is as by ``tril_indices``, with ln of its diagonal.
        """
        row, column = np.tril_indices(DIM)
        lower = np.linalg.cholesky(self.scale)[:, row, column]
        lower[:, row == column] = np.log(lower[:, row == column])
        return np.ascontiguousarray(
            np.column_stack([self.bias, lower, np.log(self.dof)]), np.float32
        )


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
        spread: covariance of what is not known of each error, [N, 4, 4], px²: in EM, what the doubt
            about the motion makes of it. None is exact.
        iterations: of EM.
        robust: weigh the errors; if not, this is the posterior mean of an inverse Wishart, Ψ*/(ν₀ +
            Σk) (PROBE-GK eqs. 8, 9), and bias and dof stay those of the prior.
    """
    count = len(near.first) - 1
    scale = np.empty((count, DIM, DIM))
    dof = np.empty(count)
    bias = np.zeros((count, DIM))
    fit_all(
        np.array(
            errors, np.float64, order="C"
        ),  # a copy: read-only arrays are of another type, compiled for again
        np.zeros((0, 10))
        if spread is None
        else np.ascontiguousarray(spread[:, _ROW, _COLUMN], np.float64),
        near.first.astype(np.int64),
        index=near.index.astype(np.int64),
        kernel=near.kernel.astype(np.float64),
        prior_scale=floored(np.asarray(prior.scale, np.float64)),
        prior=(
            float(prior.dof),
            float(prior.counts),
            float(prior.dof_counts),
            float(prior.bias_counts),
        ),
        iterations=iterations if robust else 1,
        robust=robust,
        scale=scale,
        dof=dof,
        bias=bias,
    )
    return Students(floored(scale), dof, bias)


def floored(scale: FloatArray) -> FloatArray:
    """Matrices [..., 4, 4], px², positive semidefinite but for rounding, made positive definite in
    double precision."""
    least = LEAST_SIGMA_PX**2 + 1e-12 * np.trace(scale, axis1=-2, axis2=-1)
    floor: FloatArray = scale + least[..., None, None] * np.eye(DIM)
    return floor


def fit_static(
    errors: FloatArray, spread: FloatArray | None = None, iterations: int = 50
) -> Students:
    """The one Student-t of all errors [N, 4], px, without bias: C = 1.

    Raises:
        InputError: there is no error, one is not finite, or a spread is not.
    """
    check_errors(errors, spread)
    variance = 2.0 * float(
        np.median(errors**2, axis=0).mean()
    )  # nearly that of a Gaussian, tails left aside
    # Fewer than ten errors fix no scale matrix. Two more tell of its size; of 5,000, they are not
    # noticed.
    prior = StudentPrior(
        variance * np.eye(DIM), dof=5.0, counts=2.0, dof_counts=0.1, bias_counts=np.inf
    )
    return fit_students(
        errors, Neighborhoods.all_of(len(errors)), prior, spread=spread, iterations=iterations
    )


def check_errors(errors: FloatArray, spread: FloatArray | None = None) -> None:
    """Refuse what no distribution can be fitted to.

    Raises:
        InputError: a shape is wrong, there is no error, or one is not finite or absurd, or its
            spread is not finite.
    """
    if errors.ndim != 2 or errors.shape[1] != DIM:
        raise InputError(
            "residuals", f"their shape is {errors.shape}, where [N, {DIM}] is expected."
        )
    if not len(errors):
        raise InputError("residuals", "there is none.", "Give at least one.")
    known = np.abs(errors) < MOST_PX
    if not known.all():
        row = int(np.argwhere(~known)[0, 0])
        raise InputError(
            "residuals",
            f"that of feature {row} (from 0) is {errors[row]}.",
            "Leave out what is unknown.",
        )
    if spread is None:
        return
    if spread.shape != (len(errors), DIM, DIM):
        expected = f"{(len(errors), DIM, DIM)} is expected"
        raise InputError("spread", f"its shape is {spread.shape}, where {expected}.")
    if not (np.abs(spread) < MOST_PX**2).all():
        raise InputError("spread", "it is not finite.", "Leave out what is unknown.")
