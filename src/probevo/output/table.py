"""Tables, shown as text, LaTeX, HTML and CSV."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any, Literal

from markupsafe import Markup

from probevo.output.templating import rendered

UNKNOWN_TEXT = "–"
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


def readable(value: float) -> str:
    """Format a number with three significant figures, never in scientific notation."""
    if not math.isfinite(value):
        return str(value)
    if abs(value) < 1e-9 or isinstance(value, int):
        return f"{value:,.0f}"
    rounded = float(f"{value:.3g}")
    decimals = max(0, 2 - math.floor(math.log10(abs(rounded))))
    return f"{value:,.{decimals}f}"


def figure_text(value: float | None) -> str:
    """Format a figure with three significant digits; a dash where it is unknown."""
    return UNKNOWN_TEXT if value is None else readable(value)


@dataclass(frozen=True)
class Column:
    """One column of a table: what its head says, and how its values are shown."""

    title: str
    unit: str = ""
    format: Callable[[Any], str] = figure_text
    """Turns the value of a cell into text."""
    align: Literal["left", "right"] = "right"
    group: str = ""
    """Name of the neighbouring columns that share a head, such as those of one estimator. As text,
    the values of a group stand in one column, with strokes between them."""

    @property
    def head(self) -> str:
        """Title and unit, as text and HTML show them."""
        return f"{self.title} {self.unit}".strip()


@dataclass(frozen=True)
class Cell:
    """One value of a table."""

    value: Any
    """Number or text, at full precision; None where unknown."""
    is_best: bool = False
    """Whether the value is the best of those that it is compared with, and set in bold."""
    unit: str = ""
    """Unit in small print behind the value; in HTML only."""
    color: str = ""
    """Colour of a swatch before the value, as CSS writes it; in HTML only."""
    href: str = ""
    """Target of the link on the value; in HTML only."""


@dataclass(frozen=True)
class Row:
    """One row of a table; its first cell is its name."""

    cells: tuple[Cell, ...]
    section: str = ""
    """Heading under which it stands, together with its neighbours of the same section."""
    is_aside: bool = False
    """Whether the row is an aside of the one above, such as published figures."""

    @staticmethod
    def of(*values: Any, section: str = "", is_aside: bool = False) -> Row:
        """Make a row of plain values."""
        return Row(tuple(Cell(value) for value in values), section, is_aside)

    def cells_by_column(self, columns: Sequence[Column]) -> list[tuple[Column, Cell]]:
        """Pair each cell with its column."""
        return list(zip(columns, self.cells, strict=True))


@dataclass(frozen=True)
class Table:
    """A table of R rows and C columns."""

    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    """Notes below the table, one sentence each."""

    @property
    def has_head(self) -> bool:
        """Whether any column has a title."""
        return any(column.title for column in self.columns)

    @property
    def heads(self) -> tuple[str, ...]:
        """Titles of the columns."""
        return tuple(column.title for column in self.columns)

    @property
    def groups(self) -> list[tuple[str, int]]:
        """Name and number of columns of each group, from left to right."""
        runs = groupby(column.group for column in self.columns)
        return [(name, len(list(run))) for name, run in runs if name]

    @property
    def sections(self) -> list[tuple[str, list[Row]]]:
        """Heading and rows of each section, from top to bottom."""
        return [(name, list(rows)) for name, rows in groupby(self.rows, lambda row: row.section)]

    def without(self, *titles: str) -> Table:
        """Leave out the columns of these titles."""
        kept = [k for k, column in enumerate(self.columns) if column.title not in titles]
        return replace(
            self,
            columns=tuple(self.columns[k] for k in kept),
            rows=tuple(replace(row, cells=tuple(row.cells[k] for k in kept)) for row in self.rows),
        )

    def text_rows(self) -> list[tuple[str, ...]]:
        """Show head and rows as text: a row with its name alone before each section.

        All values of a group of columns share a cell, padded such that they stand below each other.
        """
        texts = [
            [column.format(cell.value) for column, cell in row.cells_by_column(self.columns)]
            for row in self.rows
        ]
        # All columns of a group become one.
        merged_head = []
        merged_columns = []
        for members in self._merged_columns():
            first = self.columns[members[0]]
            merged_head.append(first.group or first.head)
            merged_columns.append(_joined([[text[k] for text in texts] for k in members]))
        # A section begins where a row names another one than the row before.
        rows = [tuple(merged_head)]
        previous_section = ""
        for row, merged in zip(self.rows, zip(*merged_columns, strict=True), strict=True):
            if row.section and row.section != previous_section:
                rows.append((row.section, *("" for _ in merged_head[1:])))
            previous_section = row.section
            indent = "  " if row.section or row.is_aside else ""
            rows.append((indent + merged[0], *merged[1:]))
        return rows

    def as_text(self) -> str:
        """Show the table as plain text, its columns aligned, a rule below the head."""
        rows = self.text_rows()
        alignments = [self.columns[members[0]].align for members in self._merged_columns()]
        widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
        rows.insert(1, tuple("─" * width for width in widths))
        lines = []
        for row in rows:
            cells = [
                text.ljust(width) if align == "left" else text.rjust(width)
                for text, width, align in zip(row, widths, alignments, strict=True)
            ]
            lines.append("  ".join(cells).rstrip())
        return "\n".join(lines)

    def as_latex(self) -> str:
        """Show the table as a ``tabular`` that needs no package; notes are comments above it."""
        alignments = "".join(column.align[0] for column in self.columns)
        lines = [f"% {' '.join(note.split())}" for note in self.notes]
        lines += [rf"\begin{{tabular}}{{{alignments}}}", r"\hline"]
        if self.groups:
            lines.append(" ".join(_latex_row(self._latex_group_heads()).split()))
        lines += [_latex_row([_latex_head(column) for column in self.columns]), r"\hline"]
        for section, rows in self.sections:
            if section:
                width = len(self.columns)
                lines.append(_latex_row([rf"\multicolumn{{{width}}}{{l}}{{{latex(section)}}}"]))
            lines += [_latex_row(self._latex_cells(row)) for row in rows]
        return "\n".join([*lines, r"\hline", r"\end{tabular}", ""])

    def as_html(self, style: str = "figures") -> Markup:
        """Show the table as HTML, with a class of ``style.css``."""
        return rendered("table", table=self, style=style)

    def as_csv(self) -> str:
        """Show the table as CSV: numbers at full precision, nothing where unknown."""
        buffer = io.StringIO()
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(f"{column.group} {column.head}".strip() for column in self.columns)
        writer.writerows([cell.value for cell in row.cells] for row in self.rows)
        return buffer.getvalue()

    def _merged_columns(self) -> list[list[int]]:
        """Find the indices of the columns that share a cell of the text: those of each group."""
        runs = groupby(range(len(self.columns)), lambda k: self.columns[k].group or k)
        return [list(members) for _, members in runs]

    def _latex_group_heads(self) -> list[str]:
        """Make the cells of the row above the head, one for each group, empty ones between."""
        heads = []
        for name, run in groupby(column.group for column in self.columns):
            count = len(list(run))
            grouped = rf"\multicolumn{{{count}}}{{c}}{{{latex(name)}}}"
            heads += [grouped] if name else [""] * count
        return heads

    def _latex_cells(self, row: Row) -> list[str]:
        """Make the cells of a row; an aside is indented."""
        cells = []
        for column, cell in row.cells_by_column(self.columns):
            text = latex(column.format(cell.value))
            cells.append(rf"\textbf{{{text}}}" if cell.is_best else text)
        if row.is_aside:
            cells[0] = rf"\quad {cells[0]}"
        return cells


def records_table(records: Iterable[Mapping[str, object]]) -> Table:
    """Make a table of records that all have the keys of the first, one a row."""
    records = list(records)
    names = list(records[0])
    return Table(
        columns=tuple(Column(name, format=str) for name in names),
        rows=tuple(Row.of(*(record[name] for name in names)) for record in records),
    )


def text_table(
    head: Sequence[str],
    rows: Iterable[Sequence[str]],
    left: Collection[int] = (0,),
) -> Table:
    """Make a table of texts.

    Args:
        head: title of each column.
        rows: the texts of each row.
        left: numbers of the columns that are aligned at the left.
    """
    columns = [
        Column(title, format=str, align="left" if k in left else "right")
        for k, title in enumerate(head)
    ]
    return Table(tuple(columns), tuple(Row.of(*row) for row in rows))


def reads_least(values: Sequence[float | None]) -> list[bool]:
    """Find which of the values a reader takes for the least, after rounding.

    None of them is the least where there are fewer than two known values to compare.
    """
    known = [value for value in values if value is not None]
    least = figure_text(min(known)) if len(known) > 1 else None
    return [value is not None and figure_text(value) == least for value in values]


def latex(text: str) -> str:
    """Escape text for LaTeX, such that none of its signs is taken for a command."""
    return "".join(_LATEX.get(sign, sign) for sign in text)


def _latex_row(cells: Sequence[str]) -> str:
    """Join cells to a row."""
    return rf"{' & '.join(cells)} \\"


def _latex_head(column: Column) -> str:
    """Write the head of a column as the papers do: a capital, and the unit in brackets."""
    title = latex(column.title[:1].upper() + column.title[1:])
    return f"{title} [{latex(column.unit)}]" if column.unit else title


def _joined(columns: Sequence[Sequence[str]]) -> list[str]:
    """Join the texts of each row, [R], with strokes; those of several columns are padded."""
    if len(columns) == 1:
        return list(columns[0])
    widths = [max(map(len, column), default=0) for column in columns]
    return [
        " / ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
        for row in zip(*columns, strict=True)
    ]
