"""The form of the papers' tables: a row for each trial, with the errors of each estimator."""

from __future__ import annotations

from dataclasses import dataclass

from markupsafe import Markup

from probevo.output.comparison.comparison import Comparison, Entry, best_errors, truth_note
from probevo.output.page import table_panel
from probevo.output.table import UNKNOWN_TEXT, Cell, Column, Row, Table, reads_least

Errors = tuple[float | None, ...]
"""One error for each measure of the table; None where unknown."""
UNKNOWN: Errors = (None, None)
PROBE_MEASURES = (("ARMSE", "m"), ("final error", "m"))
"""The measures of PROBE Table I."""


@dataclass(frozen=True)
class TrialRow:
    """One trial, or other figures of the one above."""

    name: str
    errors: tuple[Errors, ...]
    """Errors of each estimator."""
    path_length_m: float | None = None
    """Length of the true path."""
    kind: str = ""
    """Kind of place, e.g. City."""
    is_aside: bool = False
    """Whether the row is an aside of the one above, such as published figures."""
    best: tuple[tuple[bool, ...], ...] | None = None
    """Marks on the errors of each estimator; by default on those that read as the least."""


@dataclass(frozen=True)
class TrialTable:
    """The errors of several estimators in several trials."""

    estimators: tuple[str, ...]
    rows: tuple[TrialRow, ...]
    notes: tuple[str, ...] = ()
    """Notes below the table, one sentence each."""
    measures: tuple[tuple[str, str], ...] = PROBE_MEASURES
    """Name and unit of the errors of an estimator; less is better."""
    form: str = "PROBE Table I"
    """The published table that this is shaped as."""

    @property
    def has_kinds(self) -> bool:
        """Whether there is a column for the kind of place."""
        return any(row.kind for row in self.rows)

    def as_table(self) -> Table:
        """Lay the trials out, a column for each measure of each estimator; the least are marked."""
        columns = [Column("trial", format=str, align="left")]
        if self.has_kinds:
            columns.append(Column("type", format=str, align="left"))
        columns.append(Column("length", "m", format=_length_text))
        columns += [
            Column(title, unit, group=estimator)
            for estimator in self.estimators
            for title, unit in self.measures
        ]
        return Table(tuple(columns), tuple(self._row(row) for row in self.rows), self.notes)

    def _row(self, row: TrialRow) -> Row:
        cells = [Cell(row.name)]
        if self.has_kinds:
            cells.append(Cell(row.kind))
        cells.append(Cell(row.path_length_m))
        for errors, are_best in zip(row.errors, row.best or _least(row.errors), strict=True):
            cells += [
                Cell(error, is_best=is_best)
                for error, is_best in zip(errors, are_best, strict=True)
            ]
        return Row(tuple(cells), is_aside=row.is_aside)


def _least(errors: tuple[Errors, ...]) -> list[tuple[bool, ...]]:
    """Find which errors of each estimator read as the least of their measure."""
    measures = [reads_least(values) for values in zip(*errors, strict=True)]
    return list(zip(*measures, strict=True))


def errors_of(entry: Entry) -> Errors:
    """Return the errors of a run that ``PROBE_MEASURES`` name."""
    return (entry.metrics.armse_m, entry.metrics.final_error_m) if entry.metrics else UNKNOWN


def trial_table(comparison: Comparison) -> TrialTable:
    """Arrange the runs of a comparison in this form; missing runs have dashes."""
    rows = []
    for name in comparison.sequences:
        entries = {entry.estimator: entry for entry in comparison.of(name)}
        lengths_m = [entry.metrics.path_length_m for entry in entries.values() if entry.metrics]
        errors = [
            errors_of(entries[key]) if key in entries else UNKNOWN for key in comparison.estimators
        ]
        unmarked = (False,) * len(PROBE_MEASURES)
        best = [
            best_errors(comparison, entries[key])[: len(PROBE_MEASURES)]
            if key in entries
            else unmarked
            for key in comparison.estimators
        ]
        length_m = next(iter(lengths_m), None)
        rows.append(TrialRow(name, tuple(errors), length_m, best=tuple(best)))
    notes = (*truth_note(comparison), *_seen_note(comparison))
    return TrialTable(comparison.estimators, tuple(rows), notes)


def _seen_note(comparison: Comparison) -> tuple[str, ...]:
    """Name the runs whose noise model or sensor has seen the recording in training."""
    seen = [
        f"{entry.estimator} from {entry.sequence}"
        for entry in comparison.entries
        if entry.learned_from_it
    ]
    return (f"Learned from the same recordings: {', '.join(seen)}.",) if seen else ()


def trials_section(table: TrialTable) -> Markup:
    """Show the table as a section of a page."""
    marks = "Bold: the least of a row."
    if any(row.best is not None for row in table.rows):
        marks = "Bold: the least of a row, where the difference exceeds the noise of repetition."
    notes = (marks, *table.notes)
    return table_panel(f"In the form of {table.form}", notes, table.as_table())


def trials_latex(table: TrialTable) -> str:
    """Show the table as a LaTeX ``tabular``."""
    return table.as_table().as_latex()


def _length_text(length_m: float | None) -> str:
    """Format a path length to 0.1 m, as PROBE gives it; a dash where unknown."""
    return UNKNOWN_TEXT if length_m is None else f"{length_m:,.1f}"
