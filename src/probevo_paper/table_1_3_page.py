"""The page of thesis Table 1.3: the table, EM on the first loop (thesis Fig. 1.20), and the paths."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from urllib.parse import quote

import numpy as np
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from probevo import __version__
from probevo.output.comparison import Comparison, Entry
from probevo.output.comparison_plots import paths_figure
from probevo.output.page import grid, panel, write_page
from probevo.output.svg import BLUE, CYCLE, GREY, LEGEND_ABOVE, WIDTH_IN, figure_style
from probevo.output.trial_table import TrialTable, trials_section
from probevo_paper.kernel_trials import STATIC
from probevo_paper.table_1_3 import ESTIMATORS, loop_error_m

COLORS = dict(zip(ESTIMATORS, CYCLE, strict=False))


def write_loops_page(
    path: Path,
    comparison: Comparison,
    table: TrialTable,
    turns: Sequence[Mapping[str, float]],
    first: str,
) -> None:
    """Write the page. The same arguments give the same bytes.

    Args:
        path: the HTML file. Links to the reports of single runs are relative to it.
        comparison: the runs, with that of the static M-estimator on the first loop.
        table: them in the form of the thesis.
        turns: what EM came to before the first turn and after each.
        first: name of the loop that was trained on.

    Raises:
        InputError: the file cannot be written.
    """
    static_m = {entry.estimator: loop_error_m(entry) for entry in comparison.of(first)}.get(STATIC)
    with figure_style():
        progress = panel(
            "EM without truth", _progress_note(turns, first), progress_figure(turns, static_m)
        )
        paths = [
            _paths_panel(comparison.of(name), path.parent)
            for name in comparison.sequences
            if name != first
        ]
    title = "Learned noise from loops without truth: thesis Table 1.3"
    facts = {"Trained on": first, "Turns of EM": f"{len(turns) - 1}", "probevo": __version__}
    write_page(path, title, facts, sections=[trials_section(table), grid([progress, *paths])])


def progress_figure(turns: Sequence[Mapping[str, float]], static_m: float | None) -> Figure:
    """Likelihood a feature and loop closure error against the turns of EM (PROBE-GK Fig. 8, thesis
    Fig. 1.20).

    Args:
        turns: ``log_likelihood`` and, where the ends are known, ``loop_error_m``, before the first
            turn and after each.
        static_m: loop closure error of the static M-estimator; None if it did not run.
    """
    gaps_m = [turn["loop_error_m"] for turn in turns if "loop_error_m" in turn]
    count = 2 if gaps_m else 1
    figure = Figure(figsize=(WIDTH_IN, 2.1 * count + 0.3))
    upper, *lower = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    _draw(upper, [turn["log_likelihood"] for turn in turns], "log-likelihood\na feature, nats")
    for axes in lower:
        if static_m is not None:
            axes.axhline(
                static_m,
                color=GREY,
                ls=(0, (4, 2.5)),
                lw=1.4,
                label=f"{STATIC}, the static M-estimator",
            )
        _draw(axes, gaps_m, "loop closure\nerror, m", label="EM")
        axes.set_ylim(0, 1.12 * max(*gaps_m, static_m or 0.0, 1e-6))
        axes.legend(ncols=2, **LEGEND_ABOVE)
    figure.axes[-1].set_xlabel("turn of EM; 0 is the static Student-t fitted to the same loop")
    figure.axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.align_ylabels()
    return figure


def _draw(axes: Axes, values: Sequence[float], label_y: str, label: str | None = None) -> None:
    axes.plot(range(len(values)), values, "o-", color=BLUE, lw=1.6, ms=4, label=label)
    axes.set_ylabel(label_y)


def _progress_note(turns: Sequence[Mapping[str, float]], first: str) -> str:
    note = f"Training on {first}, of which EM knows no pose, as in thesis Fig. 1.20."
    if not any("loop_error_m" in turn for turn in turns):
        note += (
            " No truth says where the loop ends, and so no closure error is known for the turns."
        )
    return note


def _paths_panel(entries: Sequence[Entry], folder: Path) -> Markup:
    """The paths of a loop over each other, with links to the reports of the runs."""
    links = [
        f'<a href="{quote(Path(os.path.relpath(entry.report, folder)).as_posix())}">{escape(entry.estimator)}</a>'
        for entry in entries
        if entry.report is not None
    ]
    name = entries[0].sequence
    note = Markup(
        f"Seen from above; a loop should end where it began. Reports: {', '.join(links)}."
    )
    figure = paths_figure([_without_gaps(entry) for entry in entries], COLORS)
    return panel(
        name, note, figure, name="paths-" + "".join(c if c.isalnum() else "-" for c in name)
    )


def _without_gaps(entry: Entry) -> Entry:
    """Without a truth of which there is no path to draw."""
    whole = entry.truth is not None and bool(np.isfinite(entry.truth).all())
    return entry if whole else replace(entry, truth=None)
