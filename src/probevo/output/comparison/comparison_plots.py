"""Figures of the runs of several estimators over one sequence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.output.comparison.comparison import Entry
from probevo.output.report.report_data import Drift, drift_of
from probevo.output.report.report_plots import (
    AXES,
    RASTER_FROM,
    along_paths,
    length_unit,
    limits_of,
    readable_top,
)
from probevo.output.svg import GREY, INK, LEGEND_ABOVE, MUTED, WIDTH_IN

HEIGHT_IN = 4.2
_DASHED: dict[str, Any] = {"lw": 0.9, "ls": (0, (4, 2.5))}


def paths_figure(entries: Sequence[Entry], colors: Mapping[str, str]) -> Figure:
    """Draw the paths from above, forward up, over the true one.

    All start at the same place, in the same direction.

    Args:
        entries: runs over one sequence, at least one, each of two frames or more.
        colors: colour of each estimator, by its name.
    """
    paths_m = [_path_from_above(entry.result.T_world_cam, _origin(entry)) for entry in entries]
    true_m = [
        _path_from_above(entry.truth, _origin(entry))
        for entry in entries
        if entry.truth is not None
    ]
    known_m = [path_m for path_m in true_m if np.isfinite(path_m).any()]
    # All paths fit into the figure, with a margin.
    everything_m = np.concatenate(paths_m + known_m)
    low_m = np.nanmin(everything_m, axis=0)
    high_m = np.nanmax(everything_m, axis=0)
    margin_m = 0.04 * max(float((high_m - low_m).max()), 1e-3)
    factor, unit = length_unit(float(np.max(high_m - low_m)))
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
    axes = figure.add_subplot(xlabel=f"right x, {unit}", ylabel=f"forward z, {unit}")
    # The limits grow to fill the figure: a straight path keeps its surroundings, and its scale
    # stays true.
    axes.set_aspect("equal", adjustable="datalim")
    axes.update_datalim([(low_m - margin_m) * factor, (high_m + margin_m) * factor])
    if known_m:
        _draw_path(
            axes, factor * max(known_m, key=len), color=GREY, lw=5.0, alpha=0.6, label="truth"
        )
    # The runs over the truth, in the order of the legend.
    for entry, path_m, width in zip(entries, paths_m, _widths(entries), strict=True):
        _draw_path(
            axes,
            factor * path_m,
            color=colors[entry.estimator],
            lw=width,
            label=_literal(entry.estimator),
        )
    axes.plot(0, 0, "o", color=INK, ms=7, mec="white", mew=0.8, zorder=6, ls="", label="start")
    axes.plot([], [], "s", color=MUTED, ms=6, label="end")
    axes.legend(ncols=5, **LEGEND_ABOVE)
    return figure


def errors_figure(entries: Sequence[Entry], colors: Mapping[str, str]) -> Figure:
    """Draw the position error along the path and, dashed, the 3σ that each run claims for it.

    Args:
        entries: runs over one sequence, at least one, each of two frames or more.
        colors: colour of each estimator, by its name.
    """
    drifts = [drift_of(entry.result, entry.truth) for entry in entries]
    errors_m = [_position_error(drift) for drift in drifts]
    claims_m = [3.0 * drift.position_sigma_m for drift in drifts]
    top_m = max(
        readable_top(claim_m, error_m) for claim_m, error_m in zip(claims_m, errors_m, strict=True)
    )
    factor, unit = length_unit(top_m)
    all_along, label = along_paths(drifts)
    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN))
    shown = (
        "3σ of the position" if all(error_m is None for error_m in errors_m) else "position error"
    )
    axes = figure.add_subplot(xlabel=label, ylabel=f"{shown}, {unit}")
    for entry, along, error_m, claim_m, width in zip(
        entries, all_along, errors_m, claims_m, _widths(entries), strict=True
    ):
        color = colors[entry.estimator]
        dense = len(along) > RASTER_FROM
        axes.plot(along, claim_m * factor, color=color, alpha=0.8, rasterized=dense, **_DASHED)
        if error_m is not None:
            axes.plot(along, error_m * factor, color=color, lw=width, zorder=3, rasterized=dense)
    axes.set(xlim=limits_of(_longest(all_along)), ylim=(0, top_m * factor))
    handles = [
        Line2D([], [], color=colors[e.estimator], lw=1.6, label=_literal(e.estimator))
        for e in entries
    ]
    handles.append(Line2D([], [], color=MUTED, label="3σ claimed", **_DASHED))
    axes.legend(handles=handles, ncols=5, **LEGEND_ABOVE)
    return figure


def axes_errors_figures(
    entries: Sequence[Entry], colors: Mapping[str, str]
) -> tuple[Figure, Figure]:
    """Draw the pose error of each run along each axis of its camera, as large as the errors are.

    Args:
        entries: runs over one sequence with known truth, each of two frames or more.
        colors: colour of each estimator, by its name.

    Returns:
        The figures of translation and of rotation.
    """
    drifts = [drift_of(entry.result, entry.truth) for entry in entries]
    all_along, label = along_paths(drifts)
    figures = (Figure(figsize=(WIDTH_IN, 4.6)), Figure(figsize=(WIDTH_IN, 4.6)))
    grids = [figure.subplots(3, 1, sharex=True) for figure in figures]
    for i, name in enumerate(AXES):
        axes = grids[i // 3][i % 3]
        errors = [np.zeros(1) if drift.error is None else drift.error[:, i] for drift in drifts]
        largest = max(float(np.nanmax(np.abs(error))) for error in errors)
        factor, unit = length_unit(largest) if i < 3 else (np.rad2deg(1.0), "deg")
        axes.axhline(0.0, color=GREY, lw=0.8)
        for entry, drift, along, error, width in zip(
            entries, drifts, all_along, errors, _widths(entries), strict=True
        ):
            if drift.error is None:
                continue
            axes.plot(
                along,
                error * factor,
                color=colors[entry.estimator],
                lw=width,
                label=_literal(entry.estimator),
                rasterized=len(along) > RASTER_FROM,
            )
        axes.set(xlim=limits_of(_longest(all_along)))
        axes.set_title(f"{name}, {unit}")
        if i % 3 == 2:
            axes.set_xlabel(label)
    return figures


def _longest(all_along: Sequence[FloatArray]) -> FloatArray:
    """Return the values that reach farthest; the axis is as long."""
    return max(all_along, key=lambda along: float(along[-1]))


def _origin(entry: Entry) -> int:
    """Find the first frame whose true pose is known, as in ``drift_of``; else the first of all."""
    known = np.zeros(1, bool) if entry.truth is None else np.isfinite(entry.truth).all(axis=(1, 2))
    return int(known.argmax())


def _path_from_above(T_world_cam: FloatArray, origin: int) -> FloatArray:
    """Take positions (right x, forward z) in the camera frame of the origin, [N, 2], m."""
    return np.asarray((se3.inverse(T_world_cam[origin]) @ T_world_cam)[:, [0, 2], 3])


def _draw_path(axes: Axes, points: FloatArray, *, color: str, **style: Any) -> None:
    """Draw a line with a square at its last known point."""
    known = points[np.isfinite(points).all(axis=1)]
    line = axes.plot(*points.T, color=color, rasterized=len(points) > RASTER_FROM, **style)[0]
    size = 4.0 + line.get_linewidth()
    axes.plot(
        *known[-1], "s", color=color, ms=size, mec="white", mew=0.8, zorder=line.get_zorder() + 1
    )


def _widths(entries: Sequence[Entry]) -> FloatArray:
    """Make each line thinner than the one before, so that both are seen where they agree."""
    return np.linspace(2.6, 1.3, len(entries)) if len(entries) > 1 else np.array([1.6])


def _position_error(drift: Drift) -> FloatArray | None:
    """Compute the distance between estimated and true position, [N], m; NaN where unknown."""
    if drift.T_world_cam_true is None:
        return None
    return np.asarray(
        np.linalg.norm((drift.T_world_cam - drift.T_world_cam_true)[:, :3, 3], axis=1)
    )


def _literal(name: str) -> str:
    """Escape the dollars of a name: Matplotlib would set what is between them as mathematics."""
    return name.replace("$", r"\$")
