"""The report of a run: one self-contained page with its figures of merit, plots and pictures."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.consistency import Consistency, motion_consistency
from probevo.evaluation.metrics import Metrics
from probevo.evaluation.trajectory_errors import relative_motions
from probevo.output.metrics_table import metrics_rows, readable
from probevo.output.page import frames_section, grid, panel, write_page
from probevo.output.report_calibration import calibration_figure
from probevo.output.report_data import Drift, drift_of
from probevo.output.report_plots import axes_figure, error_figure, length_unit, trajectory_figure
from probevo.output.report_timelines import (
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

_CALIBRATION_NOTE = (
    "Steps whose error is within what their covariance claims: on the diagonal is honest, below it"
    " overconfident. Shaded: 95 % of honest runs of independent steps. Noisy truth, such as"
    " KITTI’s, shows its own noise instead."
)


def write_report(
    path: Path,
    result: RunResult,
    title: str,
    facts: Mapping[str, str],
    truth: FloatArray | None = None,
    metrics: Metrics | None = None,
    thumbnails: Sequence[tuple[str, bytes]] = (),
    config: str = "",
) -> None:
    """Write the report of a run. The same arguments give the same bytes.

    Args:
        path: the HTML file.
        result: a run of at least two frames.
        title: heading of the page, e.g. the name of the recording.
        facts: what a reader should know about the run, by name: recording, camera, noise model …
        truth: true poses T_world_cam of the frames, [N, 4, 4], m, in any world frame; NaN where
            unknown.
        metrics: comparison with the truth.
        thumbnails: caption and JPEG file of some frames with their tracks
            (``drawing.draw_tracks``).
        config: effective configuration, as text.

    Raises:
        ValueError: the run has fewer than two frames.
        InputError: the file cannot be written.
    """
    if len(result) < 2:
        raise ValueError(f"a report needs two frames, the run has {len(result)}")
    drift = drift_of(result, truth)
    consistency = None
    if truth is not None:
        consistency = motion_consistency(result.T_curr_prev, result.cov, relative_motions(truth))
    with figure_style():
        figures = _figures(result, drift, consistency)
    cards = '<section class="cards">\n' + "\n".join(_cards(result, drift, metrics)) + "\n</section>"
    details = [_metrics_section(metrics), frames_section(thumbnails), _config_section(config)]
    write_page(
        path, title, facts, sections=[*_warning_sections(result), cards, grid(figures), *details]
    )


def _cards(result: RunResult, drift: Drift, metrics: Metrics | None) -> list[str]:
    """The key figures: name, value, unit and an aside each."""
    seconds = float(result.stamps_ns[-1] - result.stamps_ns[0]) * 1e-9
    ms = float(np.median(result.total_ms))
    carried_on = int(np.sum(result.status != Status.OK))
    claimed_m = 3.0 * float(drift.position_sigma_m[-1])
    travelled_m = float(drift.distance_m[-1])
    cards = [
        _card("Frames", f"{len(result):,}", "", aside=f"{readable(seconds)} s"),
        _card("Travelled", *_length(travelled_m), "as estimated"),
    ]
    cards += _truth_cards(metrics) if metrics else []
    cards.append(_card("Claimed 3σ", *_length(claimed_m, "± "), "end position, worst axis"))
    if metrics and metrics.anees is not None:
        cards.append(_card("ANEES", readable(metrics.anees), "", aside="6 is honest"))
    cards += [
        _card(
            "Steps OK",
            readable(100.0 * (1.0 - carried_on / len(result.status))),
            "%",
            aside=f"{carried_on:,} carried on",
        ),
        _card(
            "Median time",
            readable(ms),
            "ms",
            aside=f"{readable(1000.0 / ms)} frames/s" if ms > 0 else "a frame",
        ),
    ]
    return cards


def _truth_cards(metrics: Metrics) -> list[str]:
    """Drift over the longest pieces that fit, and the error at the end."""
    cards = []
    if metrics.kitti_t_percent is not None and metrics.kitti_r_deg_per_m is not None:
        aside = f"{readable(metrics.kitti_r_deg_per_m)} °/m, 100–800 m"
        cards.append(_card("Drift", readable(metrics.kitti_t_percent), "%", aside=aside))
    elif metrics.short_t_percent is not None and metrics.short_r_deg_per_m is not None:
        aside = f"{readable(metrics.short_r_deg_per_m)} °/m, 10–50 m"
        cards.append(_card("Drift", readable(metrics.short_t_percent), "%", aside=aside))
    if metrics.final_error_m is not None and metrics.path_length_m is not None:
        share = 100.0 * metrics.final_error_m / max(metrics.path_length_m, 1e-9)
        aside = f"{readable(share)} % of the path" if metrics.path_length_m > 1.0 else ""
        cards.append(_card("End error", *_length(metrics.final_error_m), aside))
    return cards


def _length(length_m: float, sign: str = "") -> tuple[str, str]:
    """Number and unit."""
    factor, unit = length_unit(length_m)
    return sign + readable(length_m * factor), unit


def _figures(result: RunResult, drift: Drift, consistency: Consistency | None) -> list[str]:
    band = "Shaded: what the run itself claims as 3σ"
    shown = "Estimate and truth" if drift.error is not None else "No truth is known"
    what = "Error" if drift.error is not None else "Claimed uncertainty"
    panels = [
        panel(
            "Seen from above",
            f"{shown}; forward is up. Ellipses: claimed 3σ.",
            trajectory_figure(drift),
        ),
        panel(
            f"{what} along the path",
            f"{band} for the position, in its worst direction.",
            error_figure(drift),
        ),
        panel(f"{what} by axis", f"Pose along its own camera’s axes. {band}.", axes_figure(drift)),
    ]
    if consistency is not None:
        panels.append(
            panel(
                "Claim and truth, step by step", _CALIBRATION_NOTE, calibration_figure(consistency)
            )
        )
    panels.append(panel("Tracks and status", _status_note(result), tracks_figure(result)))
    if (
        result.num_used is not None
        and result.num_out_of_domain is not None
        and result.num_out_of_domain.any()
    ):
        note = "Features that lie where the noise model has seen no training data."
        panels.append(
            panel(
                "Out of domain",
                note,
                domain_figure(result.num_used, result.num_out_of_domain, result),
            )
        )
    panels.append(panel("Time by stage", _stages_note(result), stages_figure(result)))
    if result.rejected:
        panels.append(
            panel(
                "Points turned away", "By the check that did so.", rejected_figure(result.rejected)
            )
        )
    return panels


def _status_note(result: RunResult) -> str:
    worst = [status_label(Status(s)) for s in np.unique(result.status) if s != Status.OK]
    size = group_size(result)
    grouped = f" Line: the fewest tracks of every {size} steps." if size > 1 else ""
    if not worst:
        return (
            f"Every step is OK; {np.median(result.num_tracks):,.0f} tracks in the median.{grouped}"
        )
    return (
        f"Steps that are not OK ({', '.join(worst)}) are carried on from the gyro and the last"
        f" velocity.{grouped}"
    )


def _stages_note(result: RunResult) -> str:
    size = group_size(result)
    decoding = (
        " Images are decoded ahead, in threads of their own." if "decode" in result.stage_ms else ""
    )
    shown = (
        "Wall time of each step."
        if size == 1
        else f"Areas: means over {size} steps. Line: the slowest of them."
    )
    return shown + decoding


def _card(name: str, value: str, unit: str, aside: str) -> str:
    return (
        f'<div class="card"><div class="name">{name}</div><div class="value">{value}'
        f' <small>{unit}</small></div><div class="aside">{aside}</div></div>'
    )


def _warning_sections(result: RunResult) -> list[str]:
    return [
        f'<section class="panel warning"><h2>{heading}</h2>{escape(text)}</section>'
        for heading, text in run_warnings(result).items()
    ]


def _metrics_section(metrics: Metrics | None) -> str:
    if metrics is None:
        return ""
    rows = "\n".join(
        f'<tr><th>{name}</th><td class="value">{value}</td><td class="text">{text}</td></tr>'
        for name, value, text in metrics_rows(metrics)
    )
    return (
        '<section class="panel"><h2>Against the truth</h2>\n<table'
        f' class="texts">{rows}</table></section>'
    )


def _config_section(config: str) -> str:
    if not config:
        return ""
    return (
        "<details"
        f' class="panel"><summary>Configuration</summary><pre>{escape(config)}</pre></details>'
    )
