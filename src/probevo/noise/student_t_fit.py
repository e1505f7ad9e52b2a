"""Fits of Student-t distributions to weighted errors, shrunk towards a prior, many at once.

A Student-t is a Gaussian whose precision has a Gamma distribution, which leads to the EM algorithm
of Liu & Rubin (1995). Given bias b, scale Σ and degrees of freedom ν, the E-step gives the error e
the expected precision, or weight,

    w = (ν + d)/(ν + (e − b)ᵀ Σ⁻¹ (e − b) + tr(Σ⁻¹ U)),        d = 4,

where U is the covariance of e (zero if it is known exactly). The M-step takes b and Σ as moments of
the errors under the weights k w, with k the kernel, and ν as the root of the derivative of the
likelihood. A prior counts as further errors of weight one, and the scale is the moment over Σ k w
(PX-EM). Without a prior, this converges to the maximum of the likelihood. With one, it is no
maximum a posteriori: the prior counts less where the errors are far smaller than it says. The
static model is a fit to all errors with k = 1; the generalized kernel fits the neighbours of each
place.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.noise.student_t_arrays import (
    COLUMN,
    DIM,
    ROW,
    Neighborhoods,
    PackedErrors,
    StudentTBatch,
    StudentTPrior,
)
from probevo.noise.student_t_numba import MIN_SIGMA_PX, fit_all

MAX_ERROR_PX = 1e12
"""Bound of the errors: squares of larger ones would overflow before long."""


def fit_student_ts(
    errors: FloatArray,
    near: Neighborhoods,
    prior: StudentTPrior,
    *,
    error_cov: FloatArray | None = None,
    iterations: int = 12,
    robust: bool = True,
) -> StudentTBatch:
    """Fit a Student-t to each of C neighbourhoods by EM.

    Args:
        errors: [N, 4], px.
        near: which errors contribute to each fit.
        prior: start of the iterations, towards which the fits shrink.
        error_cov: covariance U of each error, [N, 4, 4], px². In training it is the posterior
            covariance given an uncertain motion. None if the errors are known exactly.
        iterations: number of EM iterations.
        robust: use the weights of the E-step. Otherwise each fit is the posterior mean of an
            inverse Wishart, Ψ*/(ν₀ + Σk) (PROBE-GK eqs. (8), (9)), with bias and dof of the
            prior.

    Returns:
        C distributions, whose scales are positive definite in double precision.
    """
    count = len(near.first) - 1
    fitted = StudentTBatch(
        scale=np.empty((count, DIM, DIM)), dof=np.empty(count), bias=np.zeros((count, DIM))
    )
    if error_cov is None:
        packed_cov = np.zeros((0, len(ROW)))
    else:
        packed_cov = np.ascontiguousarray(error_cov[:, ROW, COLUMN], np.float64)
    # Contiguous arrays of one type each: the loop is compiled anew for every combination of types,
    # and a read-only array is of another type, hence the copy of the errors.
    samples = PackedErrors(np.array(errors, np.float64, order="C"), packed_cov)
    near = Neighborhoods(
        first=near.first.astype(np.int64),
        members=near.members.astype(np.int64),
        kernel=near.kernel.astype(np.float64),
    )
    prior = StudentTPrior(
        scale=regularized(np.asarray(prior.scale, np.float64)),
        dof=float(prior.dof),
        counts=float(prior.counts),
        dof_counts=float(prior.dof_counts),
        bias_counts=float(prior.bias_counts),
    )
    # The published variant has nothing to iterate: without weights, one M-step is the posterior
    # mean.
    fit_all(
        samples,
        near,
        prior,
        iterations=iterations if robust else 1,
        robust=robust,
        fitted=fitted,
    )
    # Again, since the sums of an M-step are positive semidefinite only up to rounding.
    return fitted._replace(scale=regularized(fitted.scale))


def regularized(scale: FloatArray) -> FloatArray:
    """Add to the diagonal of matrices [..., 4, 4], px², what makes them positive definite.

    They are positive semidefinite but for rounding; the sums are so in double precision.
    """
    least = MIN_SIGMA_PX**2 + 1e-12 * np.trace(scale, axis1=-2, axis2=-1)
    definite: FloatArray = scale + least[..., None, None] * np.eye(DIM)
    return definite


def fit_static(
    errors: FloatArray, error_cov: FloatArray | None = None, iterations: int = 50
) -> StudentTBatch:
    """Fit one Student-t without bias to all errors [N, 4], px: C = 1.

    Raises:
        InputError: there is no error, one is not finite, or a covariance is not.
    """
    check_errors(errors, error_cov)
    # Scale of the prior. The median of squares is hardly affected by the tails; for a Gaussian, it
    # is 0.45 σ².
    variance = 2.0 * float(np.median(errors**2, axis=0).mean())
    # Fewer than ten errors do not determine a scale matrix. Two pseudo-counts fix its size, and are
    # negligible against 5,000 errors.
    prior = StudentTPrior(
        scale=variance * np.eye(DIM), dof=5.0, counts=2.0, dof_counts=0.1, bias_counts=np.inf
    )
    near = Neighborhoods.of_all(len(errors))
    return fit_student_ts(errors, near, prior, error_cov=error_cov, iterations=iterations)


def check_errors(errors: FloatArray, error_cov: FloatArray | None = None) -> None:
    """Refuse errors to which no distribution can be fitted.

    Raises:
        InputError: a shape is wrong, there is no error, one is not finite or larger than
            ``MAX_ERROR_PX``, or its covariance is.
    """
    if errors.ndim != 2 or errors.shape[1] != DIM:
        raise InputError(
            "residuals", f"their shape is {errors.shape}, where [N, {DIM}] is expected."
        )
    if not len(errors):
        raise InputError("residuals", "there is none.", "Give at least one.")
    # NaN fails the comparison, too.
    valid = np.abs(errors) < MAX_ERROR_PX
    if not valid.all():
        row = int(np.argwhere(~valid)[0, 0])
        raise InputError(
            "residuals",
            f"the residual of feature {row} (from 0) is {errors[row]}.",
            "Leave out what is unknown.",
        )
    if error_cov is None:
        return
    if error_cov.shape != (len(errors), DIM, DIM):
        raise InputError(
            "error_cov",
            f"its shape is {error_cov.shape}, where {(len(errors), DIM, DIM)} is expected.",
        )
    if not (np.abs(error_cov) < MAX_ERROR_PX**2).all():
        raise InputError("error_cov", "it is not finite.", "Leave out what is unknown.")
