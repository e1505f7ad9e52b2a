"""Sentences about what learned noise models gain or lose."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.evaluation.metrics import evaluate
from probevo.geometry import se3
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.comparison.learning_gain import learning_gains
from probevo.output.comparison.significance import rank
from probevo.output.run_result import RunResult

TURNS = {"good": 0.0, "usual": 0.001, "same": 0.001, "bad": 0.004}
"""By how much each run turns too far at each step, rad."""


def entry(name: str, run: RunResult, truth: FloatArray | None) -> Entry:
    """One run, and its errors if there is a truth."""
    metrics = None if truth is None else evaluate(run.T_world_cam, truth)
    return Entry("hill", name, run, truth=truth, metrics=metrics)


def comparison(run: RunResult, *, has_truth: bool = True) -> Comparison:
    """Runs that turn too far by more or less; the one of no error is the truth."""
    entries = []
    for name, turn in TURNS.items():
        motions = se3.exp(np.array([0, 0, 0, 0, turn, 0])) @ run.T_curr_prev
        turned = replace(run, T_curr_prev=motions, T_world_cam=se3.chain_motions(motions))
        entries.append(entry(name, turned, run.T_world_cam if has_truth else None))
    return Comparison(tuple(entries))


def test_comparisons_of_noise_hardly_find_a_difference(
    make_run: Callable[..., RunResult],
) -> None:
    """The best of six equally good runs, chosen by the errors that are tested.

    Paths are shorter than any segment, whose drift need not be computed then.
    """
    run = make_run(27, speed=0.2)
    found = 0
    for seed in range(12):
        rng = np.random.default_rng([7, seed])
        motions = {}
        errors = {}
        for name in "abcdef":
            noise = rng.normal(0.0, 0.001, (26, 6))
            motions[name] = se3.exp(noise) @ run.T_curr_prev
            noisy = se3.chain_motions(motions[name])
            errors[name] = {"final_error_m": evaluate(noisy, run.T_world_cam).final_error_m}
        ranking = rank(motions, errors, run.T_world_cam)["final_error_m"]
        found += any(one.is_significant for one in ranking.against.values())
    assert found <= 3  # of 0.6 that are expected, with a probability of 99.8 %


def test_gains_and_losses_are_both_said(make_run: Callable[..., RunResult]) -> None:
    good, same, bad = learning_gains(comparison(make_run(60)), "usual", ("good", "same", "bad"))
    assert good.startswith("hill: against usual, good has less ARMSE by 100 %")
    assert "more" not in good
    assert same == (
        "hill: against usual, same neither gains nor loses anything beyond the noise of repetition."
    )
    assert bad.startswith("hill: against usual, bad has more ")
    assert "less" not in bad


def test_some_errors_may_differ_and_others_not(make_run: Callable[..., RunResult]) -> None:
    """A run whose steps err by chance, but more than the other's, may still end as near."""
    run = make_run(100)
    rng = np.random.default_rng(1)
    noise = rng.normal(0.0, 1.0, (99, 6)) * np.array([0.0, 0.0, 0.0, 0.001, 0.001, 0.001])
    entries = []
    for name, size in (("usual", 1.0), ("steady", 0.3)):
        motions = se3.exp(size * noise) @ run.T_curr_prev
        noisy = replace(run, T_curr_prev=motions, T_world_cam=se3.chain_motions(motions))
        entries.append(entry(name, noisy, run.T_world_cam))
    (sentence,) = learning_gains(Comparison(tuple(entries)), "usual", ("steady",))
    assert sentence.startswith("hill: against usual, steady has less ")
    assert sentence.endswith("; its other errors do not differ beyond the noise of repetition.")


def test_nothing_is_said_where_nothing_can_be(make_run: Callable[..., RunResult]) -> None:
    learned = ("good", "bad")
    assert learning_gains(comparison(make_run(60), has_truth=False), "usual", learned) == ()
    assert learning_gains(comparison(make_run(6)), "usual", learned) == ()
    assert learning_gains(comparison(make_run(60)), "absent", learned) == ()
    assert learning_gains(comparison(make_run(60)), "usual", ("absent",)) == ()
