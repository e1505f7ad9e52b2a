"""The results of PROBE Fig. 5: a table, a page, and a file of the observations."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from html import escape
from pathlib import Path

import cv2
import numpy as np
from markupsafe import Markup
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from probevo.arrays import AnyArray, FloatArray
from probevo.output.page import grid, panel, write_page
from probevo.output.svg import CYCLE, LEGEND_ABOVE, MUTED, WIDTH_IN, figure_style
from probevo.storage.files import write_atomically
from probevo_paper.figure_5 import BlurObservations, BlurView
from probevo_paper.figure_5_scene import FAST, INSTANT_STEP_S, LEFT
from probevo_paper.figure_5_statistics import AXES, KINDS, ErrorSummary, Finding, verdicts

TABLE_HEAD = (
    "error",
    "blur",
    "N",
    "instants",
    "mean ± s.e., px",
    "σ, px",
    "core σ, px",
    "variance ×",
    "95 %",
)
CSV_HEAD = (
    "time_s,instant,corner,blur,reprojection_u_px,reprojection_v_px,tracking_u_px,tracking_v_px"
)
LOW_COLOR = CYCLE[0]
HIGH_COLOR = CYCLE[1]
_BINS = 48
_SHOWN_CORES = 4.5
"""Reach of a histogram, in σ of the core."""
_ENLARGED = 3
_DETECTED_BGR = (30, 138, 224)
_TRACKED_BGR = (60, 60, 225)
_SHIFT = 4
"""Fractional bits of the coordinates that OpenCV draws at."""


def table_rows(results: Sequence[Finding]) -> list[tuple[str, ...]]:
    """Return a row for each error, axis and class of blur, under ``TABLE_HEAD``."""
    rows = []
    for finding in results:
        name = f"{finding.kind}, {finding.axis}"
        low, high = finding.ratio_interval
        rows.append((name, "low", *_cells(finding.low), "", ""))
        rows.append(
            (name, "high", *_cells(finding.high), f"{finding.ratio:.1f}", f"{low:.1f} … {high:.1f}")
        )
    return rows


def _cells(part: ErrorSummary) -> tuple[str, ...]:
    """Return what the table says of the errors in one class of blur."""
    return (
        f"{part.count:,}",
        f"{part.instants}",
        f"{part.mean_px:+.4f} ± {part.standard_error_px:.4f}",
        f"{part.sigma_px:.3f}",
        f"{part.core_px:.3f}",
    )


def counts_text(views: Sequence[BlurView], observations: BlurObservations) -> str:
    """Say how often the board was not found, and how many corners were lost in tracking."""
    missed = {
        "left": sum(view.left_px is None for view in views),
        "right": sum(not view.right_found for view in views),
        "fast": sum(not view.fast_found for view in views),
    }
    tracked_views = sum(view.previous_found and view.left_px is not None for view in views)
    trackable = tracked_views * len(np.unique(observations.corner))
    lost = trackable - int(np.isfinite(observations.tracking_px[:, 0]).sum())
    where = ", ".join(f"{count} {name}" for name, count in missed.items())
    return (
        f"Board not found in {where} images of {len(views)} each; {lost} of {trackable:,} corners"
        " lost in tracking."
    )


def write_csv(path: Path, observations: BlurObservations) -> None:
    """Write a line for each corner observation at full precision; ``nan`` where it has no error.

    Raises:
        InputError: the file cannot be written.

    """
    columns = (
        observations.time_s,
        observations.instant,
        observations.corner,
        observations.blur,
        *observations.reprojection_px.T,
        *observations.tracking_px.T,
    )
    lines = [
        ",".join(map(repr, row))
        for row in zip(*(column.tolist() for column in columns), strict=True)
    ]
    write_atomically(path, "\n".join([CSV_HEAD, *lines, ""]))


def write_blur_page(
    path: Path,
    views: Sequence[BlurView],
    observations: BlurObservations,
    *,
    results: tuple[Finding, ...],
    seed: int,
) -> None:
    """Write the page: verdicts, histograms as in PROBE Fig. 5, the table, two images of the board.

    Raises:
        InputError: the file cannot be written.

    """
    facts = {
        "Instants": f"{len(views)}, {INSTANT_STEP_S:g} s apart",
        "Shutters": f"{1e3 * LEFT.shutter_s:g} ms, fast camera {1e3 * FAST.shutter_s:g} ms",
        "Low from high": f"median of the blur metric, {observations.threshold:.3f}",
        "Seed": str(seed),
    }
    reprojection, tracking = KINDS
    with figure_style():
        figures = [
            panel(
                f"{reprojection.capitalize()} error",
                "Corners triangulated by the slow stereo rig and projected into the fast camera −"
                " corners seen there.",
                _histograms(observations.reprojection_px, observations, results, kind=reprojection),
            ),
            panel(
                f"{tracking.capitalize()} error",
                "Corners tracked by Lucas–Kanade from the left image before − corners detected"
                " anew.",
                _histograms(observations.tracking_px, observations, results, kind=tracking),
            ),
        ]
    sections = [
        _verdict(views, observations, results),
        grid(figures),
        _table(results),
        _pictures(views),
    ]
    write_page(path, "Blur and the errors of features", facts, sections=sections)


def _verdict(
    views: Sequence[BlurView], observations: BlurObservations, results: tuple[Finding, ...]
) -> Markup:
    """Return the section that says whether the paper's claim holds."""
    claim = "PROBE Fig. 5: errors stay approximately zero-mean, and their variance grows with blur."
    lines = "".join(
        f"<li>{escape(line)}</li>"
        for line in (*verdicts(results), counts_text(views, observations))
    )
    return Markup(
        '<section class="panel"><h2>Does the claim hold?</h2><p'
        f' class="note">{claim}</p><ul>{lines}</ul></section>'
    )


