"""Several estimators on the same sequences, and the figures of merit by which they are compared."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.metrics import Metrics
from probevo.output.metrics_table import readable
from probevo.output.run_result import RunResult
from probevo.run_config import RunConfig

COLUMNS = ("ARMSE m", "final error m", "drift %", "rotation °/m", "ms/frame")
"""Figures of merit; the less, the better. Drift and rotation are those over pieces of 10 to 50 m.
"""
DOMAIN_COLUMN = "out of domain %"
"""Share of the features out of the noise model's domain."""
TIME_COLUMN = COLUMNS.index("ms/frame")
"""The one that differs from run to run."""


@dataclass(frozen=True)
class Entry:
    """One estimator's run over one sequence, of N frames."""

    sequence: str
    """Name of the sequence."""
    estimator: str
    """Name of the estimator, e.g. of its noise model."""
    result: RunResult
    truth: FloatArray | None = None
    """True poses T_world_cam, [N, 4, 4], m, in any world frame; NaN where unknown."""
    metrics: Metrics | None = None
    """Comparison with the truth."""
    pictures: tuple[tuple[str, bytes], ...] = ()
    """Caption and JPEG file of a few frames with their tracks; of the same frames for all entries
    of a sequence."""
    report: Path | None = None
    """The report of this run alone."""
    config: RunConfig | None = None
    """All settings of this run."""
    learned_from_it: bool = False
    """Whether the noise model was learned from a recording of this name: its figures then say
    little of other ones."""

    @property
    def figures(self) -> tuple[float | None, ...]:
        """Its figures of merit, in the order and the units of ``COLUMNS``; None where unknown."""
        metrics = self.metrics or Metrics(num_frames=0)
        drift = (metrics.short_t_percent, metrics.short_r_deg_per_m)
        ms = float(np.median(self.result.total_ms)) if len(self.result.total_ms) else None
        return (metrics.armse_m, metrics.final_error_m, *drift, ms)

    @property
    def asides(self) -> dict[str, float | None]:
        """Figures that are no errors, by the head of their column; None where unknown."""
        steps = self.result.status
        share = self.result.out_of_domain
        return {
            "solved %": 100.0 * float(np.mean(steps == Status.OK)) if len(steps) else None,
            "ANEES": self.metrics.anees if self.metrics else None,
            DOMAIN_COLUMN: None if share is None else 100.0 * share,
        }

    @property
    def has_truth(self) -> bool:
        """Whether there is a truth that its positions can be compared with."""
        return self.metrics is not None and self.metrics.armse_m is not None


@dataclass(frozen=True)
class Comparison:
    """Entries in any order; sequences and estimators rank by their first appearance."""

    entries: tuple[Entry, ...]

    @property
    def sequences(self) -> tuple[str, ...]:
        """Names of the sequences."""
        return tuple(dict.fromkeys(entry.sequence for entry in self.entries))

    @property
    def estimators(self) -> tuple[str, ...]:
        """Names of the estimators."""
        return tuple(dict.fromkeys(entry.estimator for entry in self.entries))

    @property
    def columns(self) -> tuple[str, ...]:
        """Those of the table: ``COLUMNS``, and of the asides those that are known of any entry."""
        asides = [entry.asides for entry in self.entries]
        heads = dict.fromkeys(head for row in asides for head in row)
        return (*COLUMNS, *(head for head in heads if any(row[head] is not None for row in asides)))

    def of(self, sequence: str) -> tuple[Entry, ...]:
        """The entries of one sequence, in the order of the estimators."""
        chosen = [entry for entry in self.entries if entry.sequence == sequence]
        return tuple(sorted(chosen, key=lambda entry: self.estimators.index(entry.estimator)))


def comparison_rows(comparison: Comparison) -> list[tuple[str, ...]]:
    """Head and rows of the table as text: for each sequence a row with its name alone, then one an
    estimator."""
    rows: list[tuple[str, ...]] = [("estimator", *comparison.columns)]
    for sequence in comparison.sequences:
        rows.append((sequence, *("" for _ in comparison.columns)))
        rows += [
            (f"  {label(entry)}", *figure_texts(entry, comparison.columns))
            for entry in comparison.of(sequence)
        ]
    return rows


def figure_texts(entry: Entry, columns: Sequence[str] = COLUMNS) -> tuple[str, ...]:
    """What ``Comparison.columns`` show of an entry, as a reader sees it; a dash where unknown."""
    figures = dict(zip(COLUMNS, entry.figures, strict=True)) | entry.asides
    return tuple(figure_text(figures[column]) for column in columns)


def label(entry: Entry) -> str:
    """Its estimator, marked where it has seen the recording before."""
    return f"{entry.estimator} †" if entry.learned_from_it else entry.estimator


def figure_text(value: float | None) -> str:
    """A figure as a reader sees it; a dash where it is unknown."""
    return "–" if value is None else readable(value)


def reads_least(values: Sequence[float | None]) -> list[bool]:
    """Which of the values a reader takes for the least; none where there is nothing to compare it
    with."""
    known = [value for value in values if value is not None]
    least = figure_text(min(known)) if len(known) > 1 else None
    return [value is not None and figure_text(value) == least for value in values]


def truth_note(comparison: Comparison) -> tuple[str, ...]:
    """Which recordings have no truth; nothing if all have."""
    without = [
        name
        for name in comparison.sequences
        if not any(entry.has_truth for entry in comparison.of(name))
    ]
    return (f"No truth is known, and so no error: {', '.join(without)}.",) if without else ()


def column_notes(comparison: Comparison) -> tuple[str, ...]:
    """What the asides and the marks mean, of those that there are."""
    notes = {
        "solved %": "Solved: steps that were, and not carried on from the last velocity.",
        "ANEES": (
            "ANEES: of the steps; 6 is honest, more is overconfident, or the truth of a step is"
            " noisy."
        ),
        DOMAIN_COLUMN: (
            "Out of domain: features that lie where the noise model has seen no training data."
        ),
    }
    learned = any(entry.learned_from_it for entry in comparison.entries)
    marks = ("†: learned from a recording of this name, and so no judge of it.",) if learned else ()
    return (*(note for column, note in notes.items() if column in comparison.columns), *marks)


def distinct_labels(paths: Sequence[Path], taken: Collection[str] = ()) -> list[str]:
    """A name for each file or folder: its own, after as many folders as it takes to tell it from
    the others.

    Names differ in more than their case, and are none of those ``taken``, so that they can be names
    of folders too.
    """
    parts = [
        (*path.resolve().parent.parts[1:], path.stem if path.is_file() else path.resolve().name)
        for path in paths
    ]
    depths = [1] * len(paths)
    while True:
        labels = ["-".join(part[-depth:]) for part, depth in zip(parts, depths, strict=True)]
        counts = Counter(name.casefold() for name in (*labels, *taken))
        longer = [
            k
            for k, label in enumerate(labels)
            if counts[label.casefold()] > 1 and depths[k] < len(parts[k])
        ]
        if not longer:
            return numbered(labels, taken)
        for k in longer:
            depths[k] += 1


def numbered(names: Sequence[str], taken: Collection[str] = ()) -> list[str]:
    """The names, with -2, -3 … behind those that came before, but for their case."""
    used = {name.casefold() for name in taken}
    unique = []
    for name in names:
        candidate = name
        number = 1
        while candidate.casefold() in used:
            number += 1
            candidate = f"{name}-{number}"
        used.add(candidate.casefold())
        unique.append(candidate)
    return unique
