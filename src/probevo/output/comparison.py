"""Several estimators on the same sequences, and the figures of merit by which they are compared."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.evaluation.metrics import Metrics
from probevo.output.metrics_table import readable
from probevo.output.run_result import RunResult

COLUMNS = ("ARMSE m", "final error m", "drift %", "rotation °/m", "ms/frame")
"""Figures of merit; the less, the better. Drift and rotation are those over pieces of 10 to 50 m."""
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
    """Caption and JPEG file of a few frames with their tracks; of the same frames for all entries of a sequence."""
    report: Path | None = None
    """The report of this run alone."""

    @property
    def figures(self) -> tuple[float | None, ...]:
        """Its figures of merit, in the order and the units of ``COLUMNS``; None where unknown."""
        metrics = self.metrics or Metrics(num_frames=0)
        drift = (metrics.short_t_percent, metrics.short_r_deg_per_m)
        ms = float(np.median(self.result.total_ms)) if len(self.result.total_ms) else None
        return (metrics.armse_m, metrics.final_error_m, *drift, ms)


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

    def of(self, sequence: str) -> tuple[Entry, ...]:
        """The entries of one sequence, in the order of the estimators."""
        chosen = [entry for entry in self.entries if entry.sequence == sequence]
        return tuple(sorted(chosen, key=lambda entry: self.estimators.index(entry.estimator)))


def comparison_rows(comparison: Comparison) -> list[tuple[str, ...]]:
    """Head and rows of the table as text: for each sequence a row with its name alone, then one an estimator."""
    rows: list[tuple[str, ...]] = [("estimator", *COLUMNS)]
    for sequence in comparison.sequences:
        rows.append((sequence, *("" for _ in COLUMNS)))
        rows += [(f"  {entry.estimator}", *figure_texts(entry)) for entry in comparison.of(sequence)]
    return rows


def figure_texts(entry: Entry) -> tuple[str, ...]:
    """The figures of merit as a reader sees them; a dash where unknown."""
    return tuple("–" if value is None else readable(value) for value in entry.figures)
