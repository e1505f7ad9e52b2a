"""How large the errors of each recording are, against one static noise model for all.

Recordings differ in light, blur and texture, and so in the size of their errors. A single Student-t
for all would take these differences for heavy tails, and then trust outliers too much in each of
them. So the variances of the model are multiplied by a factor for each recording. The odometry
learns the factor of a new one while it runs (``estimation.noise_scale``).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from probevo.arrays import FloatArray
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
    counts = np.bincount(samples.drives, minlength=len(factors))
    for _ in range(ROUNDS):
        feature_factors = factors[samples.drives]
        model.fit(
            samples.phi,
            samples.errors / np.sqrt(feature_factors)[:, None],
            error_cov=samples.error_cov / feature_factors[:, None, None],
        )
        factors = _likeliest_factors(model, samples, factors)
        factors = factors / np.exp(np.average(np.log(factors), weights=counts))
    return factors


def _likeliest_factors(model: StudentT, samples: ErrorSamples, factors: FloatArray) -> FloatArray:
    """Return the factor of each recording under which its errors are likeliest, [D].

    A recording without any feature keeps the one it has.
    """
    inverse = np.linalg.inv(model.scale_)
    # Errors that are all zero count as those of the smallest σ, in pixels: the factor would fall
    # without end.
    least = MIN_SIGMA_PX**2 * float(np.trace(inverse)) / DIM
    # eᵀ Σ⁻¹ e, and its expectation over what is uncertain of e
    squared = np.einsum("ni,ij,nj->n", samples.errors, inverse, samples.errors)
    squared += np.einsum("ij,nji->n", inverse, samples.error_cov)
    likeliest = factors.copy()
    for drive in np.unique(samples.drives):
        drive_squared = squared[samples.drives == drive]
        factor = factors[drive]
        # Weighted mean of the squares, with the weights of a Student-t (PX-EM)
        for _ in range(SCALE_ITERATIONS):
            weights = (model.dof_ + DIM) / (model.dof_ + drive_squared / factor)
            factor = max(np.average(drive_squared, weights=weights) / DIM, least)
        likeliest[drive] = factor
    return likeliest
