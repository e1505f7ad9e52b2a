"""Parts of figures that the pages on all kinds of noise models have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from probevo.arrays import FloatArray
from probevo.output.svg import GREY, LEGEND_ABOVE, ORANGE, WIDTH_IN

NARROW_IN = 4.0
"""Width of the figure of a single column of φ."""
MAX_PAIRED = 4
"""Number of columns that are plotted against each other, in pairs."""
_BINS = 40
_SHOWN = (0.005, 0.995)
"""The outermost half percent of the training samples on either side, and all beyond, lie in the
outermost bins."""


def draw_column(axes: Axes, samples: FloatArray, features: FloatArray | None, unit: str) -> float:
    """Draw where the samples, and the frame's features, lie along a column of φ.

    What is undefined has a bar of its own, apart at the left.

    Args:
        axes: where to draw; its horizontal axis is that of the column.
        samples: values of the training samples, [N]; NaN where undefined.
        features: values of the frame's features, [K]; None without a frame.
        unit: label of the horizontal axis.

    Returns:
        Where on the horizontal axis undefined values stand.
    """
    low, high = window_of(samples)
    apart = low - 0.07 * (high - low)
    top = _draw_shares(axes, samples, (low, high), apart=apart, is_frame=False)
    some_undefined = bool(np.isnan(samples).any())
    if features is not None:
        top = max(top, _draw_shares(axes, features, (low, high), apart=apart, is_frame=True))
        some_undefined = some_undefined or bool(np.isnan(features).any())
    margin = 0.03 * (high - low)
    axes.set(xlabel=unit, ylim=(0, 1.08 * top + 1e-6), yticks=[])
    axes.set_xlim((apart if some_undefined else low) - margin, high + margin)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.grid(visible=False, axis="y")
    return apart


def _draw_shares(
    axes: Axes,
    values: FloatArray,
    window: tuple[float, float],
    *,
    apart: float,
    is_frame: bool,
) -> float:
    """Draw a histogram as shares of all values; returns the largest share of a bin."""
    known = values[np.isfinite(values)]
    counts, edges = np.histogram(np.clip(known, *window), _BINS, window)
    shares = counts / max(len(values), 1)
    color = ORANGE if is_frame else GREY
    style: dict[str, Any] = {"fill": True, "alpha": 0.55}
    if is_frame:
        style = {"fill": False, "lw": 1.3}
    axes.stairs(shares, edges, color=color, **style)
    if len(known) < len(values):
        width = 1.6 * (edges[1] - edges[0])
        undefined = 1.0 - len(known) / len(values)
        axes.bar(apart, undefined, width, fc=color, ec=color, **style)
    return float(shares.max())


def window_of(values: FloatArray) -> tuple[float, float]:
    """Choose the part of a column that is shown: nearly all values, and never of zero width."""
    known = values[np.isfinite(values)]
    low, high = np.quantile(known, _SHOWN).tolist() if len(known) else (0.0, 0.0)
    least = 1e-6 + 1e-3 * abs(low)
    return (low, high) if high - low > least else (low - least, high + least)


def axis_label(name: str, units: Mapping[str, str]) -> str:
    """Return the name of a column with its unit, if it has one that is known."""
    unit = units.get(name)
    return f"{name}, {unit}" if unit else name


def two_histograms(
    training: FloatArray, frame: FloatArray, window: tuple[float, float]
) -> tuple[Figure, Axes]:
    """Draw histograms of the training samples, filled, and of the frame's features.

    What lies beyond the window is in its outermost bins.
    """
    figure = Figure(figsize=(WIDTH_IN, 2.5))
    axes = figure.add_subplot(ylabel="share in a bin, %", xlim=window)
    for values, name in ((training, "training samples"), (frame, "this frame")):
        counts, edges = np.histogram(np.clip(values, *window), _BINS, window)
        shares = 100.0 * counts / max(len(values), 1)
        if name == "this frame":
            axes.stairs(shares, edges, color=ORANGE, lw=1.6, label=name)
        else:
            axes.stairs(shares, edges, color=GREY, fill=True, alpha=0.55, label=name)
    axes.legend(ncols=2, **LEGEND_ABOVE)
    return figure, axes
