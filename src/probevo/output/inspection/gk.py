"""The page on a PROBE-GK model, and on the features of a frame as it sees them."""

from __future__ import annotations

import numpy as np
from markupsafe import Markup

from probevo.noise.base import StereoNoise
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.output.inspection.common_sections import (
    HOW_IT_WAS_TRAINED,
    FramePart,
    ModelPage,
    percent,
    settings_section,
    training_section,
)
from probevo.output.inspection.feature_pictures import Shades, value_shades
from probevo.output.inspection.gk_data import (
    CentersView,
    gained,
    share_out_of_domain,
    size_px,
    used_columns,
)
from probevo.output.inspection.gk_plots import (
    centers_figures,
    course_figure,
    gains_figure,
    histogram_figure,
)
from probevo.output.inspection.predictors import (
    ColumnSummary,
    column_shades,
    column_table,
    drawn,
)
from probevo.output.inspection.profiles import profile_along
from probevo.output.inspection.subject import (
    Findings,
    FrameView,
    Picture,
    Subject,
    TrainingSummary,
)
from probevo.output.inspection.training_facts import (
    em_figure,
    em_note,
    em_table,
    kept_text,
    learned_jitter_text,
    noise_of_text,
    origin,
    scale_table,
    signed,
    time_correlation_text,
)
from probevo.output.page import grid, heading, panel, row_panel, table_panel
from probevo.output.svg import figure_style
from probevo.output.table import UNKNOWN_TEXT, Column, Table, readable, text_table
from probevo.output.templating import rendered

_OUT_OF_DOMAIN_REMARK = (
    "Magenta rings: out of domain, beyond the reach of all training data; there, the prior holds."
)

_TERMS = {
    "Samples": "Errors of features to which the model was fitted.",
    "Form": "The posterior as published, an inverse Wishart.",
    "K": "Number of nearest samples to which the noise at a point is fitted.",
    "ρ": (
        "Reach: samples farther away do not contribute. Distances are in standard deviations of the"
        " weighted predictors."
    ),
    "Centers": "Places at which the fitted noise is stored; a run interpolates between them.",
    "ν of the prior": (
        "Degrees of freedom of the Student-t where no sample is near: the fewer, the more outliers."
    ),
    "Gain over the static model": (
        "By how much the mean log-likelihood of a feature’s error exceeds that of one Student-t for"
        " all features, on blocks of time that were left out. A nat is its unit: 0.1 nats make each"
        " error 1.1 times as likely."
    ),
}


def sections(subject: Subject) -> Findings:
    """Show what a PROBE-GK model has learned and, of a frame, the noise of its features."""
    view = CentersView.of(subject.name, subject.model, subject.units)
    frame = subject.frame
    facts = _facts(view)
    text_below = ""
    frame_part = None
    if frame is not None:
        noise = view.model.predict(frame.phi)
        share_outside = percent(share_out_of_domain(noise))
        facts = {"Out of domain": share_outside} | facts
        text_below = f"\n\nout of domain: {share_outside} of the features"
        pictures = frame_pictures(view, frame, noise)
        with figure_style():
            panels = _frame_panels(view, noise)
        frame_part = FramePart(frame, pictures, panels, _OUT_OF_DOMAIN_REMARK)
    with figure_style():
        page = ModelPage(
            learned=_learned_sections(view, frame),
            table=weighted_table(view, frame),
            samples="the centers",
            frame_part=frame_part,
            origin=_origin_sections(view, frame),
        )
    return page.findings(facts, _TERMS, text_below)


