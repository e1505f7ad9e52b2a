"""The report of a run: one self-contained page with its figures of merit, plots and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from markupsafe import Markup

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.consistency import Consistency, motion_consistency
from probevo.evaluation.metrics import Metrics
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.evaluation.truth_noise import truth_noise_ratio
from probevo.output.headline import headline_drift
from probevo.output.metrics_table import metrics_table
from probevo.output.page import (
    body_panel,
    details,
    frames_section,
    grid,
    panel,
    table_panel,
    write_page,
)
from probevo.output.report.report_calibration import calibration_figure
from probevo.output.report.report_data import Drift, drift_of
from probevo.output.report.report_plots import (
    axes_figure,
    error_figure,
    length_unit,
    step_errors_figure,
    trajectory_figure,
)
from probevo.output.report.report_timelines import (
    domain_figure,
    group_size,
    rejected_figure,
    stages_figure,
    status_label,
    tracks_figure,
)
from probevo.output.run_result import RunResult
from probevo.output.run_warnings import run_warnings
from probevo.output.svg import figure_style
from probevo.output.table import readable
from probevo.output.templating import rendered

IMPLAUSIBLE_ANEES = 100.0
"""Errors of four claimed σ in the mean: more than robust solves with a working model leave."""
_CALIBRATION_NOTE = (
    "Steps whose error is within what their covariance claims: on the diagonal is consistent, below"
    " it overconfident. Shaded: 95 % of consistent runs of independent steps. Noisy truth, such as"
    " KITTI’s, shows its own noise instead."
)


@dataclass(frozen=True)
class KeyFigure:
    """One of the figures at the top of the report."""

    name: str
    value: str
    unit: str = ""
    aside: str = ""
    """Small print below the value."""


@dataclass(frozen=True)
class RunDescription:
    """The description of a run in a report, besides its results."""

    title: str
    """Heading of the page, e.g. the name of the recording."""
    facts: Mapping[str, str]
    """Facts at the top of the page, by name: recording, camera, noise model …"""
    config: str = ""
    """Effective configuration, as text."""


def write_report(
    path: Path,
    result: RunResult,
    description: RunDescription,
    *,
    truth: FloatArray | None = None,
    metrics: Metrics | None = None,
    thumbnails: Sequence[tuple[str, bytes]] = (),
) -> None:
    """Write the report of a run. The same arguments give the same bytes.

    Args:
        path: the HTML file.
        result: a run of at least two frames.
        description: the run in words.
        truth: true poses T_world_cam of the frames, [N, 4, 4], m, in any world frame; NaN where
            unknown.
        metrics: comparison with the truth.
        thumbnails: caption and JPEG file of some frames with their tracks
            (``drawing.draw_tracks``).

    Raises:
        ValueError: the run has fewer than two frames.
        InputError: the file cannot be written.
    """
    if len(result) < 2:
        raise ValueError(f"a report needs two frames, the run has {len(result)}")
    # What the figures show: the drift along the path, and the consistency of single steps.
    drift = drift_of(result, truth)
    consistency = None
    truth_noise = None
    if truth is not None:
        true_motions = relative_motions(truth)
        consistency = motion_consistency(result.T_curr_prev, result.cov, true_motions)
        truth_noise = truth_noise_ratio(
            result.T_curr_prev,
            result.cov,
            true_motions,
            duration_s=1e-9 * np.diff(result.stamps_ns),
            is_ok=result.status == Status.OK,
        )
    with figure_style():
        figures = _figures(result, drift, consistency, truth=truth)
    warnings = [
        body_panel(name, [], text, style="warning")
        for name, text in run_warnings(result, truth).items()
    ]
    truth_panel = Markup("")
    if metrics is not None:
        truth_panel = table_panel("Against the truth", [], metrics_table(metrics), style="texts")
    write_page(
        path,
        description.title,
        description.facts,
        sections=[
            *warnings,
            rendered("key_figures", cards=_key_figures(result, drift, metrics, truth_noise)),
            grid(figures),
            truth_panel,
            frames_section(thumbnails),
            details("Configuration", description.config),
        ],
    )


def _key_figures(
    result: RunResult, drift: Drift, metrics: Metrics | None, truth_noise: float | None
) -> list[KeyFigure]:
    """List the key figures of a run; ``truth_noise`` is that of ``truth_noise_ratio``."""
    duration_s = float(result.stamps_ns[-1] - result.stamps_ns[0]) * 1e-9
    figures = [
        KeyFigure("Frames", f"{len(result):,}", aside=f"{readable(duration_s)} s"),
        _length_figure("Travelled", float(drift.distance_m[-1]), "as estimated"),
    ]
    if metrics is not None:
        figures += _truth_figures(metrics)
    claimed_m = 3.0 * float(drift.position_sigma_m[-1])
    aside = _claim_aside(drift)
    figures.append(_length_figure("Claimed 3σ", claimed_m, aside, sign="± "))
    if metrics is not None and metrics.anees is not None:
        figures.append(_consistency_figure(metrics.anees, truth_noise))
    recovered = int(np.sum(result.status == Status.RECOVERED))
    dead_reckoned = int(np.sum(result.status != Status.OK)) - recovered
    percent_ok = 100.0 * float(np.mean(result.status == Status.OK))
    aside = f"{dead_reckoned:,} dead-reckoned" + (f", {recovered:,} recovered" if recovered else "")
    figures.append(KeyFigure("Steps OK", readable(percent_ok), "%", aside))
    ms = float(np.median(result.total_ms))
    rate = f"{readable(1000.0 / ms)} frames/s" if ms > 0 else "a frame"
    figures.append(KeyFigure("Median time", readable(ms), "ms", rate))
    return figures


def _claim_aside(drift: Drift) -> str:
    """Say what the claim is about, and that the end is further off, if it is.

    The truth may end earlier than the run: error and claim are compared at its last frame.
    """
    about = "end position, worst axis"
    if drift.error is None:
        return about
    last = int(np.flatnonzero(np.isfinite(drift.error).all(axis=1))[-1])
    claimed_m = 3.0 * float(drift.position_sigma_m[last])
    error_m = float(np.linalg.norm(drift.error[last, :3]))
    if not error_m > claimed_m > 0.0:
        return about
    times = readable(error_m / claimed_m)
    if last == len(drift.error) - 1:
        return f"{about}; the end error is {times} times this"
    return f"{about}; at frame {last}, the last with truth, the error is {times} times its claim"


def _consistency_figure(anees: float, truth_noise: float | None) -> KeyFigure:
    """Show the ANEES and what it should be, or that the truth is too coarse to tell.

    Smoothed truth, as that of KITTI odometry, hides its noise but not its slow errors.
    """
    if truth_noise is not None and truth_noise > 1.0:
        times = readable(truth_noise)
        aside = f"{readable(anees)}; the truth’s noise is at least {times} times the claimed σ"
        return KeyFigure("ANEES", "no test", aside=aside)
    aside = "6 is consistent"
    if anees > IMPLAUSIBLE_ANEES:
        aside += "; so far off, truth or calibration may be coarser than the claim"
    return KeyFigure("ANEES", readable(anees), aside=aside)


def _truth_figures(metrics: Metrics) -> list[KeyFigure]:
    """List the drift over the longest segments that fit, and the error at the end."""
    figures = []
    drift = headline_drift(metrics)
    if drift is not None:
        aside = f"{readable(drift.rotation_deg_per_m)} °/m, {drift.segments} m"
        figures.append(KeyFigure("Drift", readable(drift.translation_percent), "%", aside))
    if metrics.final_error_m is not None and metrics.path_length_m is not None:
        percent = 100.0 * metrics.final_error_m / max(metrics.path_length_m, 1e-9)
        aside = f"{readable(percent)} % of the path" if metrics.path_length_m > 1.0 else ""
        figures.append(_length_figure("End error", metrics.final_error_m, aside))
    return figures


def _length_figure(name: str, length_m: float, aside: str, *, sign: str = "") -> KeyFigure:
    """Show a length in the unit in which it reads well."""
    factor, unit = length_unit(length_m)
    return KeyFigure(name, sign + readable(length_m * factor), unit, aside)


def _figures(
    result: RunResult,
    drift: Drift,
    consistency: Consistency | None,
    *,
    truth: FloatArray | None,
) -> list[Markup]:
    """Draw the figures of the report, from the path to the points that were rejected."""
    has_truth = drift.error is not None
    what = "Error" if has_truth else "Claimed uncertainty"
    band = "Shaded: what the run itself claims as 3σ"
    panels = [
        panel(
            "Seen from above",
            f"{'Estimate and truth' if has_truth else 'No truth is known'}; forward is up."
            " Ellipses: claimed 3σ.",
            trajectory_figure(drift),
        ),
        panel(
            f"{what} along the path",
            f"{band} for the position, in its worst direction.",
            error_figure(drift),
        ),
        panel(f"{what} by axis", f"Pose along its own camera’s axes. {band}.", axes_figure(drift)),
    ]
    if consistency is not None and truth is not None:
        note = "Error of each motion against the true one (RPE), and the claimed 1σ of its length."
        panels.append(panel("Error of each step", note, step_errors_figure(result, truth)))
        figure = calibration_figure(consistency)
        panels.append(panel("Claim and truth, step by step", _CALIBRATION_NOTE, figure))
    panels.append(panel("Tracks and status", _status_note(result), tracks_figure(result)))
    # A run that never left the domain of its noise model needs no figure of that.
    if (
        result.out_of_domain
        and result.num_used is not None
        and result.num_out_of_domain is not None
    ):
        figure = domain_figure(result.num_used, result.num_out_of_domain, result)
        note = "Features that lie where the noise model has seen no training data."
        panels.append(panel("Out of domain", note, figure))
    panels.append(panel("Time by stage", _stages_note(result), stages_figure(result)))
    if result.rejected:
        figure = rejected_figure(result.rejected)
        panels.append(panel("Rejected points", "By the check that rejected them.", figure))
    return panels


def _status_note(result: RunResult) -> str:
    """Name the statuses other than OK, and explain what the lines of a long run show."""
    statuses = {Status(status) for status in np.unique(result.status)}
    reckoned = [status_label(status) for status in sorted(statuses - {Status.OK, Status.RECOVERED})]
    size = group_size(result)
    grouped = f" Line: the fewest tracks of every {size} steps." if size > 1 else ""
    medians = (
        f"{np.median(result.num_tracks):,.0f} tracks in the median,"
        f" {np.median(result.num_inliers):,.0f} of them inliers."
    )
    if statuses <= {Status.OK}:
        return f"Every step is OK; {medians}{grouped}"
    note = ""
    if reckoned:
        note = (
            f"Steps without a solve ({', '.join(reckoned)}) are dead-reckoned from the last"
            " velocity, and by the IMU where it is used."
        )
    if Status.RECOVERED in statuses:
        note += " Recovered ones lead from the last frame before, and end that uncertainty."
    return f"{note.strip()} {medians}{grouped}"


def _stages_note(result: RunResult) -> str:
    """Explain what the areas and the line of the times show."""
    size = group_size(result)
    note = "Wall time of each step."
    if size > 1:
        note = f"Areas: means over {size} steps. Line: the slowest of them."
    if "decode" in result.stage_ms:
        note += " Images are decoded ahead, in threads of their own."
    return note
