"""The regression: its covariance holds for correlated errors, and outliers hardly count."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import chi2

from probevo.arrays import FloatArray
from probevo.evaluation.clustered_regression import regress, two_sided_p

TRUE = np.array([0.3, -1.2])
WEAK = np.full(2, 1e3)


def sample(
    rng: np.random.Generator, frames: int, per_frame: int, *, common: float, kept: float = 0.0
) -> tuple[FloatArray, FloatArray, np.ndarray]:
    """Rows with white noise, and an error that all rows of a frame have in common, of which it
    keeps a share to the next one."""
    frame = np.repeat(np.arange(frames), per_frame)
    design = np.column_stack([np.ones(len(frame)), rng.normal(size=len(frame))])
    of_frame = rng.normal(size=frames)
    for k in range(1, frames):
        of_frame[k] = kept * of_frame[k - 1] + np.sqrt(1.0 - kept**2) * of_frame[k]
    noise = 0.2 * rng.normal(size=len(frame)) + common * of_frame[frame]
    return design, design @ TRUE + noise, frame


def p_values_of_errors(
    trials: int, frames: int, *, common: float, kept: float = 0.0, seed: int = 0
) -> FloatArray:
    """Probabilities of errors at least as large as those of two coefficients, [trials, 2]."""
    rng = np.random.default_rng(seed)
    p_values = np.empty((trials, 2))
    for trial in range(trials):
        rows = sample(rng, frames, 8, common=common, kept=kept)
        found = regress(*rows, prior_sigma=WEAK)
        errors = zip(found.values - TRUE, found.sigma, strict=True)
        p_values[trial] = [found.p_value(error, sigma) for error, sigma in errors]
    return p_values


@pytest.mark.parametrize(("common", "kept"), [(0.0, 0.0), (0.5, 0.0), (0.5, 0.8)])
def test_errors_are_as_probable_as_they_are_said_to_be(common: float, kept: float) -> None:
    """Mean square of 150 errors of two coefficients as the normal variables that are as improbable,
    χ²; frames are few, so that it may be 15 % more. With errors that frames keep, it was twice."""
    trials = 150
    z = ndtri(0.5 * p_values_of_errors(trials, 60, common=common, kept=kept))
    low, high = np.asarray(chi2.ppf([0.005, 0.995], 2 * trials)) / (2 * trials)
    assert low < np.mean(z**2) < 1.15 * high


@pytest.mark.parametrize("kept", [0.8, 0.9])
def test_errors_that_frames_keep_are_hardly_taken_for_wrong_coefficients(kept: float) -> None:
    """At the level of one of eight quantities, in 300 recordings of 100 frames: by the
    autocovariances over four frames, 6 and 15 % were."""
    p_values = p_values_of_errors(300, 100, common=0.5, kept=kept)
    assert np.mean(p_values[:, 0] < 0.01 / 8) < 0.03


def test_of_few_frames_chance_is_taken_for_an_error_no_more_often_than_promised() -> None:
    """Of 15: by the scatter of the frames alone, one in ten was at a level of 5 %."""
    p_values = p_values_of_errors(300, 15, common=0.0)
    assert 0.02 < np.mean(p_values < 0.05) < 0.08


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
    design, target, frame = sample(rng, 60, 8, common=0.0)
    target[::10] += 50.0
    found = regress(design, target, frame, prior_sigma=WEAK)
    np.testing.assert_allclose(found.values, TRUE, atol=0.05)


def test_what_nothing_constrains_keeps_its_prior() -> None:
    rng = np.random.default_rng(2)
    design, target, frame = sample(rng, 60, 8, common=0.0)
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
