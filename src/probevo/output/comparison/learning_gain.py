"""Gains and losses of learned noise models against one that needs no training, in words."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from probevo.evaluation.paired_test import PairedDifference, paired_differences
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.comparison.significance import CONFIDENCE, SEED, listed

_NAMES = {
    "armse_m": "ARMSE",
    "final_error_m": "final error",
    "short_t_percent": "drift",
    "short_r_deg_per_m": "rotation",
}
"""The errors as the table of a comparison names them."""


def learning_gains(
    comparison: Comparison, baseline: str, learned: Sequence[str]
) -> tuple[str, ...]:
    """Say for each learned model in one sentence which errors it changes, for better or worse.

    The sentences of ``verdicts`` are about the best run, so that a model which gains nothing goes
    unmentioned there.

    Args:
        comparison: the runs.
        baseline: the estimator to compare with.
        learned: the estimators whose noise was learned.

    Returns:
        A sentence for each sequence and learned model; none without truth, or with too few steps
        for a test.
    """
    sentences = []
    for name in comparison.sequences:
        runs = {entry.estimator: entry for entry in comparison.of(name)}
        for estimator in learned:
            if baseline in runs and estimator in runs:
                # All comparisons with the baseline, by each error, hold together (Bonferroni).
                confidence = 1.0 - (1.0 - CONFIDENCE) / (len(learned) * len(_NAMES))
                differences = _differences(runs[estimator], runs[baseline], confidence)
                if differences:
                    sentences.append(
                        f"{name}: against {baseline}, {estimator} {_changes(differences)}."
                    )
    return tuple(sentences)


def _differences(entry: Entry, baseline: Entry, confidence: float) -> dict[str, PairedDifference]:
    if not entry.has_truth or entry.truth is None or len(entry.result) != len(baseline.result):
        return {}
    return paired_differences(
        entry.result.T_curr_prev,
        baseline.result.T_curr_prev,
        entry.truth,
        np.random.default_rng(SEED),
        confidence=confidence,
    )


def _changes(differences: dict[str, PairedDifference]) -> str:
    """Describe the differences, such as "has less drift by 42 %; its other errors …"."""
    less: list[str] = []
    more: list[str] = []
    for error, difference in differences.items():
        if difference.is_significant:
            percent = difference.reduction_percent[0]
            changed = less if percent > 0.0 else more
            changed.append(f"{_NAMES[error]} by {abs(percent):.0f} %")
    if not less and not more:
        return "neither gains nor loses anything beyond the noise of repetition"
    clauses = []
    if less:
        clauses.append(f"has less {listed(less)}")
    if more:
        clauses.append(f"has more {listed(more)}")
    if len(less) + len(more) < len(differences):
        clauses.append("its other errors do not differ beyond the noise of repetition")
    return "; ".join(clauses)
