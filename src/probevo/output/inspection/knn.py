"""The page on a PROBE model (k nearest neighbours), and on a frame's features as it sees them."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from probevo.arrays import FloatArray
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.output.inspection.common_sections import (
    HOW_IT_WAS_TRAINED,
    FramePart,
    ModelPage,
    percent,
    settings_section,
    training_section,
)
from probevo.output.inspection.feature_pictures import Shades, value_shades, weight_shades
from probevo.output.inspection.knn_data import SEARCHED, FrameWeights, ModelView
from probevo.output.inspection.knn_plots import (
    correlation_figure,
    distances_figure,
    pairs_figures,
    profile_figure,
    searches_figure,
    weights_figure,
)
from probevo.output.inspection.predictors import (
    ColumnSummary,
    column_shades,
    column_summaries,
    column_table,
    drawn,
)
from probevo.output.inspection.subject import (
    Findings,
    FrameView,
    Picture,
    Subject,
    TrainingSummary,
)
from probevo.output.inspection.training_facts import origin
from probevo.output.page import grid, heading, panel, row_panel
from probevo.output.svg import figure_style
from probevo.output.table import readable, text_table
from probevo.output.templating import rendered

_IF_RELATIVE = (
    " It is relative to others of the same step: what all features of a step share cannot show."
)
_IF_CONTRAST = (
    " Subsets lean to one side, so that extremes are more frequent among samples than among"
    " features."
)
_TERMS = {
    "Samples": (
        "Features that took part in a motion of a random subset, each with the error α of that"
        " motion."
    ),
    "K": "Number of nearest samples over which α is averaged.",
    "γ": (
        "Exponent of the weight β = (mean of the K nearest α / ᾱ)^γ of a feature; with 0, all weigh"
        " alike."
    ),
    "Average of α": "Kind of mean of the K nearest α, and of all of them, ᾱ.",
    "Scaled noise": "The static noise that β multiplies.",
}


def sections(subject: Subject) -> Findings:
    """Show what a PROBE model has learned and, of a frame, the weights of its features."""
    view = ModelView.of(subject.name, subject.model, subject.units)
    frame = subject.frame
    frame_part = None
    if frame is not None:
        weights = FrameWeights.of(view.model, frame.phi)
        pictures = frame_pictures(view, frame, weights)
        with figure_style():
            frame_part = FramePart(frame, pictures, _frame_panels(view, weights))
    with figure_style():
        page = ModelPage(
            learned=_learned_sections(view, frame),
            table=column_table(_column_summaries(view, frame)),
            samples="the training samples",
            frame_part=frame_part,
            origin=_origin_sections(view, frame),
        )
    return page.findings(_facts(view), _TERMS)


def summary(model: NearestNeighbors) -> TrainingSummary:
    """Summarise what was learned, and how K and γ were chosen."""
    facts = {
        "samples": f"{len(model.index_.values):,} from {origin(model.training)}",
        "predictors": ", ".join(model.columns),
        "K": f"{model.neighbors}",
        "γ": f"{model.exponent:g}",
    }
    iterations = model.training["settings"].get("iterations")
    if iterations is not None:
        facts["kept"] = f"the samples of all {iterations} iterations, each of other subsets"
    paragraphs = []
    for name, search in model.training["searches"].items():
        searched = SEARCHED[name]
        candidates = [f"{candidate:g}" for candidate in search["candidates"]]
        errors = [f"{searched.unit_factor * error:.4g}" for error in search["errors"]]
        rows = [(searched.errors, *errors)]
        paragraphs.append(text_table((searched.symbol, *candidates), rows).as_text())
    if model.exponent == 0.0:
        remark = (
            "γ is 0: nothing shows that any feature is better than another; the model is the static"
            " one."
        )
        if model.training["settings"]["supervision"] in ("gt", "sparse"):
            remark += "\nA truth that jumps from frame to frame hides it: try --supervision none."
        paragraphs.append(remark)
    return TrainingSummary(facts, tuple(paragraphs))


def frame_pictures(view: ModelView, frame: FrameView, weights: FrameWeights) -> dict[str, Picture]:
    """Draw the weight, the distance from the training data, and each column of φ of the features.

    The columns come in the order in which α varies with them; the distance is in units of the
    median one of the training samples.
    """
    far = int(np.sum(weights.radius > view.far_radius))
    relative = weights.radius / max(float(np.median(view.radius)), 1e-9)
    shades: dict[str, tuple[str, Shades]] = {
        "weight": ("Weight", weight_shades(weights.beta)),
        "distance": (
            f"Distance from the training data: {far} of {len(relative)} features are far",
            value_shades("distance to the K-th nearest training sample", "1 is usual", relative),
        ),
    }
    for m in view.order:
        shades[view.columns[m]] = column_shades(frame, view.columns[m])
    return drawn(frame, shades)


def _column_summaries(view: ModelView, frame: FrameView | None) -> list[ColumnSummary]:
    metric = view.model.metric_
    units = {name: view.units.get(name, "") for name in view.columns}
    return column_summaries(
        frame.columns if frame is not None else units,
        frame.phi if frame is not None else view.points,
        (metric.mean, metric.spread),
        is_of_frame=frame is not None,
    )


def _facts(view: ModelView) -> dict[str, str]:
    model = view.model
    source = origin(model.training)
    return {
        "Samples": f"{len(view.log_alpha):,}" + (f" from {source}" if source else ""),
        "K": f"{model.neighbors}",
        "γ": f"{model.exponent:g}",
        "Average of α": model.average,
        "Scaled noise": str(model.to_file().facts["base"]["name"]),
    }


def _frame_panels(view: ModelView, weights: FrameWeights) -> list[Markup]:
    """Show where the frame lies among the training data."""
    weights_note = (
        "β = (mean of the K nearest α / ᾱ)^γ scales the noise of a feature. Here from"
        f" {_range(weights.beta)}; over the training samples from {_range(view.beta)} (5 to 95 %)."
    )
    far = float(np.mean(weights.radius > view.far_radius))
    distances_note = (
        "From each feature to the K-th nearest training sample, over standardised columns."
        f" {percent(far)} are far: farther than 99 % of the training samples are from theirs."
        " There, weights are guesses."
    )
    return [
        panel("Weights in this frame", weights_note, weights_figure(view, weights.beta)),
        panel(
            "Distance from the training data",
            distances_note,
            distances_figure(view, weights.radius),
        ),
    ]


def _range(beta: FloatArray) -> str:
    low, high = np.quantile(beta, [0.05, 0.95]).tolist()
    return f"{readable(low)} to {readable(high)}"


def _learned_sections(view: ModelView, frame: FrameView | None) -> list[Markup]:
    """Show how α varies along each column."""
    settings = view.model.training.get("settings", {})
    note = (
        "By how strongly α varies with each, the strongest first. Above: mean ln(α/ᾱ) of the"
        " training samples in bins of equally many, and two standard errors, for which samples that"
        " share a subset count as one; all on the same scale. A sample’s α is that of a whole"
        " subset, which dilutes what the one feature does to it."
    )
    if settings.get("relative"):
        note += _IF_RELATIVE
    note += " Below: where the training samples lie (grey)"
    if frame is not None:
        note += " and the features of this frame (orange)"
    note += "; the outermost half percent, and all beyond, is in the outermost bins."
    if settings.get("contrast"):
        note += _IF_CONTRAST
    note += " What is undefined stands apart at the left; its bar may be cut off."
    profiles = [_profile_panel(view, m, frame) for m in view.order]
    return [
        heading("What the model learned", view.name if frame is not None else ""),
        rendered("column_cards", note=note, panels=profiles),
    ]


def _origin_sections(view: ModelView, frame: FrameView | None) -> list[Markup]:
    """Show how the model was trained, and where its data lies."""
    training = view.model.training
    origins = []
    searches = training.get("searches", {})
    if searches:
        searches_note = (
            "By cross-validation over blocks of time (K), and by the motion’s error with each (γ);"
            " lower is better."
        )
        origins.append(panel("How K and γ were chosen", searches_note, searches_figure(searches)))
    origins.append(training_section(training))
    correlation_note = (
        "Spearman’s, over the training samples; the strongest column first. Columns alike tell the"
        " same twice."
    )
    correlation = correlation_figure(view)
    origins.append(panel("Correlation of the columns", correlation_note, correlation))
    shown = [heading(HOW_IT_WAS_TRAINED), grid(origins)]
    if len(view.columns) > 1:
        pairs_note = "Blue: density of the training samples."
        if frame is not None:
            pairs_note += " Orange: the frame’s features."
        title = "Where the data lies, over the most telling columns"
        figures = pairs_figures(view, frame)
        shown.append(row_panel(title, pairs_note, figures, name="pairs", style="narrow"))
    shown.append(settings_section(training))
    return shown


def _profile_panel(view: ModelView, m: int, frame: FrameView | None) -> Markup:
    profile = view.profiles[m]
    note = f"{percent(profile.share_explained)} of the variance of ln α"
    if profile.share_undefined > 0.0:
        note += f"; {percent(profile.share_undefined)} undefined"
    return panel(view.columns[m], note, profile_figure(view, m, frame), name=f"profile-{m}")
