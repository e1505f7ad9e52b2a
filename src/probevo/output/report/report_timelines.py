"""Figures of the report over time: tracks, status, computing time, rejected points, the domain."""

from __future__ import annotations

from itertools import cycle, pairwise

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.motion_estimate import Status
from probevo.output.domain_warning import WARN_ABOVE
from probevo.output.run_result import RunResult
from probevo.output.svg import BLUE, CYCLE, GREY, INK, LEGEND_ABOVE, WIDTH_IN

_MAX_PLACES = 500
"""Places on the time axis; a longer run is shown in groups of steps."""
STAGES = ("track", "calibrate", "predict", "consensus", "solve", "learn", "window", "sensors")
"""Stages of a step, in their order; each has the same colour in every report."""
STATUS_COLORS = {
    Status.FIRST: "#8a949e",
    Status.OK: "#2a9d8f",
    Status.DEGENERATE: "#e9b949",
    Status.TOO_FEW_TRACKS: "#e0651f",
    Status.NOT_CONVERGED: "#b5446e",
    Status.GAP: "#5b4b8a",
    Status.RECOVERED: "#4a7fb5",
}


def status_label(status: Status) -> str:
    """Name a status for people, e.g. "too few tracks"."""
    return "OK" if status is Status.OK else status.name.replace("_", " ").lower()


