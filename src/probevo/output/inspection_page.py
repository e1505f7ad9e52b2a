"""One self-contained page on a noise model, on the features of a frame as it sees them, or on both."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from probevo.output.inspection_data import ColumnSummary, FrameView, ModelView, is_the_same
from probevo.output.inspection_plots import (
    correlation_figure,
    distances_figure,
    pairs_figure,
    profile_figure,
    searches_figure,
    weights_figure,
)
from probevo.output.metrics_table import readable
from probevo.output.page import grid, panel, write_page
from probevo.output.svg import figure_style

SUMMARY_HEAD = ("column", "unit", "training", "this frame", "undefined")
_SHORT_HASH = 12
_CARDS = '<div class="frames" style="grid-template-columns:repeat(auto-fill,minmax(min(100%,360px),1fr));gap:0 14px">'
_PICTURES = '<div class="frames" style="grid-template-columns:repeat(auto-fill,minmax(min(100%,560px),1fr))">'

_IF_RELATIVE = " It is relative to others of the same step: what all features of a step share cannot show."
_IF_LEANING = " Subsets lean to one side, so that extremes are more frequent among samples than among features."


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
        pictures: caption and JPEG file of the frame with its features in different colours, by the name of the column.
        summaries: figures of each column.

    Raises:
        ValueError: there is neither a model nor a frame.
        InputError: the file cannot be written.
    """
    if model is None and frame is None:
        raise ValueError("an inspection needs a model or a frame")
    sections = [_pictures_section(frame, pictures)] if frame is not None else []
    with figure_style():
        if model is not None and frame is not None:
            sections.append(grid(_frame_panels(model, frame)))
        sections.append(_summary_section(summaries, model, frame))
        if model is not None:
            sections += _model_sections(model, frame)
    write_page(path, _title(model, frame), _facts(model, frame), sections)


def summary_rows(summaries: Sequence[ColumnSummary]) -> list[tuple[str, ...]]:
    """A row for each column, under ``SUMMARY_HEAD``."""
    return [
        (
            column.name,
            column.unit,
            "–" if column.training is None else "{} ± {}".format(*map(readable, column.training)),
            "–" if column.frame_mean is None else readable(column.frame_mean),
            percent(column.undefined) if column.undefined > 0.0 else "–",
        )
        for column in summaries
    ]


def percent(share: float) -> str:
    """A share in words; what is more than nothing never reads as nothing."""
    return "0 %" if share == 0.0 else "< 0.1 %" if share < 0.001 else f"{100.0 * share:.1f} %"


def _title(model: ModelView | None, frame: FrameView | None) -> str:
    if frame is None:
        return f"What {model.name} learned" if model else ""
    return f"{frame.recording}, frame {frame.index}" + (f", as {model.name} sees it" if model else "")


def _facts(model: ModelView | None, frame: FrameView | None) -> dict[str, str]:
    facts = {}
    if frame is not None:
        facts["Features"] = f"{len(frame.uv):,}"
        facts["Image"] = ("none; area of " if frame.left is None else "") + "{}×{} px".format(*frame.size_px)
    if model is not None:
        inner = model.model
        recordings = inner.training.get("recordings", [])
        frames = sum(recording["frames"] for recording in recordings)
        origin = f" from {frames:,} frames of {len(recordings)} recording{'s' * (len(recordings) != 1)}"
        facts["Samples"] = f"{len(model.log_alpha):,}" + (origin if recordings else "")
        facts |= {"K": f"{inner.neighbors}", "γ": f"{inner.exponent:g}", "Average of α": inner.average}
        facts["Scaled noise"] = str(inner.to_file().facts["base"]["name"])
    return facts


def _pictures_section(frame: FrameView, pictures: Mapping[str, tuple[str, bytes]]) -> str:
    others = []
    constant = [name for name, values in zip(frame.columns, frame.phi.T, strict=True) if is_the_same(values)]
    if constant:
        others.append(f" The same for all features, and so not drawn: {', '.join(constant)}.")
    figures = "\n".join(
        f'<figure><img alt="{escape(caption)}" src="data:image/jpeg;base64,{base64.b64encode(jpeg).decode()}">'
        f"<figcaption>{escape(caption)}</figcaption></figure>"
        for name, (caption, jpeg) in pictures.items()
        if name not in constant
    )
    note = (
        "The ends of each bar are the 2 % and 98 % quantiles of this frame; ≤ and ≥ say that there are values beyond, "
        f"in the same colour. Hollow grey rings: the predictor is undefined.{''.join(others)}"
    )
    return (
        f'<section class="panel"><h2>Its features</h2><p class="note">{note}</p>\n{_PICTURES}{figures}</div></section>'
    )


