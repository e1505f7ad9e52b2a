"""Calibration of covariances: the factor of the likelihood, coverage within binomial bounds."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom, multivariate_normal

from probevo.geometry.uncertainty import squared_mahalanobis
from probevo.nets.covariance_scale import (
    covariance_scale,
    coverage,
    negative_log_likelihoods,
)

COUNT = 4000


@pytest.fixture(scope="module")
def covariances() -> np.ndarray:
    roots = np.random.default_rng(0).normal(size=(COUNT, 3, 3))
    return roots @ roots.mT + 0.1 * np.eye(3)


@pytest.fixture(scope="module")
def errors(covariances: np.ndarray) -> np.ndarray:
    """Errors that follow these covariances."""
    noise = np.random.default_rng(1).normal(size=(COUNT, 3, 1))
    return (np.linalg.cholesky(covariances) @ noise)[..., 0]


@pytest.mark.parametrize("factor", [0.04, 1.0, 9.0])
def test_the_scale_is_what_the_covariances_lack(
    factor: float, errors: np.ndarray, covariances: np.ndarray
) -> None:
    """χ² of 3 · 4000 degrees of freedom has a relative σ of 1.3 %."""
    scale = covariance_scale(errors, covariances / factor)
    assert scale == pytest.approx(factor, rel=0.05)


def test_no_other_factor_is_more_likely(errors: np.ndarray, covariances: np.ndarray) -> None:
    predicted = 0.3 * covariances
    best = covariance_scale(errors, predicted)
    at_best = negative_log_likelihoods(errors, best * predicted).mean()
    for factor in (0.9, 0.99, 1.01, 1.1):
        assert negative_log_likelihoods(errors, factor * best * predicted).mean() > at_best


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_coverage_is_the_probability_of_consistent_covariances(
    probability: float, errors: np.ndarray, covariances: np.ndarray
) -> None:
    low, high = binom.interval(0.999, COUNT, probability)
    assert low <= coverage(errors, covariances, probability) * COUNT <= high
    assert coverage(errors, 0.25 * covariances, probability) * COUNT < low


def test_the_likelihood_lacks_the_constant_alone(
    errors: np.ndarray, covariances: np.ndarray
) -> None:
    found = negative_log_likelihoods(errors[:20], covariances[:20])
    full = [-multivariate_normal(cov=covariances[k]).logpdf(errors[k]) for k in range(20)]
    assert found == pytest.approx(np.array(full) - 1.5 * np.log(2.0 * np.pi), rel=1e-9)


def test_distances_are_in_units_of_sigma() -> None:
    covariance = np.diag([4.0, 9.0, 1.0])[None]
    assert squared_mahalanobis(np.array([[2.0, 3.0, 0.0]]), covariance) == pytest.approx(2.0)
