"""The paired test: equally good runs hardly differ, and a better one is found.

How one knows that it works: of pairs of equally good runs, at most 5 to 7 % are found to differ,
whether the errors of steps are independent, alike (an autoregression of +0.6), or correct each
other (a moving average of −0.9, as along the live path of a window). And where one run has three
times the noise of the other, its drift over 100 steps is found to be larger, in each of these
cases.
"""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable
from dataclasses import astuple

import numpy as np
import pytest
from scipy.stats import binom

from probevo.arrays import FloatArray
from probevo.evaluation import paired_test
from probevo.evaluation.autoregression import series_of
from probevo.evaluation.metrics import evaluate
from probevo.evaluation.paired_test import (
    ERRORS,
    MIN_STEPS,
    exchanged_differences,
    paired_differences,
    random_signs,
)
from probevo.geometry import se3

SIGMA = np.array([0.01, 0.01, 0.02, 3e-4, 3e-4, 3e-4])
STEP = np.array([0.0, 0.0, -1.2, 0.0, 0.005, 0.0])


def true_motions(count: int) -> FloatArray:
    return se3.exp(np.tile(STEP, (count, 1)))


def independent(count: int, rng: np.random.Generator) -> FloatArray:
    """Errors of steps over their standard deviation, [count, 6]."""
    return rng.normal(size=(count, 6))


def alike(count: int, rng: np.random.Generator) -> FloatArray:
    """An autoregression of +0.6, after a start of 50 steps."""
    series = series_of(np.array([1.0, -0.6]), 0.8 * rng.normal(size=(6, count + 50)))
    return series[:, 50:].T


def correcting(count: int, rng: np.random.Generator) -> FloatArray:
    """Return errors of steps that each undo 0.9 of the noise of the one before."""
    noise = rng.normal(size=(count + 1, 6))
    return noise[1:] - 0.9 * noise[:-1]


def lasting(count: int, rng: np.random.Generator) -> FloatArray:
    """Add an autoregression of +0.9 with a third of the variance, as of features seen for long."""
    series = series_of(np.array([1.0, -0.9]), 0.26 * rng.normal(size=(6, count + 100)))
    return 0.8 * rng.normal(size=(count, 6)) + series[:, 100:].T


Errors = Callable[[int, np.random.Generator], FloatArray]


def noisy(
    T: FloatArray,
    rng: np.random.Generator,
    factor: float = 1.0,
    errors: Errors = independent,
) -> FloatArray:
    return se3.exp(factor * SIGMA * errors(len(T), rng)) @ T


@pytest.mark.parametrize("errors", [independent, alike, correcting, lasting])
def test_the_level_of_the_test_holds(errors: Errors) -> None:
    """Of 100 pairs of equally good runs, so many differ that 7 % is not refuted."""
    trials = 100
    T = true_motions(60)
    truth = se3.chain_motions(T)
    count = dict.fromkeys(ERRORS, 0)
    rng = np.random.default_rng(5)
    for _ in range(trials):
        a = noisy(T, rng, errors=errors)
        b = noisy(T, rng, errors=errors)
        found = paired_differences(a, b, truth, rng, draws=19)
        for name in ERRORS:
            count[name] += found[name].is_significant
    highest = binom.ppf(0.995, trials, 0.07)
    assert max(count.values()) <= highest, count
    assert sum(count.values()) > 0, count  # it does not always say no


@pytest.mark.parametrize("errors", [independent, alike, correcting])
def test_a_run_of_three_times_the_noise_is_found_to_drift_more(errors: Errors) -> None:
    """Of 20 pairs, so many differ that a power of 95 % is not refuted."""
    trials = 20
    T = true_motions(100)
    truth = se3.chain_motions(T)
    count = dict.fromkeys(("short_t_percent", "short_r_deg_per_m"), 0)
    rng = np.random.default_rng(8)
    for _ in range(trials):
        a = noisy(T, rng, errors=errors)
        b = noisy(T, rng, 3.0, errors)
        found = paired_differences(a, b, truth, rng, draws=39)
        for name in count:
            count[name] += found[name].is_significant and found[name].error_a < found[name].error_b
    assert min(count.values()) >= binom.ppf(0.005, trials, 0.95), count


def test_a_run_that_turns_too_far_is_found_and_its_reduction_is_that_of_the_errors() -> None:
    rng = np.random.default_rng(0)
    T = true_motions(60)
    good = noisy(T, rng)
    bad = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.001, 0.0])) @ noisy(T, rng)
    truth = se3.exp(np.array([5.0, -3.0, 2.0, 0.4, 1.0, -0.2])) @ se3.chain_motions(T)
    found = paired_differences(good, bad, truth, rng, draws=199)["short_r_deg_per_m"]
    assert found.is_significant
    errors = [
        evaluate(se3.chain_motions(motions), truth).short_r_deg_per_m for motions in (good, bad)
    ]
    assert [found.error_a, found.error_b] == pytest.approx(errors, rel=1e-9)
    value, low, high = found.reduction_percent
    assert value == pytest.approx(100.0 * (1.0 - found.error_a / found.error_b))
    assert 0.0 < low < value < high


