"""The figure of the report that compares the covariances with the errors."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from probevo.evaluation.consistency import Consistency
from probevo.output.svg import BAND, BLUE, GREY, LEGEND_ABOVE, WIDTH_IN

LEVELS = np.arange(1, 100) / 100.0
"""Probabilities of the ellipsoids that are shown."""


def calibration_figure(consistency: Consistency) -> Figure:
    """Draw the share of steps inside the ellipsoids that should hold 1 … 99 % of them.

    On the diagonal, the covariances are consistent; below it, they are overconfident.
    """
    low, high = consistency.share_interval(LEVELS)
    figure = Figure(figsize=(WIDTH_IN, 3.4))
    axes = figure.add_subplot(xlabel="claimed probability, %", ylabel="steps inside, %")
    percent = 100.0 * LEVELS
    axes.fill_between(
        percent, 100.0 * low, 100.0 * high, color=BAND, lw=0, label="95 % of consistent runs"
    )
    axes.plot([0, 100], [0, 100], color=GREY, lw=0.9, ls="--", label="consistent")
    axes.plot(
        percent, 100.0 * consistency.share_inside(LEVELS), color=BLUE, lw=1.4, label="this run"
    )
    axes.set(xlim=(0, 100), ylim=(-1, 101))  # a line at 0 is seen in full
    axes.legend(ncols=3, **LEGEND_ABOVE)
    return figure