def summary(model: GeneralizedKernel) -> TrainingSummary:
    """Summarise what was learned, what each predictor adds, and the EM iterations."""
    used = used_columns(model)
    shape = model.shape_
    searches = model.training["searches"]
    used_names = [column.name for column in used]
    unused_names = [name for name in model.columns if name not in used_names]
    facts = {
        "samples": f"{model.num_samples_:,} from {origin(model.training)}",
        "predictors": ", ".join(used_names),
    }
    if unused_names:
        facts["not used"] = ", ".join(unused_names)
    if model.variant == "robust":
        facts["K"] = f"{shape.neighbors}"
    else:
        facts["K"] = f"all within ρ = {shape.reach:.3g}"
    facts["ν"] = (
        f"{float(model.prior_.dof[0]):.3g} of the prior, which counts as much as"
        f" {shape.prior_counts:g} measured errors"
    )
    facts["correlated"] = f"in time: {time_correlation_text(model.time_correlation_ratio_)}"
    facts["rig"] = learned_jitter_text(model.jitter_cov)
    gain = gained(searches)
    if gain is not None:
        facts["gain"] = (
            f"{signed(gain)} nats a feature over the static model, on blocks of time left out"
        )

    kept = kept_text(model.training)
    if kept:
        facts["kept"] = kept
    paragraphs = []
    if any(column.gain is not None for column in used):
        gains = [(column.name, f"{column.weight:g}", signed(column.gain)) for column in used]
        head = ("predictor", "weight", "gain, nats a feature")
        paragraphs.append(text_table(head, gains).as_text())
    if "weights" in searches and not searches["weights"]["candidates"]:
        paragraphs.append(
            "No predictor shows which feature is better than another: all are taken, alike."
        )
    iterations = em_table(
        model.training["iterations"],
        "the static model",
        kept=model.training.get("kept_iteration"),
    )
    paragraphs.append("\n".join([iterations.as_text(), *iterations.notes]))
    return TrainingSummary(facts, tuple(paragraphs))


def frame_pictures(view: CentersView, frame: FrameView, noise: StereoNoise) -> dict[str, Picture]:
    """Draw the σ, the ν, and the used columns of φ of the features, in the order of their gain.

    Features out of the model's domain are marked in all of the pictures.
    """
    shades: dict[str, tuple[str, Shades]] = {
        "sigma": (
            "σ, as predicted",
            value_shades(
                "σ, geometric mean, logarithmic", "px", size_px(noise.scale), logarithmic=True
            ),
        ),
        "dof": (
            "ν, as predicted: small where outliers are to be expected",
            value_shades("ν, degrees of freedom, logarithmic", "", noise.dof, logarithmic=True),
        ),
    }
    for column in view.used:
        shades[column.name] = column_shades(frame, column.name)
    return drawn(frame, shades, noise.out_of_domain)


def weighted_table(view: CentersView, frame: FrameView | None) -> Table:
    """Make a table with a row for each column of φ, the used ones first, with weight and gain.

    Of the others, the file of a model holds no points.
    """
    metric = view.model.metric_
    used = {column.index: column for column in view.used}
    column_of = {column.index: k for k, column in enumerate(view.used)}
    others = [m for m in range(len(metric.columns)) if m not in used]
    summaries = []
    for m in (*used, *others):
        if frame is not None:
            values = frame.phi[:, m]
        elif m in used:
            values = view.points[:, column_of[m]]
        else:
            values = np.zeros(0)
        known = values[np.isfinite(values)]
        name = metric.columns[m]
        summaries.append(
            ColumnSummary(
                name=name,
                unit=view.units.get(name, ""),
                training=(float(metric.mean[m]), float(metric.spread[m])),
                frame_mean=float(known.mean()) if frame is not None and len(known) else None,
                undefined=float(np.isnan(values).mean()) if len(values) else 0.0,
            )
        )
    unknown = [None] * len(others)
    return column_table(
        summaries,
        {
            Column("weight", format=_weight_text): [
                *(column.weight for column in view.used),
                *unknown,
            ],
            Column("gain", format=signed): [*(column.gain for column in view.used), *unknown],
        },
    )


def _weight_text(weight: float | None) -> str:
    return UNKNOWN_TEXT if weight is None else f"{weight:g}"


def _facts(view: CentersView) -> dict[str, str]:
    model = view.model
    shape = model.shape_
    source = origin(model.training)
    facts = {"Samples": f"{model.num_samples_:,}" + (f" from {source}" if source else "")}
    if model.variant == "published":
        facts["Form"] = model.variant
    else:
        facts["K"] = f"{shape.neighbors:,}"
    facts["ρ"] = f"{readable(shape.reach)} standard deviations"
    facts["Centers"] = f"{len(view.points):,}"
    facts["Time-correlated error"] = time_correlation_text(model.time_correlation_ratio_)
    facts["Rig"] = learned_jitter_text(model.jitter_cov)
    facts["ν of the prior"] = readable(float(model.prior_.dof[0]))
    facts["Noise of"] = noise_of_text(model.refers_to)
    gain = gained(model.training.get("searches", {}))
    if gain is not None:
        facts["Gain over the static model"] = f"{signed(gain)} nats a feature"
    return facts