def test_all_figures_are_those_of_the_metrics() -> None:
    """With the truth of some frames unknown, too."""
    rng = np.random.default_rng(1)
    T = true_motions(40)
    a = noisy(T, rng)
    b = noisy(T, rng)
    truth = se3.chain_motions(T)
    truth[[0, 7, 8, 39]] = np.nan
    found = paired_differences(a, b, truth, rng, draws=9)
    metrics = evaluate(se3.chain_motions(a), truth)
    assert {name: found[name].error_a for name in ERRORS} == pytest.approx(
        {name: getattr(metrics, name) for name in ERRORS}, rel=1e-9
    )


def test_equal_runs_do_not_differ() -> None:
    T = true_motions(MIN_STEPS)
    found = paired_differences(T, T, se3.chain_motions(T), np.random.default_rng(0), draws=19)
    assert not any(difference.is_significant for difference in found.values())
    assert {difference.p_value for difference in found.values()} == {1.0}


def test_exchanges_that_give_the_very_difference_of_the_runs_count() -> None:
    """Runs that differ in one step have the same |A − B| after each exchange, but for rounding."""
    rng = np.random.default_rng(6)
    T = true_motions(40)
    a = noisy(T, rng)
    b = a.copy()
    b[17] = noisy(T[17:18], rng)[0]
    found = paired_differences(a, b, se3.chain_motions(T), rng)
    for difference in found.values():
        assert difference.p_value == 1.0
        assert difference.margin == abs(difference.error_a - difference.error_b)


@pytest.mark.parametrize("steps_at_once", [1, 7 * 40])
def test_the_result_does_not_depend_on_how_many_draws_are_computed_together(
    steps_at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One draw at once, or seven."""
    rng = np.random.default_rng(8)
    T = true_motions(40)
    a = noisy(T, rng)
    b = noisy(T, rng)
    truth = se3.chain_motions(T)
    expected = paired_differences(a, b, truth, np.random.default_rng(0), draws=99)
    monkeypatch.setattr(paired_test, "_STEPS_AT_ONCE", steps_at_once)
    found = paired_differences(a, b, truth, np.random.default_rng(0), draws=99)
    for name, difference in found.items():
        assert astuple(difference) == pytest.approx(astuple(expected[name]), rel=1e-12)


def test_many_steps_need_little_memory() -> None:
    """Paths of fifty draws at once needed 0.18 MB a frame."""
    rng = np.random.default_rng(9)
    T = true_motions(5000)
    a = noisy(T, rng)
    b = noisy(T, rng)
    truth = se3.chain_motions(T)
    tracemalloc.start()
    try:
        paired_differences(a, b, truth, rng, draws=50)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 0.1e6 * len(T)


def test_too_few_steps_or_true_poses_give_nothing() -> None:
    T = true_motions(MIN_STEPS - 1)
    rng = np.random.default_rng(0)
    assert paired_differences(T, T, se3.chain_motions(T), rng) == {}
    T = true_motions(MIN_STEPS)
    truth = np.full((MIN_STEPS + 1, 4, 4), np.nan)
    truth[3] = np.eye(4)
    assert paired_differences(T, T, truth, rng) == {}


def test_without_correlation_each_difference_keeps_its_size_and_half_of_all_their_signs() -> None:
    rng = np.random.default_rng(2)
    difference = independent(300, rng)
    drawn = exchanged_differences(difference, [np.ones(1)] * 6, random_signs(400, 300, rng))
    np.testing.assert_allclose(np.abs(drawn), np.tile(np.abs(difference), (400, 1, 1)), rtol=1e-12)
    sign = drawn / difference
    assert np.ptp(sign, axis=2).max() < 1e-12  # all axes of a step at once
    assert sign.mean() == pytest.approx(0.0, abs=0.02)
    # Neighbours differ where a block begins, one step in 300^⅓, and the coin says so, ½.
    changes = sign[:, 1:, 0] * sign[:, :-1, 0] < 0.0
    assert changes.mean() == pytest.approx(0.5 / 300.0 ** (1.0 / 3.0), rel=0.03)


@pytest.mark.parametrize("coefficient", [-0.6, 0.6])
def test_the_sum_of_exchanged_differences_has_the_variance_of_the_model(
    coefficient: float,
) -> None:
    """Σ x of an autoregression: its variance is K times that of the innovations over (Σ a)²."""
    rng = np.random.default_rng(4)
    model = np.array([1.0, coefficient])
    difference = series_of(model, rng.normal(size=(6, 2000))).T
    drawn = exchanged_differences(difference, [model] * 6, random_signs(400, 2000, rng))
    variance = np.mean(drawn.sum(axis=1) ** 2)
    # Six sums over some 160 blocks of 13 innovations scatter by a tenth.
    assert variance == pytest.approx(2000.0 / (1.0 + coefficient) ** 2, rel=0.3)