def group_size(result: RunResult) -> int:
    """Return the number of steps at one place of the time axis."""
    return -(-len(result.status) // _MAX_PLACES)


def tracks_figure(result: RunResult) -> Figure:
    """Draw the number of tracks of each step, and its status as a strip of colour below."""
    starts, edges_s = _groups(result)
    time_s = _seconds(result)
    figure = Figure(figsize=(WIDTH_IN, 2.9))
    tracks, strip = figure.subplots(2, 1, sharex=True, height_ratios=[8, 1])
    # The area reaches up to the most tracks of a group, the line is at the fewest.
    fewest = np.minimum.reduceat(result.num_tracks, starts)
    most = np.maximum.reduceat(result.num_tracks, starts)
    tracks.stairs(most, edges_s, color=BLUE, alpha=0.15, fill=True)
    tracks.stairs(fewest, edges_s, baseline=None, color=BLUE, lw=1.1)
    tracks.set(
        ylabel="tracks", ylim=(0, 1.1 * max(int(most.max()), 1)), xlim=(edges_s[0], edges_s[-1])
    )
    # One span of colour for each stretch of steps with the same status.
    for start, end in _stretches(result.status):
        strip.axvspan(
            time_s[start], time_s[end], color=STATUS_COLORS[Status(result.status[start])], lw=0.8
        )
    strip.set(yticks=[], xlabel="time, s")
    strip.grid(False)
    strip.spines["left"].set_visible(False)
    handles = [
        Patch(
            color=STATUS_COLORS[Status(status)], label=f"{status_label(Status(status))}: {count:,}"
        )
        for status, count in zip(*np.unique(result.status, return_counts=True), strict=True)
    ]
    tracks.legend(handles=handles, ncols=3, **LEGEND_ABOVE)
    return figure


def stages_figure(result: RunResult) -> Figure:
    """Draw the wall time of each step, its stages stacked, and the total as a line.

    Of a group of steps, the areas are means, and the line is the slowest step. Decoding runs ahead
    in threads of its own: it is no part of the total, and has a line of its own.
    """
    starts, edges_s = _groups(result)
    sizes = np.diff([*starts, len(result.status)])
    figure = Figure(figsize=(WIDTH_IN, 2.9))
    axes = figure.add_subplot(xlabel="time, s", ylabel="ms a frame")
    # The stages of a step, then those that only this run has, stacked from below.
    base_ms = np.zeros(len(starts))
    stages = (*STAGES, *(name for name in result.stage_ms if name not in (*STAGES, "decode")))
    for name, color in zip(stages, cycle(CYCLE), strict=False):
        if name not in result.stage_ms:
            continue
        ms = result.stage_ms[name]
        top_ms = base_ms + np.add.reduceat(ms, starts) / sizes
        label = f"{name.replace('_', ' ')} {np.median(ms):.3g}"
        axes.stairs(top_ms, edges_s, baseline=base_ms, fill=True, color=color, label=label)
        base_ms = top_ms
    # The total is more than its stages: a line of the slowest step of each group.
    slowest_ms = np.maximum.reduceat(result.total_ms, starts)
    label = f"total {np.median(result.total_ms):.3g} (medians, ms)"
    axes.stairs(slowest_ms, edges_s, baseline=None, color=INK, lw=0.7, label=label)
    highest_ms = _readable_top(slowest_ms)
    if "decode" in result.stage_ms:
        decode_ms = np.add.reduceat(result.stage_ms["decode"], starts) / sizes
        label = f"decode {np.median(result.stage_ms['decode']):.3g}, beside the total"
        axes.stairs(decode_ms, edges_s, baseline=None, color=GREY, lw=0.7, ls="--", label=label)
        highest_ms = max(highest_ms, _readable_top(decode_ms))
    axes.set(ylim=(0, highest_ms), xlim=(edges_s[0], edges_s[-1]))
    axes.legend(ncols=3, **LEGEND_ABOVE)
    return figure


def domain_figure(num_used: IntArray, num_out_of_domain: IntArray, result: RunResult) -> Figure:
    """Draw the share of features out of the noise model's domain over time.

    Args:
        num_used: features used in the solve of each step, [N-1].
        num_out_of_domain: number of those out of domain, [N-1].
        result: the run, for its times.
    """
    starts, edges_s = _groups(result)
    used = np.add.reduceat(num_used, starts)
    percent = 100.0 * np.add.reduceat(num_out_of_domain, starts) / np.maximum(used, 1)
    figure = Figure(figsize=(WIDTH_IN, 2.4))
    axes = figure.add_subplot(xlabel="time, s", ylabel="% of the features")
    axes.stairs(percent, edges_s, color=BLUE, alpha=0.15, fill=True)
    axes.stairs(percent, edges_s, baseline=None, color=BLUE, lw=1.1)
    axes.axhline(
        100.0 * WARN_ABOVE, color=GREY, lw=0.9, ls="--", label="warning level of the whole run"
    )
    axes.set(
        ylim=(0, min(1.15 * max(float(percent.max()), 100.0 * WARN_ABOVE), 102.0)),
        xlim=(edges_s[0], edges_s[-1]),
    )
    axes.legend(**LEGEND_ABOVE)
    return figure


def rejected_figure(rejected: dict[str, int]) -> Figure:
    """Draw the number of candidate points that each check rejected."""
    ranked = sorted(rejected.items(), key=lambda reason: (reason[1], reason[0]))
    total = max(sum(rejected.values()), 1)
    figure = Figure(figsize=(WIDTH_IN, 0.8 + 0.32 * len(ranked)))
    axes = figure.add_subplot(xlabel="points")
    names = [name.replace("_", " ") for name, _ in ranked]
    counts = [count for _, count in ranked]
    bars = axes.barh(names, counts, color=BLUE, height=0.65)
    axes.bar_label(
        bars,
        [f"{count:,} ({100 * count / total:.0f} %)" for count in counts],
        padding=4,
        fontsize=8.5,
    )
    axes.set_xlim(0, 1.3 * max([*counts, 1]))
    axes.grid(False, axis="y")
    return figure


def _seconds(result: RunResult) -> FloatArray:
    """Compute the time of each frame since the first, [N]."""
    return np.asarray((result.stamps_ns - result.stamps_ns[0]) * 1e-9)


def _groups(result: RunResult) -> tuple[IntArray, FloatArray]:
    """Find the first step of each of G groups, [G], and the times that bound them, s, [G+1]."""
    starts = np.arange(0, len(result.status), group_size(result))
    return starts, _seconds(result)[[*starts, len(result.status)]]


def _stretches(values: IntArray) -> list[tuple[int, int]]:
    """Find start and end (exclusive) of each run of equal values."""
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return list(pairwise(edges))


def _readable_top(slowest_ms: FloatArray) -> float:
    """Choose an upper limit that a few slow steps do not dominate."""
    typical_ms = 2.0 * float(np.percentile(slowest_ms, 95.0))
    return 1.1 * max(min(float(slowest_ms.max()), typical_ms), 1e-3)
