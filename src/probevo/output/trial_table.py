"""The form of the papers' tables: a row a trial, of each estimator its errors; as text, HTML and
LaTeX."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from html import escape

from probevo.output.comparison import Comparison, Entry, figure_text, reads_least, truth_note

Errors = tuple[float | None, ...]
"""One of each measure of the table; None where unknown."""
UNKNOWN: Errors = (None, None)
PROBE_MEASURES = (("ARMSE", "m"), ("final error", "m"))
"""Those of PROBE Table I."""
_LATEX = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "–": "--",
    "[": "{[}",  # at the start of a row it would be taken for an option of the \\ before it
    "*": "{*}",  # so would this
    "\n": " ",
} | {sign: "\\" + sign for sign in "{}$&#%_"}

_NOT_FIRST = 'style="text-align: right; padding-left: 22px"'
"""For what comes first in a row of the page, but stands below others than the first of a table."""


@dataclass(frozen=True)
class TrialRow:
    """One trial, or other figures of the one above."""

    name: str
    errors: tuple[Errors, ...]
    """Of each estimator."""
    path_length_m: float | None = None
    """Of the truth."""
    kind: str = ""
    """Of place, e.g. City."""
    is_aside: bool = False
    """Whether it belongs to the row above, e.g. as what was published."""


@dataclass(frozen=True)
class TrialTable:
    """Trials by estimators."""

    estimators: tuple[str, ...]
    rows: tuple[TrialRow, ...]
    notes: tuple[str, ...] = ()
    """What a reader should know, one sentence each."""
    measures: tuple[tuple[str, str], ...] = PROBE_MEASURES
    """Name and unit of the errors of an estimator; the less, the better."""
    form: str = "PROBE Table I"
    """The published table that this is shaped as."""

    @property
    def has_kinds(self) -> bool:
        """Whether there is a column for the kind of place."""
        return any(row.kind for row in self.rows)


def errors_of(entry: Entry) -> Errors:
    """Of a run, the figures of ``PROBE_MEASURES``."""
    return (entry.metrics.armse_m, entry.metrics.final_error_m) if entry.metrics else UNKNOWN


def trial_table(comparison: Comparison) -> TrialTable:
    """The runs of a comparison in this form; an estimator that did not run over a recording has
    dashes."""
    rows = []
    for name in comparison.sequences:
        entries = {entry.estimator: entry for entry in comparison.of(name)}
        lengths_m = [entry.metrics.path_length_m for entry in entries.values() if entry.metrics]
        errors = [
            errors_of(entries[key]) if key in entries else UNKNOWN for key in comparison.estimators
        ]
        rows.append(TrialRow(name, tuple(errors), next(iter(lengths_m), None)))
    return TrialTable(
        comparison.estimators, tuple(rows), (*truth_note(comparison), *_seen_note(comparison))
    )


def _seen_note(comparison: Comparison) -> tuple[str, ...]:
    seen = [
        f"{entry.estimator} from {entry.sequence}"
        for entry in comparison.entries
        if entry.learned_from_it
    ]
    return (f"Learned from recordings of the same names: {', '.join(seen)}.",) if seen else ()


def trials_text(table: TrialTable) -> list[tuple[str, ...]]:
    """Head and rows of the table as text, all errors of an estimator in one column."""
    kinds = ("type",) if table.has_kinds else ()
    head = ("trial", *kinds, "length m", *table.estimators)
    columns = [_joined([row.errors[k] for row in table.rows]) for k in range(len(table.estimators))]
    rows = []
    for row, *errors in zip(table.rows, *columns, strict=True):
        kind = (row.kind,) if kinds else ()
        rows.append(
            (f"  {row.name}" if row.is_aside else row.name, *kind, length_text(row), *errors)
        )
    return [head, *rows]


def _joined(errors: list[Errors]) -> list[str]:
    """All numbers of an estimator in a cell, so wide that those of all cells stand below each
    other."""
    columns = [[figure_text(value) for value in column] for column in zip(*errors, strict=True)]
    widths = [max(map(len, column), default=0) for column in columns]
    return [" / ".join(map(str.rjust, texts, widths)) for texts in zip(*columns, strict=True)]


def length_text(row: TrialRow) -> str:
    """Its path length to 0.1 m, as PROBE gives it; a dash where unknown."""
    return "–" if row.path_length_m is None else f"{row.path_length_m:,.1f}"


def trials_section(table: TrialTable) -> str:
    """The table as a section of a page."""
    kinds = '<th rowspan="2">type</th>' if table.has_kinds else ""
    names = "".join(
        f'<th colspan="{len(table.measures)}">{escape(name)}</th>' for name in table.estimators
    )
    head = f'<tr><th rowspan="2">trial</th>{kinds}<th rowspan="2">length m</th>{names}</tr>\n'
    first, *others = (f"{escape(name)} {escape(unit)}" for name, unit in table.measures)
    cells = f"<th {_NOT_FIRST}>{first}</th>" + "".join(f"<th>{other}</th>" for other in others)
    head += f"<tr>{cells * len(table.estimators)}</tr>"
    rows = "\n".join(_html_row(row, table.has_kinds) for row in table.rows)
    notes = "<br/>\n".join(map(escape, ("Bold: the least of a row.", *table.notes)))
    body = f'<table class="figures"><thead>{head}</thead>\n<tbody>\n{rows}\n</tbody></table>'
    return (
        f'<section class="panel"><h2>In the form of {table.form}</h2><p'
        f' class="note">{notes}</p>\n{body}</section>'
    )


def _html_row(row: TrialRow, has_kinds: bool) -> str:
    cells = "".join(
        f'<td class="best">{text}</td>' if best else f"<td>{text}</td>"
        for text, best in _cells(row)
    )
    kind = f"<td>{escape(row.kind)}</td>" if has_kinds else ""
    name = f"<small>{escape(row.name)}</small>" if row.is_aside else escape(row.name)
    return f"<tr><th>{name}</th>{kind}<td>{length_text(row)}</td>{cells}</tr>"


def trials_latex(table: TrialTable) -> str:
    """The table as a plain ``tabular`` that needs no package; notes go into comments above it."""
    kinds = 1 if table.has_kinds else 0
    before = " & " * (1 + kinds)
    each = len(table.measures)
    groups = " & ".join(
        rf"\multicolumn{{{each}}}{{c}}{{{latex(name)}}}" for name in table.estimators
    )
    head = [
        "Trial",
        *(["Type"] if kinds else []),
        "Length [m]",
        *[f"{name[:1].upper()}{name[1:]} [{unit}]" for name, unit in table.measures]
        * len(table.estimators),
    ]
    lines = [f"% {' '.join(note.split())}" for note in table.notes]
    lines += [
        rf"\begin{{tabular}}{{l{'l' * kinds}r{'r' * each * len(table.estimators)}}}",
        r"\hline",
    ]
    lines += [rf"{before}& {groups} \\".lstrip(), rf"{' & '.join(head)} \\", r"\hline"]
    lines += [_latex_row(row, table.has_kinds) for row in table.rows]
    return "\n".join([*lines, r"\hline", r"\end{tabular}", ""])


def _latex_row(row: TrialRow, has_kinds: bool) -> str:
    cells = [rf"\textbf{{{latex(text)}}}" if best else latex(text) for text, best in _cells(row)]
    name = (r"\quad " if row.is_aside else "") + latex(row.name)
    kind = [latex(row.kind)] if has_kinds else []
    return rf"{' & '.join([name, *kind, latex(length_text(row)), *cells])} \\"


def latex(text: str) -> str:
    """Text as LaTeX sets it, none of its signs taken for a command."""
    return "".join(_LATEX.get(sign, sign) for sign in text)


def _cells(row: TrialRow) -> Iterator[tuple[str, bool]]:
    """All errors of each estimator as text, and whether it is the least of its row."""
    best = [reads_least(column) for column in zip(*row.errors, strict=True)]
    for errors, are_best in zip(row.errors, zip(*best, strict=True), strict=True):
        yield from zip(map(figure_text, errors), are_best, strict=True)
