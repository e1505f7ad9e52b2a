"""Calibration of predicted covariances on data left out: one factor, and how often they hold."""

from __future__ import annotations

import numpy as np
from scipy.stats import chi2

from probevo.arrays import FloatArray
from probevo.geometry.uncertainty import squared_mahalanobis


def covariance_scale(errors: FloatArray, covariances: FloatArray) -> float:
    """Return the factor on all covariances that maximises the likelihood of these errors.

    The logarithm of N(φ; 0, s Σ), summed over N errors, has its maximum at
    s = 1/(N d) Σ φᵀ Σ⁻¹ φ. A consistent covariance has s = 1, an overconfident one a larger s.

    Args:
        errors: of data left out, [N, d].
        covariances: predicted for them, [N, d, d].
    """
    return float(np.mean(squared_mahalanobis(errors, covariances)) / errors.shape[-1])


def negative_log_likelihoods(errors: FloatArray, covariances: FloatArray) -> FloatArray:
    """Return ½ φᵀ Σ⁻¹ φ + ½ log|Σ|, [...]: without the constant d/2 log 2π, as published."""
    log_det = np.linalg.slogdet(covariances).logabsdet
    values: FloatArray = 0.5 * squared_mahalanobis(errors, covariances) + 0.5 * log_det
    return values


def coverage(errors: FloatArray, covariances: FloatArray, probability: float) -> float:
    """Return the share of errors within the ellipsoid that holds this share of a Gaussian's."""
    bound = chi2.ppf(probability, errors.shape[-1])
    return float(np.mean(squared_mahalanobis(errors, covariances) <= bound))
