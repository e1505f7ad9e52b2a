"""Figures of the report that show the path of a run and its error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from probevo.arrays import FloatArray
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.geometry import se3
from probevo.output.report.report_data import Drift
from probevo.output.run_result import RunResult
from probevo.output.svg import BAND, BLUE, GREY, INK, LEGEND_ABOVE, WIDTH_IN

RASTER_FROM = 1500
"""A curve of more points than this is drawn as pixels, to keep the page small."""
AXES = ("right x", "down y", "forward z", "pitch x", "yaw y", "roll z")
"""The components of an error [ρ; φ], in words."""


def trajectory_figure(drift: Drift) -> Figure:
    """Draw the path from above, forward up, over the true one, with the claimed 3σ ellipses."""
    paths = (
        [drift.T_world_cam]
        if drift.T_world_cam_true is None
        else [drift.T_world_cam, drift.T_world_cam_true]
    )
    # Camera x is right and z is forward: seen from above, the plane of the path.
    paths_m = [T[:, [0, 2], 3] for T in paths]
    rings_m = _claimed_rings(drift)
    low_m, high_m = _window(np.concatenate(paths_m), np.concatenate(rings_m))
    factor, unit = length_unit(float(np.max(high_m - low_m)))
    aspect = float((high_m - low_m)[1] / (high_m - low_m)[0])
    figure = Figure(figsize=(WIDTH_IN, WIDTH_IN * float(np.clip(aspect, 0.45, 0.85))))
    axes = figure.add_subplot(xlabel=f"right x, {unit}", ylabel=f"forward z, {unit}")
    # The limits grow to fill the figure: a straight path keeps its surroundings, and its scale
    # stays true.
    axes.set_aspect("equal", adjustable="datalim")
    axes.update_datalim([low_m * factor, high_m * factor])
    # The ellipses below, then the truth, then the estimate, each with a square at its end.
    for ring_m in rings_m:
        axes.add_artist(
            Polygon(
                ring_m * factor, fc=(*to_rgb(BAND), 0.35), ec=(*to_rgb(BLUE), 0.5), lw=0.7, zorder=1
            )
        )
    for points_m, color, width, label in zip(
        paths_m, (BLUE, GREY), (1.4, 3.0), ("estimate", "truth"), strict=False
    ):
        points = points_m * factor
        known = points[np.isfinite(points).all(axis=1)]
        axes.plot(*points.T, color=color, lw=width, label=label, zorder=3 if color == BLUE else 2)
        axes.plot(*known[-1], "s", color=color, ms=6, mec="white", mew=0.8, zorder=5)
    axes.plot(
        *(paths_m[0][0] * factor),
        "o",
        color=INK,
        ms=7,
        mec="white",
        mew=0.8,
        zorder=6,
        ls="",
        label="start",
    )
    end_color = BLUE if drift.T_world_cam_true is None else GREY
    axes.plot([], [], "s", color=end_color, ms=6, label="end")
    axes.legend(ncols=4, **LEGEND_ABOVE)
    return figure


def error_figure(drift: Drift) -> Figure:
    """Draw the length of the position error along the path, and its claimed 3σ.

    Without truth, only the latter is known.
    """
    # Only the position: its worst direction is an upper bound of the length's σ.
    claimed_m = 3.0 * drift.position_sigma_m
    error_m = None if drift.error is None else np.linalg.norm(drift.error[:, :3], axis=1)
    top_m = readable_top(claimed_m, error_m)
    factor, unit = length_unit(top_m)
    figure = Figure(figsize=(WIDTH_IN, 2.9))
    along, label = along_path(drift)
    shown = "3σ of the position" if error_m is None else "position error"
    axes = figure.add_subplot(xlabel=label, ylabel=f"{shown}, {unit}")
    dense = len(along) > RASTER_FROM
    axes.fill_between(
        along,
        0,
        claimed_m * factor,
        color=BAND,
        lw=0,
        label="3σ claimed by the run",
        rasterized=dense,
    )
    if error_m is not None:
        axes.plot(along, error_m * factor, color=BLUE, lw=1.4, label="error", rasterized=dense)
    axes.set(ylim=(0, top_m * factor), xlim=limits_of(along))
    axes.legend(ncols=2, **LEGEND_ABOVE)
    return figure


def axes_figure(drift: Drift) -> Figure:
    """Draw the pose error along each axis of the camera in its ±3σ band."""
    along, label = along_path(drift)
    dense = len(along) > RASTER_FROM
    figure = Figure(figsize=(WIDTH_IN, 4.6))
    grid = figure.subplots(3, 2, sharex=True)
    # Translation in the left column, rotation in the right one.
    for i, name in enumerate(AXES):
        axes = grid[i % 3, i // 3]
        claimed = 3.0 * drift.sigma[:, i]
        error = None if drift.error is None else drift.error[:, i]
        top = readable_top(claimed, error)
        factor, unit = length_unit(top) if i < 3 else (np.rad2deg(1.0), "deg")
        axes.fill_between(
            along, -claimed * factor, claimed * factor, color=BAND, lw=0, rasterized=dense
        )
        if error is not None:
            axes.plot(along, error * factor, color=BLUE, lw=1.1, rasterized=dense)
        axes.set(ylim=(-top * factor, top * factor), xlim=limits_of(along))
        axes.set_title(f"{name}, {unit}")
    for axes in grid[2]:
        axes.set_xlabel(label)
    return figure


def step_errors_figure(result: RunResult, truth: FloatArray) -> Figure:
    """Draw the error of each step over time, translation above rotation, with the claimed 1σ.

    Args:
        result: a run over N frames.
        truth: true poses T_world_cam, [N, 4, 4], m; NaN where unknown, and the curve has a gap.
    """
    xi = se3.log(relative_motions(truth) @ se3.inverse(result.T_curr_prev))
    time_s = 1e-9 * (result.stamps_ns[1:] - result.stamps_ns[0])
    figure = Figure(figsize=(WIDTH_IN, 3.4))
    above, below = figure.subplots(2, 1, sharex=True)
    for axes, part, factor, label in (
        (above, slice(0, 3), 1e3, "translation, mm"),
        (below, slice(3, 6), float(np.degrees(1e3)), "rotation, m°"),
    ):
        sigma = np.sqrt(np.trace(result.cov[:, part, part], axis1=1, axis2=2))
        is_raster = len(time_s) > RASTER_FROM
        axes.plot(
            time_s,
            factor * np.linalg.norm(xi[:, part], axis=1),
            color=BLUE,
            lw=1.0,
            label="error",
            rasterized=is_raster,
        )
        axes.plot(
            time_s, factor * sigma, color=GREY, lw=1.4, label="claimed 1σ", rasterized=is_raster
        )
        axes.set(ylabel=label, ylim=(0.0, None))
    below.set(xlabel="time, s")
    above.legend(ncols=2, **LEGEND_ABOVE)
    return figure


def length_unit(largest_m: float) -> tuple[float, str]:
    """Choose the unit in which lengths up to the given one read well, and its factor from m."""
    return (1000.0, "mm") if largest_m < 0.1 else (1.0, "m")


def along_path(drift: Drift) -> tuple[FloatArray, str]:
    """Choose what to plot against: the distance travelled, or the time if the camera hardly moves.

    Returns the values, [N], and their label.
    """
    if _travels(drift):
        return drift.distance_m, "distance travelled, m"
    return drift.time_s, "time, s"


def along_paths(drifts: Sequence[Drift]) -> tuple[list[FloatArray], str]:
    """Choose what to plot several runs against, on one axis.

    Returns the values of each, [N], and their label: distances if any of the cameras travels.
    """
    if any(_travels(drift) for drift in drifts):
        return [drift.distance_m for drift in drifts], "distance travelled, m"
    return [drift.time_s for drift in drifts], "time, s"


def _travels(drift: Drift) -> bool:
    """Return whether a camera moves by more than half a metre along an axis."""
    return bool(np.ptp(drift.T_world_cam[:, :3, 3], axis=0).max() > 0.5)


def readable_top(claimed: FloatArray, error: FloatArray | None) -> float:
    """Choose the upper limit of an axis.

    It shows all of the error, and as much of the band of ``claimed`` as leaves the error readable.
    """
    if error is None:
        return 1.05 * float(claimed.max()) + 1e-9
    largest = float(np.nanmax(np.abs(error)))
    return 1.08 * max(largest, min(float(claimed.max()), 6.0 * largest)) + 1e-9


def _claimed_rings(drift: Drift) -> list[FloatArray]:
    """Outline the horizontal 3σ ellipse of the position at six places of the path, [64, 2], m."""
    angle = np.linspace(0.0, 2.0 * np.pi, 64)
    circle = 3.0 * np.stack([np.cos(angle), np.sin(angle)])
    rings_m = []
    for k in np.unique(np.linspace(0, len(drift.cov) - 1, 7).astype(int))[1:]:
        variance, axes = np.linalg.eigh(drift.position_cov_world[k][np.ix_([0, 2], [0, 2])])
        ring_m = axes * np.sqrt(np.maximum(variance, 0.0)) @ circle
        rings_m.append(drift.T_world_cam[k, [0, 2], 3] + ring_m.T)
    return rings_m


def _window(path: FloatArray, rings: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Choose the lower and the upper corner of the part of the plane that is shown, [2] each.

    It holds the path, and the rings as far as they leave the path readable.
    """
    low = np.nanmin(path, axis=0)
    high = np.nanmax(path, axis=0)
    reach = max(float((high - low).max()), 1e-3)
    low = np.maximum(low - reach, np.minimum(low, rings.min(axis=0)))
    high = np.minimum(high + reach, np.maximum(high, rings.max(axis=0)))
    return low - 0.04 * reach, high + 0.04 * reach


def limits_of(along: FloatArray) -> tuple[float, float]:
    """Return the lower and the upper limit of the axis that runs along the path."""
    return float(along[0]), float(max(along[-1], along[0] + 1e-3))
