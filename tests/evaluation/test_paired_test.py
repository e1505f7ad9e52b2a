"""The paired test: equally good runs are found to differ as often as its level says, no more."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from probevo.arrays import FloatArray
from probevo.evaluation.metrics import evaluate
from probevo.evaluation.paired_test import (
    ERRORS,
    mean_block_length,
    paired_differences,
    random_blocks,
)
from probevo.geometry import se3

SIGMA = np.array([0.01, 0.01, 0.02, 3e-4, 3e-4, 3e-4])
STEP = np.array([0.0, 0.0, -1.2, 0.0, 0.005, 0.0])


def true_motions(count: int) -> FloatArray:
    return se3.exp(np.tile(STEP, (count, 1)))


def noisy(T: FloatArray, rng: np.random.Generator, factor: float = 1.0) -> FloatArray:
    return se3.exp(factor * SIGMA * rng.normal(size=(len(T), 6))) @ T


def test_the_level_of_the_test_holds() -> None:
    """Of 200 pairs of equally good runs, at most so many differ that 5 % would be refuted."""
    trials = 200
    T = true_motions(20)
    truth = se3.chain_motions(T)
    count = dict.fromkeys(ERRORS, 0)
    rng = np.random.default_rng(5)
    for _ in range(trials):
        found = paired_differences(noisy(T, rng), noisy(T, rng), truth, rng, draws=99)
        for name in ERRORS:
            count[name] += found[name].is_significant
    highest = binom.ppf(0.995, trials, 0.05)
    assert max(count.values()) <= highest, count
    assert min(count.values()) > 0, count  # it does not always say no


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
    T = true_motions(20)
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


def test_too_few_steps_or_true_poses_give_nothing() -> None:
    T = true_motions(5)
    rng = np.random.default_rng(0)
    assert paired_differences(T, T, se3.chain_motions(T), rng) == {}
    T = true_motions(20)
    truth = np.full((21, 4, 4), np.nan)
    truth[3] = np.eye(4)
    assert paired_differences(T, T, truth, rng) == {}


def test_blocks_have_their_mean_length_and_half_of_all_steps_are_exchanged() -> None:
    rng = np.random.default_rng(2)
    exchanged = random_blocks(400, 300, 8.0, rng)
    assert exchanged.mean() == pytest.approx(0.5, abs=0.02)
    # Neighbours differ where a block begins, at one step in eight, and the coin says so, ½.
    changes = exchanged[:, 1:] != exchanged[:, :-1]
    assert changes.mean() == pytest.approx(0.5 / 8.0, rel=0.03)


@pytest.mark.parametrize("correlation", [0.5, 0.8])
def test_block_length_is_that_of_the_theory_for_an_autoregressive_series(
    correlation: float,
) -> None:
    """AR(1): Σ|k|R(k) / ΣR(k) is 2ρ/(1 − ρ²); the length is its square, times K, to the ⅓."""
    rng = np.random.default_rng(3)
    count = 20000
    series = np.zeros(count)
    noise = rng.normal(size=count)
    for k in range(1, count):
        series[k] = correlation * series[k - 1] + noise[k]
    ratio = 2.0 * correlation / (1.0 - correlation**2)
    expected = (ratio**2 * count) ** (1.0 / 3.0)
    assert mean_block_length(series[:, None]) == pytest.approx(expected, rel=0.2)


def test_block_length_of_white_noise_is_short_and_of_a_constant_one() -> None:
    white = np.random.default_rng(4).normal(size=(1000, 1))
    assert mean_block_length(white) < 5.0
    assert mean_block_length(np.ones((50, 6))) == 1.0
