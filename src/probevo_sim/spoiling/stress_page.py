"""Picture and page of how the odometry fares on spoiled versions of a recording."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullLocator

from probevo.output.page import body_panel, pictures, row_panel, table_panel, write_page
from probevo.output.svg import BLUE, CYCLE, GREY, ORANGE, WIDTH_IN, figure_style
from probevo.output.table import Column, Row, Table
from probevo.storage.files import write_atomically
from probevo_sim.spoiling.stress import REGION, Figures, Stress

MAX_OUTSIDE = 0.01
"""Share of the steps that are OK that may lie outside of the region; more is marked."""
MIN_OK = 0.97
"""Share of the steps that should be OK; less is marked."""
MAX_LABELLED = 30.0
"""Ratio of the ends of a logarithmic axis up to which 1, 2 and 5 of each decade have room."""
_PNG_DPI = 150
_IN_DEG = 180.0 / np.pi


def stress_table(stress: Stress) -> Table:
    """Make the table of all presets and severities."""
    columns = (
        Column("severity", align="left"),
        Column("steps", format=str),
        Column("OK", "%"),
        Column("error", "mm"),
        Column("claimed σ", "mm"),
        Column("error", "°"),
        Column("claimed σ", "°"),
        Column("outside", "%"),
        Column("not OK: error", "m"),
        Column("claimed σ", "m"),
    )
    rows = [
        Row.of(
            figures.severity,
            figures.steps,
            100.0 * figures.ok,
            _times(figures.translation_m, 1e3),
            _times(figures.translation_sigma_m, 1e3),
            _times(figures.rotation_rad, _IN_DEG),
            _times(figures.rotation_sigma_rad, _IN_DEG),
            _times(figures.outside, 100.0),
            figures.not_ok_m,
            figures.not_ok_sigma_m,
            section=figures.preset,
        )
        for preset in stress.presets
        for figures in stress.of(preset)
    ]
    return Table(columns, tuple(rows))


def stress_notes(stress: Stress) -> list[str]:
    """Say in sentences where steps are lost, and where the claim does not cover the error."""
    percent = 100.0 * REGION
    few = [_place(each) for each in stress.figures if each.ok < MIN_OK]
    wrong = [
        f"{_place(each)} ({round(each.outside * each.num_ok)} of {each.num_ok})"
        for each in stress.figures
        if each.outside is not None and each.outside > MAX_OUTSIDE
    ]
    notes = []
    if few:
        notes.append(f"Less than {100.0 * MIN_OK:g} % of the steps are OK: {', '.join(few)}.")
    else:
        notes.append(f"At least {100.0 * MIN_OK:g} % of the steps are OK everywhere.")
    if wrong:
        notes.append(
            f"More than {100.0 * MAX_OUTSIDE:g} % of the OK steps lie outside of their"
            f" {percent:.2f} % region: {', '.join(wrong)}."
        )
    else:
        notes.append(
            f"Nowhere do more than {100.0 * MAX_OUTSIDE:g} % of the OK steps lie outside of their"
            f" {percent:.2f} % region."
        )
    return notes


@dataclass(frozen=True)
class ErrorPart:
    """A part of the error of a step, and how it is drawn."""

    label: str
    factor: float
    """From m or rad to the unit of the label."""
    error: Callable[[Figures], float | None]
    claim: Callable[[Figures], float | None]
    clean: Callable[[Stress], float]
    """What is claimed on the clean images."""


TRANSLATION = ErrorPart(
    label="translation, mm",
    factor=1e3,
    error=lambda figures: figures.translation_m,
    claim=lambda figures: figures.translation_sigma_m,
    clean=lambda stress: stress.clean_sigma_m,
)
ROTATION = ErrorPart(
    label="rotation, °",
    factor=_IN_DEG,
    error=lambda figures: figures.rotation_rad,
    claim=lambda figures: figures.rotation_sigma_rad,
    clean=lambda stress: stress.clean_sigma_rad,
)


def errors_figure(stress: Stress, parts: Sequence[ErrorPart] = (TRANSLATION, ROTATION)) -> Figure:
    """Draw the error of a step and its claimed σ against the severity: a row for each preset, a
    column for each part."""
    num_rows = len(stress.presets)
    figure = Figure(figsize=(WIDTH_IN * len(parts), 0.7 + 1.5 * num_rows))
    grid = figure.subplots(num_rows, len(parts), sharex=True, sharey="col", squeeze=False)
    for row, preset in zip(grid, stress.presets, strict=True):
        figures = [each for each in stress.of(preset) if each.num_ok]
        for axes, part in zip(row, parts, strict=True):
            _draw_errors(axes, figures, part, clean=part.clean(stress))
            axes.set_title(f"{preset}: {part.label}")
    for axes in grid[-1]:
        axes.set(xlabel="severity")
        _set_log_ticks(axes)
    handles, labels = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=3)
    return figure


def ok_figure(stress: Stress) -> Figure:
    """Draw which share of the steps is OK."""
    figure = Figure(figsize=(WIDTH_IN, 3.4))
    axes = figure.subplots()
    _draw_shares(figure, axes, stress, lambda each: each.ok)
    axes.set(ylabel="OK, % of the steps", ylim=(0.0, 105.0))
    return figure


def outside_figure(stress: Stress) -> Figure:
    """Draw which share of the steps that are OK is worse than claimed."""
    figure = Figure(figsize=(WIDTH_IN, 3.4))
    axes = figure.subplots()
    _draw_shares(figure, axes, stress, lambda each: each.outside)
    axes.axhline(100.0 * (1.0 - REGION), color=GREY, lw=0.9, ls="--")
    axes.set_ylabel(f"outside of {100.0 * REGION:.2f} %, % of those OK")
    axes.set_ylim(bottom=0.0)
    return figure


def write_stress_page(path: Path, stress: Stress, title: str, facts: Mapping[str, str]) -> None:
    """Write the page. The same arguments give the same bytes.

    Raises:
        InputError: the file cannot be written.
    """
    with figure_style():
        errors = row_panel(
            "Error against claim",
            "RMS of the steps that are OK, against the run on the clean images. The dashed σ is"
            " that of both runs together; where the error lies above it, the claim is"
            " overconfident.",
            [errors_figure(stress, [part]) for part in (TRANSLATION, ROTATION)],
        )
        shares = row_panel(
            "Steps that are lost, and steps that are wrong",
            "Lost: not OK. Wrong: OK, but their error lies outside of their"
            f" {100.0 * REGION:.2f} % region; the dashed line is what chance alone would give.",
            [ok_figure(stress), outside_figure(stress)],
        )
    sections = [
        body_panel("In short", stress_notes(stress), ""),
        errors,
        shares,
        table_panel(
            "Figures",
            [
                "RMS of the steps that are OK; outside: their share outside of the"
                f" {100.0 * REGION:.2f} % region. Right: the steps that are not OK."
            ],
            stress_table(stress),
        ),
    ]
    if stress.pictures:
        sections.append(body_panel("What was done", [], pictures(stress.pictures)))
    write_page(path, title, facts, sections=sections)


def write_picture(path: Path, stress: Stress) -> None:
    """Write the figure of errors and claims as PNG.

    Raises:
        InputError: the file cannot be written.
    """
    buffer = io.BytesIO()
    with figure_style():
        figure = errors_figure(stress)
        figure.savefig(buffer, format="png", dpi=_PNG_DPI, facecolor="white")
    write_atomically(path, buffer.getvalue())


def _draw_errors(axes: Axes, figures: Sequence[Figures], part: ErrorPart, *, clean: float) -> None:
    """Draw errors and claims of one preset, and what is claimed on the clean images."""
    severities = [each.severity for each in figures]
    errors = [part.factor * (part.error(each) or 0.0) for each in figures]
    claims = [part.factor * (part.claim(each) or 0.0) for each in figures]
    axes.plot(severities, errors, "o-", color=BLUE, ms=4, label="error")
    axes.plot(severities, claims, "s--", color=ORANGE, ms=3.5, label="claimed σ, both runs")
    axes.axhline(
        part.factor * clean, color=GREY, lw=0.9, ls=":", label="claimed σ, clean images alone"
    )
    axes.set(yscale="log", xlim=(0.0, 1.05))


def _set_log_ticks(axes: Axes) -> None:
    """Label as many values of a logarithmic axis as have room: powers of ten, if it is long."""
    low, high = axes.get_ylim()
    is_long = high > MAX_LABELLED * low
    axes.yaxis.set_major_locator(LogLocator(subs=(1.0,) if is_long else (1.0, 2.0, 5.0)))
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.yaxis.set_minor_locator(NullLocator())


def _draw_shares(
    figure: Figure, axes: Axes, stress: Stress, share: Callable[[Figures], float | None]
) -> None:
    """Draw a share against the severity, %, a line for each preset."""
    for k, preset in enumerate(stress.presets):
        figures = stress.of(preset)
        shares = [share(each) for each in figures]
        axes.plot(
            [each.severity for each in figures],
            [float("nan") if each is None else 100.0 * each for each in shares],
            "o-",
            color=CYCLE[k % len(CYCLE)],
            label=preset,
        )
    axes.set(xlabel="severity", xlim=(0.0, 1.05))
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper left", ncols=4)


def _place(figures: Figures) -> str:
    return f"{figures.preset} {figures.severity:g}"


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else factor * value
