"""One self-contained page on a noise model, on the features of a frame as it sees them, or on both."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from probevo.output.inspection_data import ColumnSummary, FrameView, ModelView
from probevo.output.inspection_plots import (
    correlation_figure,
    distances_figure,
    pairs_figure,
    profile_figure,
    searches_figure,
    weights_figure,
)
from probevo.output.inspection_sections import (
    CARDS,
    frame_facts,
    origin,
    page_title,
    percent,
    pictures_section,
    settings_section,
    summary_section,
    training_section,
)
from probevo.output.metrics_table import readable
from probevo.output.page import grid, panel, write_page
from probevo.output.svg import figure_style

_IF_RELATIVE = (
    " It is relative to others of the same step: what all features of a step share cannot show."
)
_IF_LEANING = (
    " Subsets lean to one side, so that extremes are more frequent among samples than among"
    " features."
)


def write_inspection(
    path: Path,
    model: ModelView | None,
    frame: FrameView | None,
    pictures: Mapping[str, tuple[str, bytes]],
    summaries: Sequence[ColumnSummary],
) -> None:
    """Write the page. The same arguments give the same bytes.

    Args:
        path: the HTML file.
        model: left out, only the predictors of the frame are shown.
        frame: left out, only the model is shown.
        pictures: caption and JPEG file of the frame with its features in different colours, by the
            name of the column.
        summaries: figures of each column.

    Raises:
        ValueError: there is neither a model nor a frame.
        InputError: the file cannot be written.
    """
    if model is None and frame is None:
        raise ValueError("an inspection needs a model or a frame")
    sections = [pictures_section(frame, pictures)] if frame is not None else []
    with figure_style():
        if model is not None and frame is not None:
            sections.append(grid(_frame_panels(model, frame)))
        sections.append(
            summary_section(summaries, trained=model is not None, has_frame=frame is not None)
        )
        if model is not None:
            sections += _model_sections(model, frame)
    write_page(
        path,
        page_title(model.name if model else None, frame),
        _facts(model, frame),
        sections=sections,
    )


def _facts(model: ModelView | None, frame: FrameView | None) -> dict[str, str]:
    facts = frame_facts(frame)
    if model is not None:
        inner = model.model
        facts["Samples"] = f"{len(model.log_alpha):,}{origin(inner.training)}"
        facts |= {
            "K": f"{inner.neighbors}",
            "γ": f"{inner.exponent:g}",
            "Average of α": inner.average,
        }
        facts["Scaled noise"] = str(inner.to_file().facts["base"]["name"])
    return facts


def _frame_panels(model: ModelView, frame: FrameView) -> list[str]:
    """Where the frame lies among the training data."""
    weights_note = (
        "β = (mean of the K nearest α / ᾱ)^γ scales the noise of a feature. Here from"
        f" {_range(frame.beta)}; over the training samples from {_range(model.beta)} (5 to 95 %)."
    )
    far = 0.0 if frame.radius is None else float(np.mean(frame.radius > model.far_radius))
    distances_note = (
        "From each feature to the K-th nearest training sample, over standardised columns."
        f" {percent(far)} are far: farther than 99 % of the training samples are from theirs."
        " There, weights are guesses."
    )
    return [
        panel("Weights in this frame", weights_note, weights_figure(model, frame)),
        panel("Distance from the training data", distances_note, distances_figure(model, frame)),
    ]


def _range(beta: Any) -> str:
    low, high = np.quantile(beta, [0.05, 0.95]).tolist()
    return f"{readable(low)} to {readable(high)}"


def _model_sections(model: ModelView, frame: FrameView | None) -> list[str]:
    aside = f"<small>{escape(model.name)}</small>" if frame is not None else ""
    heading = f'<h2 class="sequence">What the model learned{aside}</h2>'
    cards = [_profile_panel(model, m, frame) for m in model.order]
    settings = model.model.training.get("settings", {})
    note = (
        "By how strongly α varies with each, the strongest first. Above: mean ln(α/ᾱ) of the"
        " training samples in bins of equally many, and two standard errors, for which samples that"
        " share a subset count as one; all on the same scale. A sample’s α is that of a whole"
        " subset, which dilutes what the one feature does to it."
        + _IF_RELATIVE * bool(settings.get("relative"))
        + " Below: where the training samples lie (grey)"
        + " and the features of this frame (orange)" * (frame is not None)
        + "; the outermost half percent, and all beyond, is in the outermost bins."
        + _IF_LEANING * bool(settings.get("contrast"))
        + " What is undefined stands apart at the left; its bar may be cut off."
    )
    profiles = f'<p class="note">{note}</p>\n{CARDS}\n' + "\n".join(cards) + "\n</div>"
    return [
        heading,
        profiles,
        *_density_sections(model, frame),
        settings_section(model.model.training),
    ]


def _profile_panel(model: ModelView, m: int, frame: FrameView | None) -> str:
    name = model.columns[m]
    profile = model.profiles[m]
    note = f"{percent(profile.share_explained).replace('–', '0 %')} of the variance of ln α"
    if profile.share_undefined > 0.0:
        note += f"; {percent(profile.share_undefined)} undefined"
    return panel(escape(name), note, profile_figure(model, m, frame), name=f"profile-{m}")


def _density_sections(model: ModelView, frame: FrameView | None) -> list[str]:
    searches = model.model.training.get("searches", {})
    panels = []
    if searches:
        note = (
            "By cross-validation over blocks of time (K), and by the motion’s error with each (γ);"
            " lower is better."
        )
        panels.append(panel("How K and γ were chosen", note, searches_figure(searches)))
    panels.append(training_section(model.model.training))
    note = (
        "Spearman’s, over the training samples; the strongest column first. Columns alike tell the"
        " same twice."
    )
    panels.append(panel("Correlation of the columns", note, correlation_figure(model)))
    sections = [grid(panels)]
    if len(model.columns) > 1:
        shown = "Blue: density of the training samples." + (
            " Orange: the frame’s features." if frame else ""
        )
        title = "Where the data lies, over the most telling columns"
        sections.append(panel(title, shown, pairs_figure(model, frame), name="pairs"))
    return sections
