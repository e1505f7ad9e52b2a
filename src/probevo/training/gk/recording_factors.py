"""How large the errors of each recording are, against one noise model for all.

Recordings differ in light, blur and texture, and so in the size of their errors. A single Student-t
for all would take these differences for heavy tails, and then trust outliers too much in each of
them. So the variances of the model are multiplied by a factor for each recording. The odometry
learns the factor of a new one while it runs (``estimation.noise_scale``).

The generalized kernel has factors, too, for the part that its predictors do not explain.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from probevo.arrays import FloatArray
from probevo.noise.base import StereoNoise
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.metric import Metric
from probevo.noise.student_t import StudentT
from probevo.noise.student_t_arrays import DIM
from probevo.noise.student_t_numba import MIN_SIGMA_PX
from probevo.training.gk.error_samples import ErrorSamples

ROUNDS = 4
"""Fits of model and factors in turn in an M-step. The next one goes on from there."""
SCALE_ITERATIONS = 20
"""Iterations for the factor of a recording under a given model."""


def recording_factors(training: Mapping[str, Any], num_recordings: int) -> FloatArray:
    """Return the factors that a training has found so far, [D]; 1 before its first iteration."""
    factors = training.get("recording_factors")
    return np.ones(num_recordings) if factors is None else np.array(factors)


def fit_with_factors(model: StudentT, samples: ErrorSamples, factors: FloatArray) -> FloatArray:
    """Fit a static model to the errors of D recordings, each divided by the size of its errors.

    Args:
        model: fitted in place.
        samples: the errors of N features.
        factors: the factors to begin with, [D].

    Returns:
        the new factors, [D], whose geometric mean over all features is 1.
    """
    if len(factors) == 1:
        model.fit(samples.phi, samples.errors, error_cov=samples.error_cov)
        return factors
    for _ in range(ROUNDS):
        comparable = _comparable(samples, factors)
        model.fit(comparable.phi, comparable.errors, error_cov=comparable.error_cov)
        factors = _likeliest_factors(model.predict(samples.phi), samples, factors)
    return factors


def fit_kernel_with_factors(
    model: GeneralizedKernel,
    samples: ErrorSamples,
    num_recordings: int,
    metric: Metric,
    on_progress: Callable[[int, int], None],
) -> FloatArray:
    """Fit a kernel to the errors of D recordings, each divided by what the predictors do not
    explain of their size.

    Every M-step begins with factors of 1, and has two fits. Where a predictor tells recordings
    apart, kernel and factors explain the difference between them equally well, and it is the kernel
    that is to learn it. Each further fit would leave it less of that, since its prior holds the
    kernel back, and nothing holds the factors back.

    Args:
        model: fitted in place; hyperparameters that are not given are chosen in the first fit.
        samples: the errors of N features.
        num_recordings: D.
        metric: names of the columns and their standardisation.
        on_progress: called as by ``GeneralizedKernel.fit``.

    Returns:
        the factors, [D], whose geometric mean over all features is 1. All are 1 as published, and
        where a bias is learned, which is in pixels however large the other errors are.
    """
    factors = np.ones(num_recordings)
    _fit_kernel(model, samples, metric, on_progress)
    if num_recordings == 1 or model.variant == "published" or model.shape_.bias_counts != np.inf:
        return factors
    factors = _likeliest_factors(model.predict(samples.phi), samples, factors)
    # The hyperparameters stay as they are, but for ν, which is always estimated.
    search = model.search_
    for name, value in model.shape_.as_given().items():
        setattr(model, name, value)
    model.weights = model.weights_
    _fit_kernel(model, _comparable(samples, factors), metric, on_progress)
    model.search_ = search | model.search_
    return _likeliest_factors(model.predict(samples.phi), samples, factors)


def _fit_kernel(
    model: GeneralizedKernel,
    samples: ErrorSamples,
    metric: Metric,
    on_progress: Callable[[int, int], None],
) -> None:
    """Fit a kernel to the errors as they are."""
    model.fit(
        samples.phi,
        samples.errors,
        samples.groups,
        error_cov=samples.error_cov,
        metric=metric,
        on_progress=on_progress,
    )


def _comparable(samples: ErrorSamples, factors: FloatArray) -> ErrorSamples:
    """Return the samples with errors as large as if the factor of each recording, [D], were 1."""
    feature_factors = factors[samples.drives]
    return replace(
        samples,
        errors=samples.errors / np.sqrt(feature_factors)[:, None],
        error_cov=samples.error_cov / feature_factors[:, None, None],
    )


def _likeliest_factors(
    noise: StereoNoise, samples: ErrorSamples, factors: FloatArray
) -> FloatArray:
    """Return the factor of each recording under which its errors are likeliest, [D], whose
    geometric mean over all features is 1.

    A recording without any feature keeps the one it has.

    Args:
        noise: that of the N features, where the factors are 1; without bias.
        samples: their errors.
        factors: the factors to begin with, [D].
    """
    inverse = np.linalg.inv(noise.scale)
    # Errors that are all zero count as those of the smallest σ, in pixels: the factor would fall
    # without end.
    least = MIN_SIGMA_PX**2 * np.trace(inverse, axis1=1, axis2=2) / DIM
    # eᵀ Σ⁻¹ e, and its expectation over what is uncertain of e
    squared = np.einsum("ni,nij,nj->n", samples.errors, inverse, samples.errors)
    squared += np.einsum("nij,nji->n", inverse, samples.error_cov)
    likeliest = factors.copy()
    for drive in np.unique(samples.drives):
        rows = np.flatnonzero(samples.drives == drive)
        least_factor = np.mean(least[rows])
        factor = factors[drive]
        # Weighted mean of the squares, with the weights of a Student-t (PX-EM)
        for _ in range(SCALE_ITERATIONS):
            weights = (noise.dof[rows] + DIM) / (noise.dof[rows] + squared[rows] / factor)
            factor = max(np.average(squared[rows], weights=weights) / DIM, least_factor)
        likeliest[drive] = factor
    counts = np.bincount(samples.drives, minlength=len(factors))
    normalized: FloatArray = likeliest / np.exp(np.average(np.log(likeliest), weights=counts))
    return normalized
