"""Several estimators on the same sequences, compared by their figures of merit."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from urllib.parse import quote

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.metrics import Metrics
from probevo.evaluation.paired_test import ERRORS
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.output.comparison.significance import Ranking, rank, verdict
from probevo.output.run_result import RunResult
from probevo.output.table import Cell, Column, Row, Table
from probevo.run_config import RunConfig

FIGURES = (
    Column("ARMSE", "m"),
    Column("final error", "m"),
    Column("drift", "%"),
    Column("rotation", "°/m"),
    Column("ms/frame"),
)
"""Figures of merit; less is better: the ``ERRORS``, and the time, which differs from run to run and
is never marked as the best. Drift and rotation are those over segments of 10 to 50 m."""
SOLVED = Column("solved", "%")
"""Share of steps that were solved, and not dead-reckoned."""
ANEES = Column("ANEES")
OUT_OF_DOMAIN = Column("out of domain", "%")
"""Share of the features outside of the noise model's domain."""
ASIDES = (SOLVED, ANEES, OUT_OF_DOMAIN)
"""Figures that are no errors, and have a column only where they are known of any run."""


@dataclass(frozen=True)
class Entry:
    """Run of one estimator over one sequence of N frames."""

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
    """The report of this single run."""
    config: RunConfig | None = None
    """All settings of this run."""
    learned_from_it: bool = False
    """Whether the noise model or a sensor was trained or calibrated on this recording.

    If so, the figures of the run say little of other recordings."""

    @property
    def figures(self) -> tuple[float | None, ...]:
        """Figures of merit, in the order and the units of ``FIGURES``; None where unknown."""
        metrics = self.metrics or Metrics(num_frames=0)
        has_steps = len(self.result.total_ms) > 0
        return (
            metrics.armse_m,
            metrics.final_error_m,
            metrics.short_t_percent,
            metrics.short_r_deg_per_m,
            float(np.median(self.result.total_ms)) if has_steps else None,
        )

    @property
    def asides(self) -> tuple[float | None, ...]:
        """Figures of the run that are no errors, in the order of ``ASIDES``; None where unknown."""
        status = self.result.status
        is_solved = (status == Status.OK) | (status == Status.RECOVERED)
        out_of_domain = self.result.out_of_domain
        return (
            100.0 * float(np.mean(is_solved)) if len(status) else None,
            self.metrics.anees if self.metrics else None,
            None if out_of_domain is None else 100.0 * out_of_domain,
        )

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
    def columns(self) -> tuple[Column, ...]:
        """``FIGURES``, and those of ``ASIDES`` that are known of any entry."""
        known = [
            column
            for k, column in enumerate(ASIDES)
            if any(entry.asides[k] is not None for entry in self.entries)
        ]
        return (*FIGURES, *known)

    @cached_property
    def rankings(self) -> dict[str, dict[str, Ranking]]:
        """The ranking of the runs, by sequence and by error that at least two runs have.

        Runs whose noise model was trained on the recording are left out.
        """
        return {name: _rankings(self.of(name)) for name in self.sequences}

    def of(self, sequence: str) -> tuple[Entry, ...]:
        """Select the entries of one sequence, in the order of the estimators."""
        chosen = [entry for entry in self.entries if entry.sequence == sequence]
        return tuple(sorted(chosen, key=lambda entry: self.estimators.index(entry.estimator)))


def comparison_table(
    comparison: Comparison,
    colors: Mapping[str, str] | None = None,
    folder: Path | None = None,
) -> Table:
    """Make the table of a comparison: a section for each sequence, a row for each estimator.

    The least of each error of a sequence is marked where the difference exceeds the noise of
    repetition, and with it those that cannot be distinguished from it.

    Args:
        comparison: the runs.
        colors: colour of each estimator, by its name; without, rows have no swatch.
        folder: where the page lies that links to the reports of the runs; without, there is no
            column of links.
    """
    columns = [Column("estimator", format=str, align="left"), *comparison.columns]
    if folder is not None:
        columns.append(Column("", format=str))
    rows = []
    for sequence in comparison.sequences:
        entries = comparison.of(sequence)
        for entry in entries:
            best = (*best_errors(comparison, entry), False)
            color = colors[entry.estimator] if colors else ""
            cells = [Cell(label(entry), color=color)]
            cells += [
                Cell(value, is_best=is_best)
                for value, is_best in zip(entry.figures, best, strict=True)
            ]
            cells += [
                Cell(value)
                for column, value in zip(ASIDES, entry.asides, strict=True)
                if column in comparison.columns
            ]
            if folder is not None:
                cells.append(_report_link(entry, folder))
            rows.append(Row(tuple(cells), section=sequence))
    return Table(tuple(columns), tuple(rows))