def _frame_panels(view: CentersView, noise: StereoNoise) -> list[Markup]:
    """Show the predicted noise of a frame beside that of the training data."""
    prior = view.model.prior_
    note = (
        "Training samples: as predicted at the centers. Dashed: the prior, which holds where"
        " nothing is known."
    )
    sigma = histogram_figure(
        size_px(view.noise.scale),
        size_px(noise.scale),
        "σ, geometric mean, px",
        prior=float(size_px(prior.scale)[0]),
    )
    sigma_note = (
        f"{percent(share_out_of_domain(noise))} of the features are out of domain, beyond the reach"
        f" of all training data. {note}"
    )
    dof = histogram_figure(
        view.noise.dof, noise.dof, "ν: heavy tails < light tails", prior=float(prior.dof[0])
    )
    return [
        panel("Predicted σ in this frame", sigma_note, sigma),
        panel("Predicted ν in this frame", note, dof),
    ]


def _learned_sections(view: CentersView, frame: FrameView | None) -> list[Markup]:
    """Show the noise along each used column."""
    note = (
        f"The noise predicted at the {len(view.points):,} centers, which are points of training"
        " samples: medians, and 16 to 84 %, in bins of equally many along each used predictor; all"
        " on the same scales. Other predictors vary along with it. σ is the scale of the"
        " Student-t, which its few outliers do not move. Below: where the centers lie (grey)"
    )
    if frame is not None:
        note += " and the features of this frame (orange)"
    note += ". What is undefined stands apart at the left."
    courses = [_course_panel(view, k, frame) for k in range(len(view.used))]
    return [
        heading("What the model learned", view.name if frame is not None else ""),
        rendered("column_cards", note=note, panels=courses),
    ]


def _origin_sections(view: CentersView, frame: FrameView | None) -> list[Markup]:
    """Show how the model was trained, and where its centers lie."""
    shown = [heading(HOW_IT_WAS_TRAINED), grid(_origin_panels(view))]
    if len(view.used) > 1:
        centers_note = "In the colour of their σ."
        if frame is not None:
            centers_note += " Orange rings: the frame’s features."
        title = "Where the centers lie, over the most telling predictors"
        figures = centers_figures(view, frame)
        shown.append(row_panel(title, centers_note, figures, name="centers", style="narrow"))
    shown.append(settings_section(view.model.training))
    return shown


def _course_panel(view: CentersView, k: int, frame: FrameView | None) -> Markup:
    column = view.used[k]
    share = profile_along(view.points[:, k], np.log(size_px(view.noise.scale))).share_explained
    note = f"weight {column.weight:g}; "
    if column.gain is not None:
        note += f"{signed(column.gain)} nats; "
    note += f"explains {percent(share)} of the variance of ln σ"
    return panel(column.name, note, course_figure(view, k, frame), name=f"course-{k}")


def _origin_panels(view: CentersView) -> list[Markup]:
    """Show how the model was trained, and the prior that it falls back on."""
    model = view.model
    training = model.training
    panels = []
    iterations = training.get("iterations", [])
    if iterations:
        note = em_note(training, "the static model")
        panels.append(panel("EM iterations", note, em_figure(iterations)))
    prior_note = (
        f"What holds where no sample is near: ν = {readable(float(model.prior_.dof[0]))}, and the"
        " scale matrix as σ and correlations. Elsewhere, it counts as much as"
        f" {model.shape_.prior_counts:g} of the errors."
    )
    panels.append(table_panel("The prior", [prior_note], scale_table(model.prior_.scale[0])))
    panels.append(training_section(training))
    searches = training.get("searches", {})
    if any(search["gains"] for search in searches.values()):
        gains_note = (
            "Likelihood of blocks of time left out, over that of the static model, nats a feature;"
            " higher is better. Predictors are added one by one, each the best beside those before."
            " Counts: how many errors a prior counts for; many hold it fast."
        )
        chosen = searches.get("neighbors", {}).get("chosen", model.shape_.neighbors)
        if chosen != model.shape_.neighbors:
            gains_note += f" With all of the samples, K becomes {model.shape_.neighbors:,}."
        panels.append(panel("How it was chosen", gains_note, gains_figure(searches)))
    return panels
