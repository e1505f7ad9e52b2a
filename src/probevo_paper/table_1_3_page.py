"""The page of thesis Table 1.3: the table, EM on the first loop (Fig. 1.20), and the paths."""

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
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.comparison.comparison_plots import paths_figure
from probevo.output.page import grid, panel, write_page
from probevo.output.svg import BLUE, CYCLE, GREY, LEGEND_ABOVE, WIDTH_IN, figure_style
from probevo.output.trial_table import TrialTable, trials_section
from probevo_paper.gk_tables import STATIC
from probevo_paper.table_1_3 import ESTIMATORS, loop_error_m

COLORS = dict(zip(ESTIMATORS, CYCLE, strict=False))


def write_loops_page(
    path: Path,
    comparison: Comparison,
    table: TrialTable,
    *,
    iterations: Sequence[Mapping[str, float]],
    training_loop: str,
) -> None:
    """Write the page. The same arguments give the same bytes.

    Args:
        path: the HTML file. Links to the reports of single runs are relative to it.
        comparison: the runs, with the static M-estimator's on the training loop.
        table: the runs in the form of the thesis.
        iterations: results of EM before the first iteration and after each.
        training_loop: name of the loop that was trained on.

    Raises:
        InputError: the file cannot be written.

    """
    static_m = {entry.estimator: loop_error_m(entry) for entry in comparison.of(training_loop)}.get(
        STATIC
    )
    with figure_style():
        progress = panel(
            "EM without truth",
            _progress_note(iterations, training_loop),
            progress_figure(iterations, static_m),
        )
        paths = [
            _paths_panel(comparison.of(name), path.parent)
            for name in comparison.sequences
            if name != training_loop
        ]
    facts = {
        "Trained on": training_loop,
        "EM iterations": f"{len(iterations) - 1}",
        "probevo": __version__,
    }
    write_page(
        path,
        "Learned noise from loops without truth: thesis Table 1.3",
        facts,
        sections=[trials_section(table), grid([progress, *paths])],
    )


def progress_figure(iterations: Sequence[Mapping[str, float]], static_m: float | None) -> Figure:
    """Draw likelihood and loop closure error over the iterations of EM.

    This is PROBE-GK Fig. 8, thesis Fig. 1.20.

    Args:
        iterations: ``log_likelihood`` and, where the ends are known, ``loop_error_m``, before the
            first iteration and after each.
        static_m: loop closure error of the static M-estimator; None if it did not run.

    """
    likelihoods = [iteration["log_likelihood"] for iteration in iterations]
    errors_m = [
        iteration["loop_error_m"] for iteration in iterations if "loop_error_m" in iteration
    ]
    count = 2 if errors_m else 1
    figure = Figure(figsize=(WIDTH_IN, 2.1 * count + 0.3))
    upper, *lower = figure.subplots(count, 1, sharex=True, squeeze=False)[:, 0]
    _draw(upper, likelihoods, "log-likelihood\na feature, nats")
    for axes in lower:
        if static_m is not None:
            axes.axhline(
                static_m,
                color=GREY,
                ls=(0, (4, 2.5)),
                lw=1.4,
                label=f"{STATIC}, the static M-estimator",
            )
        _draw(axes, errors_m, "loop closure\nerror, m", label="EM")
        axes.set_ylim(0, 1.12 * max(*errors_m, static_m or 0.0, 1e-6))
        axes.legend(ncols=2, **LEGEND_ABOVE)
    figure.axes[-1].set_xlabel("iteration of EM; 0 is the static Student-t fitted to the same loop")
    figure.axes[-1].xaxis.set_major_locator(MaxNLocator(integer=True))
    figure.align_ylabels()
    return figure


def _draw(axes: Axes, values: Sequence[float], label_y: str, label: str | None = None) -> None:
    """Draw one value for each iteration."""
    axes.plot(range(len(values)), values, "o-", color=BLUE, lw=1.6, ms=4, label=label)
    axes.set_ylabel(label_y)


def _progress_note(iterations: Sequence[Mapping[str, float]], training_loop: str) -> str:
    """Return the text above the figure of EM."""
    note = f"Training on {training_loop}, of which EM knows no pose, as in thesis Fig. 1.20."
    if not any("loop_error_m" in iteration for iteration in iterations):
        note += (
            " No truth says where the loop ends, and so no closure error is known for the"
            " iterations."
        )
    return note


def _paths_panel(entries: Sequence[Entry], folder: Path) -> Markup:
    """Return a panel with the paths of a loop over each other, and links to the runs' reports."""
    links = []
    for entry in entries:
        if entry.report is not None:
            address = quote(os.fsencode(Path(os.path.relpath(entry.report, folder)).as_posix()))
            links.append(f'<a href="{address}">{escape(entry.estimator)}</a>')
    name = entries[0].sequence
    note = Markup(
        f"Seen from above; a loop should end where it began. Reports: {', '.join(links)}."
    )
    figure = paths_figure([_with_drawable_truth(entry) for entry in entries], COLORS)
    identifier = "paths-" + "".join(c if c.isalnum() else "-" for c in name)
    return panel(name, note, figure, name=identifier)


def _with_drawable_truth(entry: Entry) -> Entry:
    """Return the run without its truth if that has gaps, and so is no path to draw."""
    is_whole = entry.truth is not None and bool(np.isfinite(entry.truth).all())
    return entry if is_whole else replace(entry, truth=None)