def _histograms(
    error: FloatArray, observations: BlurObservations, results: Sequence[Finding], kind: str
) -> Figure:
    """Draw errors, [N, 2], px, along both axes at low and high blur, with normals of the cores."""
    figure = Figure(figsize=(WIDTH_IN, 2.9))
    chosen = [finding for finding in results if finding.kind == kind]
    for k, (axes, finding) in enumerate(zip(figure.subplots(1, len(AXES)), chosen, strict=True)):
        reach_px = _SHOWN_CORES * max(finding.high.core_px, finding.low.core_px, 1e-3)
        bins = np.linspace(-reach_px, reach_px, _BINS + 1)
        outside = int(np.sum(np.abs(error[:, k]) > reach_px))
        for part, is_in, color, name in (
            (finding.low, ~observations.is_high, LOW_COLOR, "low blur"),
            (finding.high, observations.is_high, HIGH_COLOR, "high blur"),
        ):
            _draw(axes, error[is_in, k], part, bins=bins, color=color, name=name)
        axes.set(xlabel=f"{finding.axis} error, px", xlim=(-reach_px, reach_px))
        note = f"{outside} of\n{finding.low.count + finding.high.count:,}\noutside"
        axes.text(
            0.98,
            0.96,
            note,
            transform=axes.transAxes,
            ha="right",
            va="top",
            color=MUTED,
            fontsize=8,
        )
    figure.axes[0].set_ylabel("share of the class in a bin")
    figure.axes[0].legend(ncols=2, **LEGEND_ABOVE)
    return figure


def _draw(
    axes: Axes, error: FloatArray, part: ErrorSummary, *, bins: FloatArray, color: str, name: str
) -> None:
    """Draw the histogram of the errors of one class, [N], px, and the normal of their core."""
    known = error[np.isfinite(error)]
    axes.hist(
        known,
        bins.tolist(),
        weights=np.full(len(known), 1.0 / max(len(known), 1)),
        color=color,
        alpha=0.45,
        label=name,
    )
    if part.core_px > 0.0:
        x_px = np.linspace(bins[0], bins[-1], 400)
        width_px = bins[1] - bins[0]
        normal = np.exp(-0.5 * ((x_px - part.median_px) / part.core_px) ** 2) / (
            np.sqrt(2.0 * np.pi) * part.core_px
        )
        axes.plot(x_px, width_px * normal, color=color, lw=1.6)


