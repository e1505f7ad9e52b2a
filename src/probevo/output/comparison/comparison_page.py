"""Self-contained page that shows several estimators side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from markupsafe import Markup

from probevo.output.comparison.comparison import (
    Comparison,
    Entry,
    column_notes,
    comparison_table,
    verdicts,
)
from probevo.output.comparison.comparison_plots import (
    axes_errors_figures,
    errors_figure,
    paths_figure,
)
from probevo.output.comparison.without_truth import without_truth
from probevo.output.page import (
    body_panel,
    frames_section,
    grid,
    heading,
    panel,
    row_panel,
    table_panel,
    write_page,
)
from probevo.output.svg import CYCLE, figure_style
from probevo.output.table import readable
from probevo.output.trial_table import TrialTable, trials_section

_MAX_PICTURES = 4
"""Pictures of one sequence; with more estimators than that, there is one of each."""


def write_comparison(
    path: Path,
    comparison: Comparison,
    title: str,
    facts: Mapping[str, str],
    trials: TrialTable | None = None,
    *,
    links_from: Path | None = None,
    remarks: Sequence[str] = (),
) -> None:
    """Write the page. The same arguments give the same bytes.

    Args:
        path: the HTML file.
        comparison: runs of at least two frames each.
        title: heading of the page.
        facts: what a reader should know beforehand, by name.
        trials: a table to show besides, unless no truth is known.
        links_from: the folder that links to the reports of single runs are relative to, by default
            that of ``path``.
        remarks: further sentences for the short version at the top.

    Raises:
        ValueError: there is nothing to compare, or a run has fewer than two frames.
        InputError: the file cannot be written.
    """
    if not comparison.entries or min(len(entry.result) for entry in comparison.entries) < 2:
        raise ValueError("a comparison needs one run at least, and each run two frames")
    colors = {name: CYCLE[k % len(CYCLE)] for k, name in enumerate(comparison.estimators)}
    sections: list[Markup] = []
    sentences = [*verdicts(comparison), *remarks, *without_truth(comparison)]
    if sentences:
        sections.append(body_panel("In short", sentences, ""))
    sections.append(_table_section(comparison, colors, links_from or path.parent))
    if trials is not None and any(entry.has_truth for entry in comparison.entries):
        sections.append(trials_section(trials))
    for number, sequence in enumerate(comparison.sequences):
        sections += _sequence_sections(comparison.of(sequence), colors, number)
    write_page(path, title, facts, sections=sections)


def _table_section(comparison: Comparison, colors: Mapping[str, str], folder: Path) -> Markup:
    note = (
        "Position errors with the starts made equal; drift and rotation over segments of 10 to 50"
        " m; median time, without decoding. Bold: the least of a sequence, and whatever cannot be"
        " distinguished from it; nothing, if no difference exceeds the noise of repetition."
    )
    table = comparison_table(comparison, colors, folder)
    notes = " ".join([note, *column_notes(comparison)])
    return table_panel("Figures of merit", [notes], table)


def _sequence_sections(
    entries: Sequence[Entry], colors: Mapping[str, str], number: int
) -> list[Markup]:
    """Show the paths, the errors and some frames of the runs over one sequence."""
    metrics = entries[0].metrics
    aside = f"{len(entries[0].result):,} frames"
    if metrics is not None and metrics.path_length_m is not None:
        aside += f", {readable(metrics.path_length_m)} m"
    has_truth = entries[0].has_truth
    with figure_style():
        paths = panel(
            "Seen from above",
            ("The paths over the true one" if has_truth else "No truth is known")
            + "; forward is up.",
            paths_figure(entries, colors),
            name=f"paths-{number}",
        )
        errors = panel(
            "Error along the path" if has_truth else "Claimed uncertainty",
            "Dashed: what each run itself claims as 3σ, in its worst direction.",
            errors_figure(entries, colors),
            name=f"errors-{number}",
        )
        axis_panels = []
        if has_truth:
            axis_panels.append(
                row_panel(
                    "Error by axis",
                    "Pose along each run’s own camera axes; each scale is that of its errors.",
                    axes_errors_figures(entries, colors),
                    name=f"axes-{number}",
                )
            )
    return [
        heading(entries[0].sequence, aside),
        grid([paths, errors]),
        *axis_panels,
        frames_section(_pictures(entries)),
    ]


def _pictures(entries: Sequence[Entry]) -> list[tuple[str, bytes]]:
    """Choose pictures of some frames, spread over the run; those of one frame are neighbours."""
    shown = [entry for entry in entries if entry.pictures]
    if not shown:
        return []
    available = min(len(entry.pictures) for entry in shown)
    count = min(max(_MAX_PICTURES // len(shown), 1), available)
    # The middle of each of ``count`` equal parts of the run.
    frames = [(2 * k + 1) * available // (2 * count) for k in range(count)]
    return [
        (f"{entry.estimator} · {caption}", jpeg)
        for frame in frames
        for entry in shown
        for caption, jpeg in [entry.pictures[frame]]
    ]
