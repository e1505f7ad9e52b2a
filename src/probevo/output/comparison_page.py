"""One self-contained page that shows several estimators side by side."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from urllib.parse import quote

from probevo.output.comparison import (
    COLUMNS,
    TIME_COLUMN,
    Comparison,
    Entry,
    column_notes,
    figure_texts,
    label,
    reads_least,
)
from probevo.output.comparison_plots import errors_figure, paths_figure
from probevo.output.metrics_table import readable
from probevo.output.page import frames_section, grid, panel, write_page
from probevo.output.svg import CYCLE, figure_style
from probevo.output.trial_table import TrialTable, trials_section

_MOST_PICTURES = 4
"""Of one sequence; with more estimators than that, one of each."""


def write_comparison(
    path: Path,
    comparison: Comparison,
    title: str,
    facts: Mapping[str, str],
    trials: TrialTable | None = None,
) -> None:
    """Write the page. The same arguments give the same bytes.

    Args:
        path: the HTML file. Links to the reports of single runs are relative to it.
        comparison: runs of at least two frames each.
        title: heading of the page.
        facts: what a reader should know beforehand, by name.
        trials: a table to show besides.

    Raises:
        ValueError: there is nothing to compare, or a run has fewer than two frames.
        InputError: the file cannot be written.
    """
    if not comparison.entries or min(len(entry.result) for entry in comparison.entries) < 2:
        raise ValueError("a comparison needs one run at least, and each run two frames")
    colors = {name: CYCLE[k % len(CYCLE)] for k, name in enumerate(comparison.estimators)}
    sections = [_table_section(comparison, colors, path.parent)]
    if trials is not None:
        sections.append(trials_section(trials))
    for number, sequence in enumerate(comparison.sequences):
        sections += _sequence_sections(comparison.of(sequence), colors, number)
    write_page(path, title, facts, sections=sections)


def _table_section(comparison: Comparison, colors: Mapping[str, str], folder: Path) -> str:
    head = "".join(f"<th>{name}</th>" for name in ("estimator", *comparison.columns, ""))
    bodies = []
    for sequence in comparison.sequences:
        entries = comparison.of(sequence)
        rows = [
            '<tr class="group"><th'
            f' colspan="{len(comparison.columns) + 2}">{escape(sequence)}</th></tr>'
        ]
        cells = [figure_texts(entry, comparison.columns) for entry in entries]
        rows += [
            _row(*row, colors, folder)
            for row in zip(entries, cells, _best(entries, len(cells[0])), strict=True)
        ]
        bodies.append("<tbody>\n" + "\n".join(rows) + "\n</tbody>")
    note = (
        "Position errors with the starts made equal; drift and rotation over pieces of 10 to 50 m;"
        " median time, without decoding. Bold: the least of a sequence."
    )
    note = " ".join([note, *column_notes(comparison)])
    table = (
        f'<table class="figures"><thead><tr>{head}</tr></thead>\n' + "\n".join(bodies) + "</table>"
    )
    return (
        '<section class="panel"><h2>Figures of merit</h2><p'
        f' class="note">{note}</p>\n{table}</section>'
    )


def _row(
    entry: Entry,
    texts: Sequence[str],
    best: Sequence[bool],
    colors: Mapping[str, str],
    folder: Path,
) -> str:
    swatch = f'<i class="swatch" style="background:{colors[entry.estimator]}"></i>'
    cells = "".join(
        f'<td class="best">{text}</td>' if is_best else f"<td>{text}</td>"
        for text, is_best in zip(texts, best, strict=True)
    )
    link = ""
    if entry.report is not None:
        # Paths as a browser reads them, whatever the system's separator and whatever characters are
        # in a name.
        link = (
            f'<a href="{quote(Path(os.path.relpath(entry.report, folder)).as_posix())}">report</a>'
        )
    return f"<tr><th>{swatch}{escape(label(entry))}</th>{cells}<td>{link}</td></tr>"


def _best(entries: Sequence[Entry], count: int) -> list[list[bool]]:
    """Of each entry, which of its ``count`` figures is an error that reads as the least; none
    without a rival, or of an entry that has seen the recording before."""
    unseen = [
        (None,) * len(COLUMNS) if entry.learned_from_it else entry.figures for entry in entries
    ]
    columns = [reads_least(column) for column in zip(*unseen, strict=True)]
    columns[TIME_COLUMN] = [False] * len(entries)  # decided by a hair, and otherwise the next time
    columns += [[False] * len(entries)] * (count - len(columns))  # what is not an error
    return [list(row) for row in zip(*columns, strict=True)]


def _sequence_sections(
    entries: Sequence[Entry], colors: Mapping[str, str], number: int
) -> list[str]:
    sequence = entries[0].sequence
    metrics = entries[0].metrics
    length = (
        f", {readable(metrics.path_length_m)} m"
        if metrics and metrics.path_length_m is not None
        else ""
    )
    aside = f"{len(entries[0].result):,} frames{length}"
    known = metrics is not None and metrics.armse_m is not None
    above = "The paths over the true one" if known else "No truth is known"
    claims = "Dashed: what each run itself claims as 3σ, in its worst direction."
    with figure_style():
        paths = panel(
            "Seen from above",
            f"{above}; forward is up.",
            paths_figure(entries, colors),
            name=f"paths-{number}",
        )
        what = "Error along the path" if known else "Claimed uncertainty"
        errors = panel(what, claims, errors_figure(entries, colors), name=f"errors-{number}")
    heading = f'<h2 class="sequence">{escape(sequence)}<small>{aside}</small></h2>'
    return [heading, grid([paths, errors]), frames_section(_pictures(entries))]


def _pictures(entries: Sequence[Entry]) -> list[tuple[str, bytes]]:
    """Pictures of as many frames as fit, spread over the run; those of the same frame beside each
    other."""
    shown = [entry for entry in entries if entry.pictures]
    if not shown:
        return []
    available = min(len(entry.pictures) for entry in shown)
    count = min(max(_MOST_PICTURES // len(shown), 1), available)
    frames = [(2 * k + 1) * available // (2 * count) for k in range(count)]
    return [
        (f"{entry.estimator} · {caption}", jpeg)
        for frame in frames
        for entry in shown
        for caption, jpeg in [entry.pictures[frame]]
    ]
