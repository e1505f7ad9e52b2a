"""What a comparison says of recordings whose truth is not known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from probevo.evaluation.metrics import Metrics
from probevo.geometry import se3
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.comparison.without_truth import without_truth
from probevo.output.run_result import RunResult


def straight(run: RunResult, step_m: float, sigma_m: float) -> RunResult:
    """Return a run straight ahead, by steps of that length, whose errors are independent."""
    motions = np.repeat(se3.exp(np.array([[0.0, 0.0, -step_m, 0.0, 0.0, 0.0]])), len(run) - 1, 0)
    cov = np.zeros_like(run.cov)
    cov[:, range(3), range(3)] = sigma_m**2
    return replace(run, T_curr_prev=motions, T_world_cam=se3.chain_motions(motions), cov=cov)


def test_claims_and_ends_are_compared(make_run: Callable[..., RunResult]) -> None:
    """Over 16 steps σ grows to four times that of a step; the ends are 16 · 0.25 m apart."""
    entries = (
        Entry("dale", "fixed", straight(make_run(17), 1.0, 0.5)),
        Entry("dale", "student-t", straight(make_run(17), 1.25, 0.25)),
    )
    (sentence,) = without_truth(Comparison(entries))
    assert sentence.startswith("dale: no truth is known, and so no error")
    assert "3σ of the last position is 6.00 m (fixed), 3.00 m (student-t)." in sentence
    assert "end up to 4.00 m apart, after 16.0 m." in sentence


def test_paths_are_compared_where_the_shortest_ends(make_run: Callable[..., RunResult]) -> None:
    entries = (
        Entry("dale", "fixed", straight(make_run(17), 1.0, 0.5)),
        Entry("dale", "student-t", straight(make_run(9), 1.25, 0.25)),
    )
    (sentence,) = without_truth(Comparison(entries))
    assert "end up to 2.00 m apart, after 8.00 m." in sentence


def test_a_single_run_is_compared_with_nothing(make_run: Callable[..., RunResult]) -> None:
    (sentence,) = without_truth(Comparison((Entry("dale", "fixed", make_run(5)),)))
    assert "what the run itself claims" in sentence
    assert "apart" not in sentence


def test_where_truth_is_known_nothing_is_said(make_run: Callable[..., RunResult]) -> None:
    known = Entry("hill", "fixed", make_run(3), metrics=Metrics(3, armse_m=1.0))
    unknown = Entry("moor", "fixed", make_run(3), metrics=Metrics(0))
    assert without_truth(Comparison((known,))) == ()
    (sentence,) = without_truth(Comparison((known, unknown)))
    assert sentence.startswith("moor: ")