def _ranked(entries: Sequence[Entry]) -> list[Entry]:
    """Select the runs over one sequence that are ranked; none unless there are two at least."""
    taking_part = [entry for entry in entries if entry.has_truth and not entry.learned_from_it]
    # Only runs of the full length are compared: one that was stopped lacks frames.
    longest = max((len(entry.result) for entry in taking_part), default=0)
    whole = [entry for entry in taking_part if len(entry.result) == longest]
    return [] if len(whole) < 2 or whole[0].truth is None else whole


def _rankings(entries: Sequence[Entry]) -> dict[str, Ranking]:
    """Rank the runs over one sequence by each of their errors."""
    whole = _ranked(entries)
    if not whole or whole[0].truth is None:
        return {}
    return rank(
        # Of the path, which a sensor of poses may have corrected: it is the path that has errors.
        {entry.estimator: relative_motions(entry.result.T_world_cam) for entry in whole},
        {entry.estimator: dict(zip(ERRORS, entry.figures, strict=False)) for entry in whole},
        whole[0].truth,
    )


def best_errors(comparison: Comparison, entry: Entry) -> tuple[bool, ...]:
    """Find which of ``ERRORS`` of an entry are marked as the best of its sequence."""
    rankings = comparison.rankings[entry.sequence]
    return tuple(name in rankings and entry.estimator in rankings[name].leaders for name in ERRORS)


def _report_link(entry: Entry, folder: Path) -> Cell:
    """Link to the report of a run, relative to a folder; an empty cell without a report."""
    if entry.report is None:
        return Cell("")
    # A browser wants slashes on every system, and characters such as # and % percent-encoded.
    path = Path(os.path.relpath(entry.report, folder)).as_posix()
    return Cell("report", href=quote(os.fsencode(path)))  # its bytes may be no UTF-8


def label(entry: Entry) -> str:
    """Name the estimator of an entry, marked where it has seen the recording in training."""
    return f"{entry.estimator} †" if entry.learned_from_it else entry.estimator


def verdicts(comparison: Comparison) -> tuple[str, ...]:
    """Say for each sequence, in one sentence, who drifts less than whom, and by how much.

    A sequence without two runs to compare has none; of one that is too short, it says so.
    """
    return tuple(
        f"{name}: {verdict(rankings)}"
        for name, rankings in comparison.rankings.items()
        if _ranked(comparison.of(name))
    )


def truth_note(comparison: Comparison) -> tuple[str, ...]:
    """Name the recordings without truth in a note; no note if there are none."""
    names = [
        name
        for name in comparison.sequences
        if not any(entry.has_truth for entry in comparison.of(name))
    ]
    return (f"No truth is known, and so no error: {', '.join(names)}.",) if names else ()


def column_notes(comparison: Comparison) -> tuple[str, ...]:
    """Explain the columns of asides, the marks that the table has, and what a difference means."""
    explanations = {
        SOLVED: "Solved: steps that were solved, and not dead-reckoned.",
        ANEES: (
            "ANEES: of the steps; 6 is consistent, more is overconfident, or the truth of a step is"
            " noisy."
        ),
        OUT_OF_DOMAIN: (
            "Out of domain: features that lie where the noise model has seen no training data."
        ),
    }
    notes = [text for column, text in explanations.items() if column in comparison.columns]
    if any(
        difference.is_significant
        for rankings in comparison.rankings.values()
        for ranking in rankings.values()
        for difference in ranking.against.values()
    ):
        notes.append(
            "What differs on a recording need not on the next: an error that is constant all"
            " through one may be another there."
        )
    if any(entry.learned_from_it for entry in comparison.entries):
        notes.append("†: learned from this recording, and so no test of it.")
    return tuple(notes)


def distinct_labels(paths: Sequence[Path], taken: Collection[str] = ()) -> list[str]:
    """Name each file or folder by its own name, after as many parent folders as make it distinct.

    Names differ in more than their case, and from those ``taken``, so that they can be names of
    folders, too.
    """
    parts = [
        (*path.resolve().parent.parts[1:], path.stem if path.is_file() else path.resolve().name)
        for path in paths
    ]
    depths = [1] * len(paths)
    # Lengthen the names that occur twice by one folder, until none does or no folder is left.
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
    """Append -2, -3 … to names that occur before, or in ``taken``, whatever their case."""
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
