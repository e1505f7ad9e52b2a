"""Words and figures on the training of a model, for terminal and pages."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from probevo.arrays import FloatArray
from probevo.output.run_facts import jitter_text
from probevo.output.svg import BLUE, MUTED, ORANGE, WIDTH_IN
from probevo.output.table import UNKNOWN_TEXT, Column, Row, Table, text_table

END_ERROR = (
    "End error: distance between the end of the estimated path and its true end, which training"
    " does not use unless it is given."
)


def origin(training: Mapping[str, Any]) -> str:
    """Name the number of frames and recordings that a model was trained on; empty if not known."""
    recordings = training.get("recordings", [])
    if not recordings:
        return ""
    frames = num_frames(training)
    plural = "" if len(recordings) == 1 else "s"
    return f"{frames:,} frames of {len(recordings)} recording{plural}"


def num_frames(training: Mapping[str, Any]) -> int:
    """Return the number of frames that a model was trained on; 0 if not known."""
    return sum(recording["frames"] for recording in training.get("recordings", []))


def em_table(
    iterations: Sequence[Mapping[str, float]], initial: str, kept: int | None = None
) -> Table:
    """Make a table with a row for each EM iteration.

    Args:
        iterations: the results of each EM iteration; ``iterations`` of a model file.
        initial: the noise that the first was given.
        kept: number of iterations after which the model was taken, whose row is marked; there is
            none if the model of the last fit was not evaluated any more.
    """
    names = [str(number) for number in range(len(iterations))]
    names[:1] = [f"0: {initial}"] if names else []
    if kept is not None and 0 < kept < len(names):
        names[kept] = f"{kept}: kept"
    has_end_error = any("loop_error_m" in iteration for iteration in iterations)
    columns = [
        Column("iteration", format=str, align="left"),
        Column("likelihood, nats a feature", format="{:.4f}".format),
    ]
    if has_end_error:
        columns.append(Column("end error, m", format=_end_error_text))
    rows = []
    for name, iteration in zip(names, iterations, strict=True):
        values: list[object] = [name, iteration["log_likelihood"]]
        if has_end_error:
            values.append(iteration.get("loop_error_m"))
        rows.append(Row.of(*values))
    return Table(tuple(columns), tuple(rows), notes=(END_ERROR,) if has_end_error else ())


def kept_text(training: Mapping[str, Any]) -> str:
    """Say after which EM iteration the model was taken, and why; empty if it is not known."""
    kept = training.get("kept_iteration")
    if kept is None:
        return ""
    is_evaluated = kept < len(training.get("iterations", []))
    last = "the last" if is_evaluated else "the last, which is not evaluated any more"
    gain = training.get("time_correlation_gain")
    if gain is None:
        return f"the model after {kept} iterations, {last}"
    if is_evaluated:
        return (
            f"the model after {kept} iterations; more, with time-correlated errors, change the"
            f" likelihood by {signed(gain)} nats a feature, too little to accept these"
        )
    return (
        f"the model after {kept} iterations, {last}; time-correlated errors change the likelihood"
        f" by {signed(gain)} nats a feature"
    )


def sizes_text(training: Mapping[str, Any]) -> str:
    """Say how large the errors of the recordings are against the model; empty for one recording."""
    factors = training.get("recording_factors", [])
    if len(factors) < 2:
        return ""
    ratios = np.sqrt(factors)
    return (
        f"of the recordings differ: {ratios.min():.2f} to {ratios.max():.2f} times as large as the"
        " model says (σ); that of a new recording is learned while it runs"
    )


def em_note(training: Mapping[str, Any], initial: str) -> str:
    """Explain the figure of the EM iterations, given what the first one began with."""
    kept = kept_text(training)
    sentences = [f"Iteration 0 has the noise of {initial}."]
    if kept:
        sentences.append(f"Kept: {kept}.")
    if _has_end_errors(training["iterations"]):
        sentences.append(END_ERROR)
    return " ".join(sentences)


def _has_end_errors(iterations: Sequence[Mapping[str, float]]) -> bool:
    """Return whether an end error is known of each iteration: that of a closed loop."""
    return all("loop_error_m" in iteration for iteration in iterations)


def em_figure(iterations: Sequence[Mapping[str, float]]) -> Figure:
    """Draw likelihood and, where known, end error over the EM iterations (PROBE-GK Fig. 8)."""
    shown = [("log_likelihood", "log likelihood, nats a feature", BLUE)]
    if _has_end_errors(iterations):
        shown.append(("loop_error_m", "end error, m", ORANGE))
    figure = Figure(figsize=(WIDTH_IN, 2.6))
    all_axes = np.atleast_1d(figure.subplots(1, len(shown)))
    for axes, (key, meaning, color) in zip(all_axes, shown, strict=True):
        values = [iteration[key] for iteration in iterations]
        axes.plot(values, color=color, lw=1.4, marker="o", ms=3.5)
        axes.set_title(meaning, color=MUTED)
        axes.set_xlabel("EM iteration")
        axes.xaxis.set_major_locator(MaxNLocator(8, integer=True))
        if key == "loop_error_m":
            axes.set_ylim(0.0, 1.1 * max(values) + 1e-9)
    return figure


def scale_table(scale: FloatArray) -> Table:
    """Make a table of a scale matrix [4, 4], px², as σ and correlations.

    It has a row for each coordinate of an observation, and one for the disparity u_l − u_r.
    """
    sigma_px = np.sqrt(np.diagonal(scale))
    correlation = scale / np.outer(sigma_px, sigma_px)
    rows = []
    for i, name in enumerate(("u_l", "v_l", "u_r", "v_r")):
        lower = [signed(correlation[i, j], decimals=2) if j < i else "" for j in range(3)]
        rows.append((name, f"{sigma_px[i]:.3f}", *lower))
    disparity_px = np.sqrt(scale[0, 0] + scale[2, 2] - 2.0 * scale[0, 2])
    rows.append(("disparity, u_l − u_r", f"{disparity_px:.3f}", "", "", ""))
    return text_table(("", "σ, px", "correlation: u_l", "v_l", "u_r"), rows)


def time_correlation_text(ratio: float) -> str:
    """Describe the part of a disparity's error that is the same in both frames.

    Args:
        ratio: its σ over that of the part that is new in each frame (``time_correlation``).
    """
    if not ratio:
        return "none"
    return f"its σ is {ratio:.2g} times that of the part of the disparity that is new in each frame"


def learned_jitter_text(jitter_cov: FloatArray | None) -> str:
    """Describe the jitter of the rig that a model has learned, by its covariance, [3, 3], rad²."""
    if jitter_cov is None:
        return "not learned"
    return f"the right camera {jitter_text(np.sqrt(np.diagonal(jitter_cov)))}"


def noise_of_text(refers_to: str) -> str:
    """Say what the scale matrix of a model describes, by its ``refers_to``."""
    return "single observations" if refers_to == "observation" else "residuals as a whole"


def signed(value: float | None, *, decimals: int = 3) -> str:
    """Format a number with its sign; a dash where unknown."""
    return UNKNOWN_TEXT if value is None else f"{value:+.{decimals}f}".replace("-", "−")


def _end_error_text(error_m: float | None) -> str:
    return UNKNOWN_TEXT if error_m is None else f"{error_m:.3f}"
