"""Figures that show the noise that a PROBE-GK model has learned, and how it was chosen."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations, pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from probevo.arrays import FloatArray
from probevo.output.inspection.gk_data import (
    AXES,
    SEARCHED,
    TO_AXES,
    CentersView,
    course_along,
    sigma_px,
    size_px,
)
from probevo.output.inspection.plots import (
    MAX_PAIRED,
    NARROW_IN,
    axis_label,
    draw_column,
    two_histograms,
    window_of,
)
from probevo.output.inspection.subject import FrameView
from probevo.output.svg import BLUE, CYCLE, GREY, INK, LEGEND_ABOVE, MUTED, ORANGE, WIDTH_IN

COLORS = (CYCLE[0], CYCLE[2], CYCLE[3])
"""Colours of the three ``AXES``."""
_MAX_LETTERS = 8
"""Most letters of two neighbouring ticks that fit side by side."""
_LOGARITHMIC = ("σ, px", "ν")
_NAMES = {"u_l": "$u_l$", "v_l": "$v_l$", "disparity": "disparity"}


def course_figure(view: CentersView, k: int, frame: FrameView | None) -> Figure:
    """Draw the noise at the centers along the k-th used column.

    From above: σ, ν and, if it was learned, the bias, medians and 16 to 84 % of the centers; and
    where these lie, and the frame's features. What is undefined stands apart at the left.
    """
    shown = _shown(view)
    figure = Figure(figsize=(NARROW_IN, 2.6 + 0.85 * (len(shown) - 1)))
    heights = (5, *[3] * (len(shown) - 1), 2)
    *above, below = figure.subplots(len(shown) + 1, 1, sharex=True, height_ratios=heights)
    column = view.used[k]
    values = view.points[:, k]
    features = None if frame is None else frame.phi[:, column.index]
    apart = draw_column(below, values, features, view.units.get(column.name, ""))
    for axes, (name, quantity), limits in zip(above, shown.items(), _limits(view), strict=True):
        colors = COLORS if quantity.shape[1] == len(AXES) else (BLUE,)
        for color, axis, component in zip(colors, AXES, quantity.T, strict=False):
            _draw_course(axes, values, component, apart=apart, color=color, label=_NAMES[axis])
        axes.set(ylim=limits, ylabel=name)
        if name in _LOGARITHMIC:
            axes.set_yscale("log")
            _plain_ticks(axes)
        else:
            axes.axhline(0.0, color=GREY, lw=0.8)
    above[0].legend(ncols=3, handlelength=1.2, **LEGEND_ABOVE)
    figure.align_ylabels(above)
    return figure


def _shown(view: CentersView) -> dict[str, FloatArray]:
    """Collect σ, [C, 3], ν, [C, 1], and bias, [C, 3], of the centers, by their axis labels."""
    shown = {"σ, px": sigma_px(view.noise.scale), "ν": view.noise.dof[:, None]}
    if view.noise.bias.any():
        shown["bias, px"] = view.noise.bias @ TO_AXES.T
    return shown


def _limits(view: CentersView) -> list[tuple[float, float]]:
    """Choose the same scales for all columns, so that their strengths compare."""
    limits = []
    for name, quantity in _shown(view).items():
        courses = [
            course_along(column, component) for column in view.points.T for component in quantity.T
        ]
        ends = [course.quantiles.ravel() for course in courses]
        ends += [course.undefined for course in courses if course.undefined is not None]
        low, high = np.quantile(np.concatenate(ends), [0.0, 1.0]).tolist()
        if name in _LOGARITHMIC:
            margin = max((high / low) ** 0.05, 1.1)
            limits.append((low / margin, high * margin))
        else:
            margin = max(0.05 * (high - low), 0.01)
            limits.append((min(low, 0.0) - margin, max(high, 0.0) + margin))
    return limits


def _draw_course(
    axes: Axes, column: FloatArray, values: FloatArray, *, apart: float, color: str, label: str
) -> None:
    """Draw the course of one value; where the column is undefined, it stands at ``apart``."""
    course = course_along(column, values)
    low, median, high = course.quantiles
    axes.fill_between(course.center, low, high, color=color, alpha=0.16, lw=0)
    marker = "o" if len(course.center) == 1 else ""
    axes.plot(course.center, median, color=color, lw=1.5, label=label, marker=marker)
    if course.undefined is not None:
        low, median, high = course.undefined
        axes.errorbar(
            apart,
            median,
            [[median - low], [high - median]],
            color=color,
            fmt="o",
            mfc="white",
            ms=4,
            lw=1.2,
        )


def _plain_ticks(axes: Axes) -> None:
    ticks = _ticks(*axes.get_ylim())
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_yticks([], minor=True)


def _ticks(low: float, high: float) -> list[float]:
    """Choose round numbers for a logarithmic axis: the narrower, the more to a power of ten."""
    steps: tuple[float, ...] = (1,)
    if high / low < 8.0:
        steps = (1, 1.5, 2, 3, 4, 5, 7)
    elif high / low < 150.0:
        steps = (1, 2, 5)
    return [n * 10.0**k for k in range(-4, 5) for n in steps if low <= n * 10.0**k <= high]


def gains_figure(searches: Mapping[str, Mapping[str, Any]]) -> Figure:
    """Draw what each candidate gains over the static model, and which was chosen."""
    shown = [name for name in SEARCHED if searches.get(name, {}).get("gains")]
    across = 2 if len(shown) in (2, 4) else min(3, len(shown))  # no row but the last has a gap
    down = -(-len(shown) // across)
    figure = Figure(figsize=(WIDTH_IN, 0.3 + 2.2 * down))
    grid = np.ravel(figure.subplots(down, across, sharey=True))
    for axes, name in zip(grid, shown, strict=False):
        search = searches[name]
        ranks = np.arange(len(search["gains"]))
        is_weights = name == "weights"
        names = [str(m) if is_weights else _plain(m) for m in search["candidates"]]
        axes.plot(ranks, search["gains"], color=BLUE, lw=1.4, marker="o", ms=3.5)
        is_dense = max((len(a) + len(b) for a, b in pairwise(names)), default=0) > _MAX_LETTERS
        turned: dict[str, Any] = (
            {"rotation": 40, "ha": "right", "rotation_mode": "anchor"}
            if is_weights or is_dense
            else {}
        )
        if is_weights:
            names = [names[0], *(f"+ {column}" for column in names[1:])]
        axes.set_xticks(ranks, names, fontsize=7.5, **turned)
        axes.set_title(SEARCHED[name], color=MUTED)
        axes.margins(x=0.12)
        if not is_weights:
            chosen = search["candidates"].index(search["chosen"])
            axes.plot(chosen, search["gains"][chosen], "o", ms=9, mfc="none", mec=ORANGE, mew=1.8)
    for axes in grid[len(shown) :]:
        axes.set_axis_off()
    return figure


def _plain(candidate: float | str) -> str:
    if isinstance(candidate, str):
        return "fixed" if candidate == "none" else candidate
    return f"{candidate:g}"


def centers_figures(view: CentersView, frame: FrameView | None) -> list[Figure]:
    """Draw the centers over each two of the first used columns, in the colour of their σ.

    The frame's features are rings.
    """
    size = size_px(view.noise.scale)
    low, high = np.quantile(size, [0.02, 0.98]).tolist()
    norm = LogNorm(low, max(high, 1.001 * low))
    ticks = _ticks(low, high)
    figures = []
    for i, j in combinations(range(min(len(view.used), MAX_PAIRED)), 2):
        figure = Figure(figsize=(NARROW_IN, 2.9))
        axes = figure.add_subplot()
        window = np.array([window_of(view.points[:, i]), window_of(view.points[:, j])])
        points = np.clip(view.points[:, [i, j]], *window.T)
        drawn = axes.scatter(
            points[:, 0],
            points[:, 1],
            s=7,
            c=size,
            norm=norm,
            cmap="viridis",
            lw=0,
            rasterized=True,
        )
        if frame is not None:
            points = np.clip(frame.phi[:, [view.used[i].index, view.used[j].index]], *window.T)
            axes.plot(*points.T, "o", mfc="none", mec=ORANGE, ms=3.5, mew=0.8, rasterized=True)
        axes.set_xlabel(axis_label(view.used[i].name, view.units))
        axes.set_ylabel(axis_label(view.used[j].name, view.units))
        axes.grid(visible=False)
        bar = figure.colorbar(drawn, ax=axes, aspect=30, pad=0.02, label="σ, px")
        bar.outline.set_visible(False)
        bar.minorticks_off()
        bar.set_ticks(ticks, labels=[f"{tick:g}" for tick in ticks])
        figures.append(figure)
    return figures


def histogram_figure(training: FloatArray, frame: FloatArray, label: str, prior: float) -> Figure:
    """Draw σ or ν of the frame's features, [N], beside that of the centers, [C].

    The dashed line is the prior, which holds out of the reach of all samples.
    """
    # The window holds nearly all values and the prior, unless that is infinite.
    every = np.concatenate([training, frame, [prior] if np.isfinite(prior) else []])
    low, high = np.quantile(every, [0.002, 0.998]).tolist()
    low = min(low, 0.98 * prior) / 1.05
    high = max(high, 1.02 * prior if np.isfinite(prior) else high) * 1.05
    logs = np.log10([low, high])
    figure, axes = two_histograms(
        np.log10(training), np.log10(frame), (float(logs[0]), float(logs[1]))
    )
    if np.isfinite(prior):
        axes.axvline(np.log10(prior), color=INK, lw=0.9, ls="--")
    axes.set_xlabel(label, color=MUTED)
    ticks = _ticks(low, high)
    axes.set_xticks(np.log10(ticks).tolist(), [f"{tick:g}" for tick in ticks])
    return figure
