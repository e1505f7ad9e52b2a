"""Autoregressive models: known ones are found, and the innovations give the series back."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.evaluation.autoregression import fit_autoregression, innovations, series_of

MODELS = [[1.0, -0.6], [1.0, 0.5], [1.0, -0.9, 0.5]]


@pytest.mark.parametrize("model", MODELS)
def test_a_known_model_is_found(model: list[float]) -> None:
    """The criterion may choose some orders more, whose coefficients are then small."""
    rng = np.random.default_rng(0)
    count = 20000
    found = fit_autoregression(series_of(np.array(model), rng.normal(size=count)))
    expected = np.zeros(max(len(found), len(model)))
    expected[: len(model)] = model
    found = np.append(found, np.zeros(len(expected) - len(found)))
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=4.0 / np.sqrt(count))


@pytest.mark.parametrize("model", MODELS)
def test_the_innovations_give_the_series_back(model: list[float]) -> None:
    series = np.random.default_rng(1).normal(size=(3, 50))
    again = series_of(np.array(model), innovations(np.array(model), series))
    np.testing.assert_allclose(again, series, rtol=0.0, atol=1e-12)


def test_a_moving_average_whose_steps_cancel_has_almost_no_spectrum_at_zero() -> None:
    """That of n(k) − 0.9 n(k−1) is 0.01, where the variance of the series is 1.81."""
    noise = np.random.default_rng(2).normal(size=2001)
    series = noise[1:] - 0.9 * noise[:-1]
    model = fit_autoregression(series)
    variance = np.mean(innovations(model, series) ** 2)
    assert variance / model.sum() ** 2 < 0.05


def test_a_constant_is_a_mean_and_no_correlation() -> None:
    assert len(fit_autoregression(np.full(50, 0.3))) == 1
    assert len(fit_autoregression(np.zeros(50))) == 1
    rng = np.random.default_rng(3)
    offset = [len(fit_autoregression(2.0 + rng.normal(size=100))) for _ in range(100)]
    assert np.median(offset) == 1


def test_the_correlation_of_a_short_series_is_hardly_underestimated() -> None:
    """With a mean that is estimated, +0.6 would be 0.06 less in 60 values (Kendall 1954)."""
    rng = np.random.default_rng(4)
    found = []
    for _ in range(300):
        series = series_of(np.array([1.0, -0.6]), rng.normal(size=110))[50:]
        found.append(-fit_autoregression(series)[1:2].sum())
    assert np.median(found) == pytest.approx(0.6, abs=0.03)


def test_a_series_that_its_past_predicts_has_finite_coefficients() -> None:
    alternating = np.where(np.arange(60) % 2, -1.0, 1.0)
    np.testing.assert_allclose(fit_autoregression(alternating)[:2], [1.0, 1.0], atol=1e-6)
