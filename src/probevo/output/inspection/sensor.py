"""The page on a learned sensor: its errors against the σ that it claims, on a recording."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import LogFormatter
from scipy.stats import chi2

from probevo.arrays import FloatArray
from probevo.geometry.uncertainty import squared_mahalanobis
from probevo.output.inspection.plots import NARROW_IN
from probevo.output.page import grid, panel, table_panel, write_page
from probevo.output.svg import BLUE, GREY, figure_style
from probevo.output.table import text_table
from probevo.sensor_kinds import SensorErrors

SHARES = np.array([0.1, 0.25, 0.5, 0.68, 0.8, 0.9, 0.95, 0.99])
"""Regions whose share of errors is shown."""
BINS = 5
"""Groups of equal size, by claimed σ."""


def write_sensor_inspection(
    out: Path, name: str, recording: str, *, errors: SensorErrors, learned_from_it: bool = False
) -> list[str]:
    """Write the page ``inspection.html``; return the lines to print.

    Args:
        out: its folder.
        name: name of the sensor's file.
        recording: name of the recording.
        errors: errors of the sensor on the recording.
        learned_from_it: whether the sensor was trained or calibrated on this recording.

    Raises:
        InputError: the file cannot be written.
    """
    covered = coverage_of(errors)
    rows = [
        (f"{share:.0%}", f"{share_covered:.0%}")
        for share, share_covered in zip(SHARES, covered, strict=True)
    ]
    squared = squared_mahalanobis(errors.errors, errors.covariances)
    scale = float(np.mean(squared) / errors.errors.shape[1])
    facts = {
        "Recording": recording,
        "Measurements": f"{len(errors.errors):,}",
        **_axis_facts(errors),
        "φᵀ Σ⁻¹ φ / d, mean": f"{scale:.2f} (1 is consistent, more is overconfident)",
        "Out of its domain": f"{errors.num_out_of_domain:,} of {len(errors.errors):,} widened",
        "Silent": f"{errors.num_silent:,} more inputs, too far out of its domain to be measured",
    }
    if errors.kept:
        facts["Kept"] = errors.kept
    if learned_from_it:
        facts["Learned"] = "from this recording, and so this is no test of it"
    table = text_table(("region", "errors within"), rows)
    with figure_style():
        panels = [panel("Calibration", "Consistent is on the grey line.", _calibration(covered))]
        for kind in _kinds_of_axes(errors):
            panels.append(
                panel(
                    f"{kind.name} against claimed σ",
                    "RMS of all axes, in groups of equal size; consistent is on the grey line.",
                    _against_claimed(errors, kind),
                )
            )
        if errors.saliency is not None:
            panels.append(
                panel(
                    "Saliency",
                    "How much the loss depends on each place of the image: the mean of its"
                    " derivative's size. Bright places decide.",
                    _saliency(errors.saliency),
                )
            )
    sections = [grid(panels), table_panel("Errors within their regions", [], table)]
    page = out / "inspection.html"
    write_page(page, f"What {name} measures", facts, sections)
    return [
        *(f"{key}: {value}" for key, value in facts.items()),
        "",
        table.as_text(),
        f"page: {page}",
    ]


def coverage_of(errors: SensorErrors) -> FloatArray:
    """Return the share of errors within the regions that should hold ``SHARES`` of them."""
    squared = squared_mahalanobis(errors.errors, errors.covariances)
    bounds = chi2.ppf(SHARES, errors.errors.shape[1])
    covered: FloatArray = np.mean(squared[:, None] <= bounds, axis=0)
    return covered


def claimed_and_actual(
    errors: SensorErrors, axes: slice = slice(None)
) -> tuple[FloatArray, FloatArray]:
    """Return RMS claimed σ and RMS error of groups of equal size by claimed σ, axes as one."""
    variances = _variances(errors)[:, axes].ravel()
    order = np.argsort(variances, kind="stable")
    groups = [group for group in np.array_split(order, BINS) if len(group)]
    squares = (errors.errors[:, axes] ** 2).ravel()
    claimed = [np.sqrt(np.mean(variances[group])) for group in groups]
    actual = [np.sqrt(np.mean(squares[group])) for group in groups]
    return np.array(claimed), np.array(actual)


class _KindOfAxes(NamedTuple):
    """Axes of the errors that have one unit."""

    name: str
    axes: slice
    unit: str
    factor: float
    """Factor from m or rad to the unit."""
    label: str
    """Name of the axes, in words."""


def _kinds_of_axes(errors: SensorErrors) -> list[_KindOfAxes]:
    """Return the lengths, if there are any, and the angles."""
    lengths = errors.num_lengths
    angle_label = "about x, y, z" if errors.errors.shape[1] - lengths == 3 else "of both angles"
    angles = _KindOfAxes("Error of angles", slice(lengths, None), "°", 180.0 / np.pi, angle_label)
    if not lengths:
        return [angles._replace(name="Error")]
    return [_KindOfAxes("Error of lengths", slice(lengths), " mm", 1e3, "along x, y, z"), angles]


def _axis_facts(errors: SensorErrors) -> dict[str, str]:
    """Return RMS errors and claimed σ of each axis, as the page names them."""
    rms = np.sqrt(np.mean(errors.errors**2, axis=0))
    claimed = np.sqrt(np.mean(_variances(errors), axis=0))
    facts = {}
    for kind in _kinds_of_axes(errors):
        for name, values in (("RMS error", rms), ("Claimed σ, RMS,", claimed)):
            texts = [f"{kind.factor * value:.3f}{kind.unit}" for value in values[kind.axes]]
            facts[f"{name} {kind.label}"] = ", ".join(texts)
    return facts


def _variances(errors: SensorErrors) -> FloatArray:
    """Return the claimed variances of each axis, [N, d]."""
    variances: FloatArray = np.diagonal(errors.covariances, axis1=1, axis2=2)
    return variances


def _calibration(covered: FloatArray) -> Figure:
    figure = Figure(figsize=(NARROW_IN, 2.9))
    axes = figure.subplots()
    axes.plot([0, 1], [0, 1], color=GREY, lw=0.8)
    axes.plot(SHARES, covered, color=BLUE, marker="o", ms=4, lw=1.5)
    axes.set(xlabel="share that the region should hold", ylabel="share that it holds")
    return figure


def _against_claimed(errors: SensorErrors, kind: _KindOfAxes) -> Figure:
    claimed, actual = (kind.factor * values for values in claimed_and_actual(errors, kind.axes))
    figure = Figure(figsize=(NARROW_IN, 2.9))
    axes = figure.subplots()
    reach = [min(claimed.min(), actual.min()), max(claimed.max(), actual.max())]
    axes.plot(reach, reach, color=GREY, lw=0.8)
    axes.plot(claimed, actual, color=BLUE, marker="o", ms=4, lw=1.5)
    unit = kind.unit.strip()
    axes.set(xlabel=f"claimed σ, {unit}", ylabel=f"RMS error, {unit}", xscale="log", yscale="log")
    # Plain numbers, also between powers of ten, of which such a narrow range may have none.
    for axis in (axes.xaxis, axes.yaxis):
        axis.set_major_formatter(LogFormatter())
        axis.set_minor_formatter(LogFormatter(labelOnlyBase=False))
    return figure


def _saliency(saliency: FloatArray) -> Figure:
    figure = Figure(figsize=(NARROW_IN, 1.5))
    axes = figure.subplots()
    axes.imshow(saliency, cmap="gray", vmin=0.0, interpolation="nearest", aspect="equal")
    axes.set(xticks=[], yticks=[])
    return figure
