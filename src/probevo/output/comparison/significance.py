"""Who is best on a recording, by each error, and whether that exceeds the noise of repetition."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.evaluation.paired_test import (
    DRAWS,
    MIN_STEPS,
    PairedDifference,
    paired_differences,
)
from probevo.evaluation.segments import SHORT_LENGTHS_M

CONFIDENCE = 0.95
"""Probability that, by one error on one recording, none of the differences that are called
significant is noise."""
DRAWS_IN_MARGIN = 3
"""Draws, at least, beyond the margin of the most confident test."""
SEED = 0
"""Seed of the random exchanges, so that the same runs give the same result."""


@dataclass(frozen=True)
class Ranking:
    """The runs over one recording, by one of their errors."""

    best: str
    """Name of the run with the least error."""
    against: dict[str, PairedDifference]
    """The best against each of its rivals, by name."""

    @property
    def leaders(self) -> frozenset[str]:
        """The best and whoever cannot be distinguished from it; nobody if that holds for all."""
        close = {name for name, difference in self.against.items() if not difference.is_significant}
        if len(close) == len(self.against):
            return frozenset()
        return frozenset({self.best, *close})


def rank(
    motions: Mapping[str, FloatArray],
    errors: Mapping[str, Mapping[str, float | None]],
    T_world_cam_true: FloatArray,
) -> dict[str, Ranking]:
    """Rank two or more runs over N frames by each of their errors.

    Args:
        motions: T_curr_prev along the path of each run, [N-1, 4, 4], m, by its name.
        errors: value of each error, by its name in ``Metrics``; None where it is not defined.
        T_world_cam_true: true poses, [N, 4, 4], m; NaN where unknown.

    Returns:
        By the name of the error; those that are not defined, or cannot be tested, are left out.
    """
    # All comparisons hold together at the confidence (Bonferroni). Since the best is chosen by the
    # same errors, these are those of all pairs, although only those with the best are made.
    num_pairs = len(motions) * (len(motions) - 1) // 2
    confidence = 1.0 - (1.0 - CONFIDENCE) / num_pairs
    # The more pairs, the smaller the p-values that have to be distinguished.
    draws = max(DRAWS, math.ceil(DRAWS_IN_MARGIN / (1.0 - confidence)) - 1)
    rankings = {}
    tested: dict[tuple[str, str], dict[str, PairedDifference]] = {}
    for error in next(iter(errors.values())):
        known = {
            name: value for name, values in errors.items() if (value := values[error]) is not None
        }
        if len(known) < len(motions):
            continue
        best = min(known, key=lambda name: known[name])
        for rival in known:
            if rival != best and (best, rival) not in tested:
                tested[best, rival] = paired_differences(
                    motions[best],
                    motions[rival],
                    T_world_cam_true,
                    np.random.default_rng(SEED),
                    confidence=confidence,
                    draws=draws,
                )
        against = {rival: tested[best, rival] for rival in known if rival != best}
        if all(error in differences for differences in against.values()):
            rankings[error] = Ranking(
                best, {rival: differences[error] for rival, differences in against.items()}
            )
    return rankings


def verdict(rankings: Mapping[str, Ranking]) -> str:
    """Say who drifts less than whom, and by how much, in translation and in rotation.

    Args:
        rankings: as ``rank`` returns them, by the name of the error.

    Returns:
        One sentence.
    """
    clauses = []
    alike: dict[frozenset[str], list[str]] = {}
    for error, name in (("short_t_percent", "translation"), ("short_r_deg_per_m", "rotation")):
        if error not in rankings:
            continue
        ranking = rankings[error]
        worse = [
            f"than {rival} by {_percent(difference)}"
            for rival, difference in ranking.against.items()
            if difference.is_significant
        ]
        if worse:
            clauses.append(
                f"{ranking.best} drifts less in {name} on this recording {listed(worse)}"
            )
        close = [
            rival for rival, difference in ranking.against.items() if not difference.is_significant
        ]
        if close:
            alike.setdefault(frozenset({ranking.best, *close}), []).append(name)
    clauses += [
        f"in {' and '.join(names)}, {listed(sorted(runs))} cannot be distinguished on this"
        " recording"
        for runs, names in alike.items()
    ]
    if not clauses:
        clauses.append(
            "too short to tell who drifts less, which takes"
            f" {MIN_STEPS} steps and {min(SHORT_LENGTHS_M):.0f} m between true poses"
        )
    return f"{'; '.join(clauses)}."


def _percent(difference: PairedDifference) -> str:
    """Give the reduction with its interval, such as ``12 % (95 %: 5 to 18 %)``."""
    value, low, high = difference.reduction_percent
    digits = 0 if low >= 1.0 else 1
    return (
        f"{value:.{digits}f} % ({100.0 * CONFIDENCE:.0f} %: {low:.{digits}f} to"
        f" {min(high, 100.0):.{digits}f} %)"
    )


def listed(texts: Sequence[str]) -> str:
    """Join texts by commas, the last two by 'and'."""
    return " and ".join([", ".join(texts[:-1]), texts[-1]]) if len(texts) > 1 else texts[0]