def _frame_panels(model: ModelView, frame: FrameView) -> list[str]:
    """Where the frame lies among the training data."""
    weights_note = (
        f"β = (mean of the K nearest α / ᾱ)^γ scales the noise of a feature. Here from {_range(frame.beta)}; over the "
        f"training samples from {_range(model.beta)} (5 to 95 %)."
    )
    far = 0.0 if frame.radius is None else float(np.mean(frame.radius > model.far_radius))
    distances_note = (
        f"From each feature to the K-th nearest training sample, over standardised columns. {percent(far)} are far: "
        "farther than 99 % of the training samples are from theirs. There, weights are guesses."
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
        "By how strongly α varies with each, the strongest first. Above: mean ln(α/ᾱ) of the training samples in bins "
        "of equally many, and two standard errors, for which samples that share a subset count as one; all on the same "
        "scale. A sample’s α is that of a whole subset, which dilutes what the one feature does to it."
        + _IF_RELATIVE * bool(settings.get("relative"))
        + " Below: where the training samples lie (grey)"
        + " and the features of this frame (orange)" * (frame is not None)
        + "; the outermost half percent, and all beyond, is in the outermost bins."
        + _IF_LEANING * bool(settings.get("contrast"))
        + " What is undefined stands apart at the left; its bar may be cut off."
    )
    profiles = f'<p class="note">{note}</p>\n{_CARDS}\n' + "\n".join(cards) + "\n</div>"
    return [heading, profiles, *_density_sections(model, frame), _settings_section(model)]


def _profile_panel(model: ModelView, m: int, frame: FrameView | None) -> str:
    name, profile = model.columns[m], model.profiles[m]
    note = f"{percent(profile.share_explained).replace('–', '0 %')} of the variance of ln α"
    if profile.share_undefined > 0.0:
        note += f"; {percent(profile.share_undefined)} undefined"
    return panel(escape(name), note, profile_figure(model, m, frame), f"profile-{m}")


def _density_sections(model: ModelView, frame: FrameView | None) -> list[str]:
    searches = model.model.training.get("searches", {})
    panels = []
    if searches:
        note = "By cross-validation over blocks of time (K), and by the motion’s error with each (γ); lower is better."
        panels.append(panel("How K and γ were chosen", note, searches_figure(searches)))
    panels.append(_training_section(model))
    note = "Spearman’s, over the training samples; the strongest column first. Columns alike tell the same twice."
    panels.append(panel("Correlation of the columns", note, correlation_figure(model)))
    sections = [grid(panels)]
    if len(model.columns) > 1:
        shown = "Blue: density of the training samples." + (" Orange: the frame’s features." if frame else "")
        title = "Where the data lies, over the most telling columns"
        sections.append(panel(title, shown, pairs_figure(model, frame), "pairs"))
    return sections


def _summary_section(summaries: Sequence[ColumnSummary], model: ModelView | None, frame: FrameView | None) -> str:
    wanted = (model is not None, frame is not None, True)
    name, _, *titles = SUMMARY_HEAD
    head = f"<th>{name}</th>" + "".join(f"<th>{title}</th>" for title, want in zip(titles, wanted, strict=True) if want)
    body = []
    for name, unit, *cells in summary_rows(summaries):
        shown = "".join(f"<td>{escape(cell)}</td>" for cell, want in zip(cells, wanted, strict=True) if want)
        body.append(f'<tr><th>{escape(name)} <small style="color:var(--muted)">{escape(unit)}</small></th>{shown}</tr>')
    rows = "\n".join(body)
    whose = "the frame’s features" if frame is not None else "the training samples"
    training = "Training: mean ± standard deviation of all features. " if model is not None else ""
    note = f"{training}Undefined: share of {whose}."
    return (
        f'<section class="panel"><h2>The predictors in figures</h2><p class="note">{note}</p>\n'
        f'<table class="figures"><thead><tr>{head}</tr></thead><tbody>\n{rows}\n</tbody></table></section>'
    )


def _training_section(model: ModelView) -> str:
    recordings: Sequence[Mapping[str, Any]] = model.model.training.get("recordings", [])
    if not recordings:
        return ""
    rows = "\n".join(
        f"<tr><th>{escape(str(recording['name']))}</th><td>{recording['frames']:,}</td>"
        f"<td>{escape(str(recording['sha256'])[:_SHORT_HASH])}…</td></tr>"
        for recording in recordings
    )
    head = "<th>recording</th><th>frames</th><th>SHA-256</th>"
    return (
        '<section class="panel"><h2>Trained on</h2>'
        f'<table class="figures"><thead><tr>{head}</tr></thead><tbody>\n{rows}\n</tbody></table></section>'
    )


def _settings_section(model: ModelView) -> str:
    settings = model.model.training.get("settings")
    if not settings:
        return ""
    text = yaml.safe_dump(settings, sort_keys=True, allow_unicode=True)
    return f'<details class="panel"><summary>Settings of the training</summary><pre>{escape(text)}</pre></details>'
