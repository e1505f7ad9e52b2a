"""Figures that show what a PROBE model learned, and how a frame's features lie in it."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure

from probevo.arrays import FloatArray
from probevo.output.inspection.knn_data import SEARCHED, ModelView, rank_correlation
from probevo.output.inspection.plots import (
    MAX_PAIRED,
    NARROW_IN,
    axis_label,
    draw_column,
    two_histograms,
    window_of,
)
from probevo.output.inspection.profiles import Profile
from probevo.output.inspection.subject import FrameView
from probevo.output.svg import BAND, BLUE, GREY, INK, MUTED, ORANGE, WIDTH_IN


def profile_figure(view: ModelView, m: int, frame: FrameView | None) -> Figure:
    """Draw how ln(α/ᾱ) varies along a column of φ.

    Above: its mean, with two standard errors. Below: where the samples, and the frame's features,
    lie. Undefined ones stand apart at the left.
    """
    figure = Figure(figsize=(NARROW_IN, 2.9))
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=(5, 2))
    unit = view.units.get(view.columns[m], "")
    features = None if frame is None else frame.phi[:, m]
    apart = draw_column(below, view.points[:, m], features, unit)
    _draw_profile(above, view.profiles[m], apart)
    above.set(ylim=_common_limits(view.profiles), ylabel="mean ln(α/ᾱ)")
    return figure


def _draw_profile(axes: Axes, profile: Profile, apart: float) -> None:
    axes.axhline(0.0, color=GREY, lw=0.8)
    band = 2.0 * profile.standard_error
    axes.fill_between(profile.center, profile.mean - band, profile.mean + band, color=BAND, lw=0)
    axes.plot(
        profile.center,
        profile.mean,
        color=BLUE,
        lw=1.5,
        marker="o" if len(profile.center) == 1 else "",
    )
    if profile.undefined is not None:
        mean, error = profile.undefined
        axes.errorbar(apart, mean, 2.0 * error, color=BLUE, fmt="o", mfc="white", ms=4, lw=1.2)


def _common_limits(profiles: Sequence[Profile]) -> tuple[float, float]:
    """Choose the same scale for all columns, so that their strengths compare."""
    undefined = [profile.undefined[0] for profile in profiles if profile.undefined]
    means = np.concatenate([*(profile.mean for profile in profiles), [0.0], undefined])
    reach = max(float(np.ptp(means)), 0.05)
    return float(means.min()) - 0.2 * reach, float(means.max()) + 0.2 * reach


def searches_figure(searches: dict[str, dict[str, Any]]) -> Figure:
    """Draw the error over the candidates for K and γ, and which was chosen."""
    figure = Figure(figsize=(WIDTH_IN, 2.7))
    shown = [name for name in SEARCHED if name in searches]
    for axes, name in zip(np.atleast_1d(figure.subplots(1, len(shown))), shown, strict=True):
        searched = SEARCHED[name]
        candidates = searches[name]["candidates"]
        errors = searched.unit_factor * np.array(searches[name]["errors"])
        ranks = np.arange(len(candidates))
        axes.plot(ranks, errors, color=BLUE, lw=1.4, marker="o", ms=3.5)
        chosen = int(np.argmin(np.abs(np.array(candidates) - searches[name]["chosen"])))
        axes.plot(chosen, errors[chosen], "o", ms=9, mfc="none", mec=ORANGE, mew=1.8)
        axes.set_xticks(
            ranks,
            [f"{candidate:g}" for candidate in candidates],
            fontsize=8 if len(ranks) < 10 else 7,
        )
        axes.set(xlabel=f"{searched.symbol}; chosen: {candidates[chosen]:g}")
        axes.set_title(searched.errors_in_short, color=MUTED)
    return figure


def correlation_figure(view: ModelView) -> Figure:
    """Draw Spearman's correlation of the columns over the training samples.

    The last row is the correlation of each with ln(α/ᾱ).
    """
    # Only the lower triangle: the matrix is symmetric, and its diagonal is 1.
    order = view.order
    table = rank_correlation(np.column_stack([view.points[:, order], view.log_alpha]))
    names = [*(view.columns[m] for m in order), "ln(α/ᾱ)"]
    count = len(names)
    figure = Figure(figsize=(WIDTH_IN, 1.9 + 0.2 * count))
    axes = figure.add_subplot()
    shown = np.where(np.tril(np.ones((count, count)), -1) > 0, table, np.nan)[1:, :-1]
    image = axes.imshow(shown, cmap="RdBu_r", vmin=-1.0, vmax=1.0, aspect="auto")
    for row, column in zip(*np.nonzero(np.abs(np.nan_to_num(shown)) >= 0.1), strict=True):
        value = float(shown[row, column])
        text = f"{value:.1f}".replace("0.", ".").replace("-", "−")
        size = 7.5 if count < 18 else 5.5
        color = "white" if abs(value) > 0.6 else INK
        axes.text(column, row, text, ha="center", va="center", fontsize=size, color=color)
    small: dict[str, Any] = {"fontsize": 8 if count < 18 else 6.5}
    axes.set_xticks(range(count - 1), names[:-1], rotation=90, **small)
    axes.set_yticks(range(count - 1), names[1:], **small)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    bar = figure.colorbar(image, ax=axes, shrink=0.6, aspect=24, pad=0.02, ticks=[-1, 0, 1])
    bar.outline.set_visible(False)
    return figure


def pairs_figures(view: ModelView, frame: FrameView | None) -> list[Figure]:
    """Draw the density of the training samples over each two of the most telling columns.

    The frame's features are points.
    """
    figures = []
    for m, n in combinations(view.order[:MAX_PAIRED], 2):
        figure = Figure(figsize=(NARROW_IN, 2.9))
        axes = figure.add_subplot()
        x = view.points[:, m]
        y = view.points[:, n]
        window = (window_of(x), window_of(y))
        counts, *edges = np.histogram2d(x, y, 45, window)
        shares = np.where(counts > 0, counts, np.nan).T
        axes.pcolormesh(
            *edges, shares, cmap="Blues", norm=LogNorm(0.3, max(counts.max(), 1.0)), rasterized=True
        )
        if frame is not None:
            points = np.clip(frame.phi[:, [m, n]], *np.array(window).T)
            axes.plot(*points.T, "o", color=ORANGE, ms=2.5, mew=0, alpha=0.8, rasterized=True)
        axes.set_xlabel(axis_label(view.columns[m], view.units))
        axes.set_ylabel(axis_label(view.columns[n], view.units))
        axes.grid(visible=False)
        figures.append(figure)
    return figures


def weights_figure(view: ModelView, beta: FloatArray) -> Figure:
    """Draw β of the frame's features, [N], beside that of the training samples."""
    logs = np.log10(np.concatenate([view.beta, beta]))
    # The window is symmetric about β = 1, on a logarithmic scale.
    reach = max(float(np.quantile(np.abs(logs), 0.998)), 0.35)
    figure, axes = two_histograms(np.log10(view.beta), np.log10(beta), (-reach, reach))
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.set_xlabel("β: trusted < 1 < distrusted", color=MUTED)
    ticks = [n * 10.0**k for k in range(-4, 5) for n in ((1, 2, 5) if reach < 1.5 else (1,))]
    shown = [tick for tick in ticks if abs(np.log10(tick)) <= reach]
    axes.set_xticks(np.log10(shown).tolist(), [f"{tick:g}" for tick in shown])
    return figure


def distances_figure(view: ModelView, radius: FloatArray) -> Figure:
    """Draw distances to the K-th nearest training sample: of the frame's features, [N], and of the
    training samples themselves.
    """
    top = 1.02 * max(float(radius.max(initial=0.0)), float(view.radius.max()), 1e-3)
    figure, axes = two_histograms(view.radius, radius, (0.0, top))
    axes.axvline(view.far_radius, color=INK, lw=0.9, ls="--")
    axes.set_xlabel("distance, standard deviations")
    place: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points"}
    axes.annotate("far", (view.far_radius, 0.96), (4, 0), va="top", color=INK, **place)
    return figure
