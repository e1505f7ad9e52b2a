"""The regression: its covariance holds for correlated errors, and outliers hardly count."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from probevo.arrays import FloatArray
from probevo.evaluation.clustered_regression import regress, two_sided_p

TRUE = np.array([0.3, -1.2])
WEAK = np.full(2, 1e3)


def sample(
    rng: np.random.Generator, frames: int, per_frame: int, common: float
) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Rows with white noise, and an error that all rows of a frame have in common."""
    frame = np.repeat(np.arange(frames), per_frame)
    design = np.column_stack([np.ones(len(frame)), rng.normal(size=len(frame))])
    noise = 0.2 * rng.normal(size=len(frame)) + common * rng.normal(size=frames)[frame]
    return design, design @ TRUE + noise, frame


@pytest.mark.parametrize("common", [0.0, 0.5])
def test_the_covariance_is_that_of_the_errors(common: float) -> None:
    """Mean NEES of 150 estimates of two coefficients, χ²; frames are few, so that it may be 15 %
    more."""
    rng = np.random.default_rng(0)
    trials = 150
    total = 0.0
    for _ in range(trials):
        found = regress(*sample(rng, 60, 8, common), prior_sigma=WEAK)
        error = found.values - TRUE
        total += float(error @ np.linalg.solve(found.cov, error))
    low, high = np.asarray(chi2.ppf([0.005, 0.995], 2 * trials)) / trials
    assert low < total / trials < 1.15 * high


def test_the_variances_are_those_of_errors_that_features_keep() -> None:
    """Each is seen in up to twelve of 24 frames. By frames alone, the squared errors of 100
    estimates are five times their variances in the mean."""
    rng = np.random.default_rng(3)
    frame = np.repeat(np.arange(24), 24)
    track = (2 * np.arange(24)[:, None] + np.arange(24)).ravel()
    squared = []
    for _ in range(100):
        of_track = rng.normal(size=track.max() + 1)
        design = np.column_stack([np.ones(len(frame)), of_track[track]])
        noise = 0.2 * rng.normal(size=len(frame)) + 0.2 * rng.normal(size=track.max() + 1)[track]
        kept = regress(design, design @ TRUE + noise, frame, prior_sigma=WEAK, track=track)
        lost = regress(design, design @ TRUE + noise, frame, prior_sigma=WEAK)
        assert (kept.sigma >= lost.sigma).all()
        squared.append(((kept.values - TRUE) / [kept.sigma, lost.sigma]) ** 2)
    by_track, by_frame = np.mean(squared, axis=(0, 2))
    assert by_track < 1.5
    assert by_frame > 4.0


def test_outliers_hardly_count() -> None:
    rng = np.random.default_rng(1)
    design, target, frame = sample(rng, 60, 8, 0.0)
    target[::10] += 50.0
    found = regress(design, target, frame, prior_sigma=WEAK)
    np.testing.assert_allclose(found.values, TRUE, atol=0.05)


def test_what_nothing_constrains_keeps_its_prior() -> None:
    rng = np.random.default_rng(2)
    design, target, frame = sample(rng, 60, 8, 0.0)
    found = regress(
        np.column_stack([design, np.zeros(len(design))]),
        target,
        frame,
        prior_sigma=np.r_[WEAK, 3.0],
    )
    assert found.values[2] == 0.0
    assert found.sigma[2] == pytest.approx(3.0)


def test_two_sided_p() -> None:
    assert two_sided_p(1.959964, 1e9) == pytest.approx(0.05, rel=1e-4)
    assert two_sided_p(-2.228139, 10) == pytest.approx(0.05, rel=1e-4)
