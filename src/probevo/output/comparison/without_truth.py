"""Estimators on a recording whose truth is not known: what can be compared then, in words."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np

from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.report.report_data import drift_of
from probevo.output.table import readable


def without_truth(comparison: Comparison) -> tuple[str, ...]:
    """Say for each recording without truth that there is no error, and what is compared instead.

    A recording with truth has no sentence.
    """
    return tuple(
        f"{name}: {_sentence(comparison.of(name))}"
        for name in comparison.sequences
        if not any(entry.has_truth for entry in comparison.of(name))
    )


def _sentence(entries: Sequence[Entry]) -> str:
    """Say it of the runs over one recording."""
    drifts = [drift_of(entry.result, None) for entry in entries]
    claims = [
        f"{readable(3.0 * float(drift.position_sigma_m[-1]))} m ({entry.estimator})"
        for entry, drift in zip(entries, drifts, strict=True)
    ]
    claimed = f"3σ of the last position is {', '.join(claims)}"
    if len(entries) == 1:
        return (
            "no truth is known, and so no error. What is left are the time, the share of solved"
            f" steps, and what the run itself claims: {claimed}."
        )
    # A run that was stopped has fewer frames: the paths are compared where the shortest one ends.
    last = min(len(entry.result) for entry in entries) - 1
    ends_m = [drift.T_world_cam[last, :3, 3] for drift in drifts]
    apart_m = max(
        float(np.linalg.norm(end_m - other_end_m)) for end_m, other_end_m in combinations(ends_m, 2)
    )
    distance_m = float(drifts[0].distance_m[last])
    return (
        "no truth is known, and so no error: nothing says which estimator is better. What is"
        " compared are times, shares of solved steps, and what each run itself claims:"
        f" {claimed}. Their paths end up to {readable(apart_m)} m apart, after"
        f" {readable(distance_m)} m."
    )