def _table(results: Sequence[Finding]) -> Markup:
    """Return the section with the table of means and spreads."""
    head = "".join(f"<th>{escape(name)}</th>" for name in TABLE_HEAD[1:])
    body = []
    for k, (name, *cells) in enumerate(table_rows(results)):
        if k % 2 == 0:
            body.append(
                f'<tr class="group"><th colspan="{len(cells)}">{name.capitalize()}</th></tr>'
            )
        first, *others = cells
        body.append(
            f"<tr><th>{first}</th>" + "".join(f"<td>{cell}</td>" for cell in others) + "</tr>"
        )
    note = (
        "Errors within a second are correlated: the standard error of a mean and the interval of"
        " the ratio of the variances count seconds, not corners. The core’s σ is 1.4826 times the"
        " median absolute deviation. The curves above are normals with this σ; the tails, mostly"
        " corners that tracking lost, would flatten any other."
    )
    rows = "\n".join(body)
    return Markup(
        f'<section class="panel"><h2>Mean and spread</h2><p class="note">{note}</p>\n'
        f'<table class="figures"><thead><tr>{head}</tr></thead>'
        f"<tbody>\n{rows}\n</tbody></table></section>"
    )


def _pictures(views: Sequence[BlurView]) -> Markup:
    """Return the section with the board at low and at high blur, and its corners."""
    seen = sorted(
        ((float(np.mean(v.blur)), v) for v in views if v.blur is not None), key=lambda pair: pair[0]
    )
    figures = []
    for name, share in (("Low", 0.1), ("High", 0.93)) if seen else ():
        metric, view = seen[int(share * (len(seen) - 1))]
        png = base64.b64encode(cv2.imencode(".png", _marked(view))[1].tobytes()).decode()
        caption = f"{name} blur: {metric:.2f} in the mean of the corners, at {view.time_s:.1f} s"
        image = f'<img alt="{caption}" src="data:image/png;base64,{png}">'
        figures.append(f"<figure>{image}<figcaption>{caption}</figcaption></figure>")
    note = (
        "The left image around the board, enlarged three times. Rings: corners as detected. Dots:"
        " as tracked to here."
    )
    head = f'<h2>The board</h2><p class="note">{note}</p>'
    return Markup(
        f'<section class="panel">{head}\n<div class="frames">{"".join(figures)}</div></section>'
    )


def _marked(view: BlurView) -> AnyArray:
    """Return the enlarged left image with the detected and the tracked corners."""
    image = cv2.resize(view.left, None, fx=_ENLARGED, fy=_ENLARGED, interpolation=cv2.INTER_NEAREST)
    picture = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR)
    if view.left_px is None:
        return picture
    _draw_circles(picture, view.left_px, _DETECTED_BGR, radius_px=6.0, thickness=1)
    tracked_px = view.left_px + view.tracking_px
    _draw_circles(picture, tracked_px, _TRACKED_BGR, radius_px=2.2, thickness=cv2.FILLED)
    return picture


def _draw_circles(
    picture: AnyArray,
    places_px: FloatArray,
    color: tuple[int, int, int],
    *,
    radius_px: float,
    thickness: int,
) -> None:
    """Draw circles into the enlarged picture at places of the image, [N, 2], px; none at NaN."""
    known_px = places_px[np.isfinite(places_px).all(axis=1)]
    centers_px = (known_px + 0.5) * _ENLARGED - 0.5
    for u, v in np.round(centers_px * 2**_SHIFT).astype(int).tolist():
        cv2.circle(
            picture,
            (u, v),
            radius=int(radius_px * 2**_SHIFT),
            color=color,
            thickness=thickness,
            lineType=cv2.LINE_AA,
            shift=_SHIFT,
        )
