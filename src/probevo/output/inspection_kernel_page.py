"""One self-contained page on a generalized kernel, and on the features of a frame as it sees them."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from pathlib import Path

import numpy as np

from probevo.output.inspection_data import FrameView
from probevo.output.inspection_kernel_data import KernelView, size_px
from probevo.output.inspection_kernel_plots import (
    centers_figure,
    course_figure,
    gains_figure,
    histogram_figure,
    turns_figure,
)
from probevo.output.inspection_sections import (
    CARDS,
    frame_facts,
    named_with_unit,
    origin,
    page_title,
    percent,
    pictures_section,
    settings_section,
    table_section,
    training_section,
)
from probevo.output.metrics_table import readable
from probevo.output.model_facts import (
    END_ERROR,
    SCALE_HEAD,
    gained,
    lasting_text,
    scale_rows,
    signed,
)
from probevo.output.page import grid, panel, write_page
from probevo.output.profiles import profile_along
from probevo.output.svg import figure_style

KERNEL_HEAD = ("column", "unit", "weight", "gain", "training", "this frame", "undefined")


def write_kernel_inspection(
    path: Path, view: KernelView, frame: FrameView | None, pictures: Mapping[str, tuple[str, bytes]]
) -> None:
    """Write the page. The same arguments give the same bytes.

    Args:
        path: the HTML file.
        view: the model.
        frame: left out, only the model is shown.
        pictures: caption and JPEG file of the frame with its features in different colours, by
            name.

    Raises:
        InputError: the file cannot be written.
    """
    more = (
        " Magenta rings: out of domain, beyond the reach of all training data; there, the prior"
        " holds."
    )
    sections = [] if frame is None else [pictures_section(frame, pictures, more)]
    with figure_style():
        if frame is not None:
            sections.append(grid(_frame_panels(view, frame)))
        sections += [_columns_section(view, frame), *_model_sections(view, frame)]
    write_page(path, page_title(view.name, frame), _facts(view, frame), sections=sections)


def kernel_rows(view: KernelView, frame: FrameView | None) -> list[tuple[str, ...]]:
    """A row for each column under ``KERNEL_HEAD``, the used ones first; of the others the file
    holds no places."""
    metric = view.model.metric_
    used = {column.index: column for column in view.used}
    number = {column.index: k for k, column in enumerate(view.used)}
    rows: list[tuple[str, ...]] = []
    for m in [*used, *(m for m in range(len(metric.columns)) if m not in used)]:
        values = (
            frame.phi[:, m]
            if frame is not None
            else view.places[:, number[m]]
            if m in used
            else np.zeros(0)
        )
        known = values[np.isfinite(values)]
        undefined = float(np.isnan(values).mean()) if len(values) else 0.0
        rows.append(
            (
                metric.columns[m],
                view.units.get(metric.columns[m], ""),
                f"{used[m].weight:g}" if m in used else "–",
                signed(used[m].gain) if m in used else "–",
                f"{readable(float(metric.mean[m]))} ± {readable(float(metric.spread[m]))}",
                readable(float(known.mean())) if frame is not None and len(known) else "–",
                percent(undefined) if undefined > 0.0 else "–",
            )
        )
    return rows


def share_out_of_domain(frame: FrameView) -> float:
    """Share of the features that lie out of the model's domain."""
    out_of_domain = None if frame.noise is None else frame.noise.out_of_domain
    return 0.0 if out_of_domain is None or not len(out_of_domain) else float(out_of_domain.mean())


def _facts(view: KernelView, frame: FrameView | None) -> dict[str, str]:
    model = view.model
    facts = frame_facts(frame)
    if frame is not None:
        facts["Out of domain"] = percent(share_out_of_domain(frame))
    shape = model.shape_
    gain = gained(model.training.get("searches", {}))
    facts["Samples"] = f"{model.samples_:,}{origin(model.training)}"
    facts |= (
        {"Form": model.variant} if model.variant == "published" else {"K": f"{shape.neighbors:,}"}
    )
    facts |= {
        "ρ": f"{readable(shape.reach)} standard deviations",
        "Centers": f"{len(view.places):,}",
    }
    facts["What lasts"] = lasting_text(model)
    facts["ν of the prior"] = readable(float(model.prior_.dof[0]))
    facts["Noise of"] = (
        "single observations" if model.refers_to == "observation" else "residuals as a whole"
    )
    return facts | (
        {"Gain over the static model": f"{signed(gain)} nats a feature"} if gain is not None else {}
    )


def _frame_panels(view: KernelView, frame: FrameView) -> list[str]:
    if frame.noise is None:
        return []
    note = (
        "Training samples: as predicted at the centers. Dashed: the prior, which holds where"
        " nothing is known."
    )
    prior = view.model.prior_
    out_of_domain = percent(share_out_of_domain(frame))
    sizes = size_px(view.noise.scale), size_px(frame.noise.scale)
    scale_note = (
        f"{out_of_domain} of the features are out of domain, beyond the reach of all training data."
        f" {note}"
    )
    sigma = histogram_figure(*sizes, "σ, geometric mean, px", float(size_px(prior.scale)[0]))
    dof = histogram_figure(
        view.noise.dof, frame.noise.dof, "ν: heavy tails < light tails", prior=float(prior.dof[0])
    )
    return [
        panel("Predicted σ in this frame", scale_note, sigma),
        panel("Predicted ν in this frame", note, dof),
    ]


def _columns_section(view: KernelView, frame: FrameView | None) -> str:
    head = [
        name
        for name in KERNEL_HEAD
        if name != "unit" and (frame is not None or name != "this frame")
    ]
    rows = []
    for name, unit, *cells in kernel_rows(view, frame):
        shown = dict(zip(KERNEL_HEAD[2:], cells, strict=True))
        rows.append((named_with_unit(name, unit), *(shown[title] for title in head[1:])))
    whose = "the frame’s features" if frame is not None else "the centers"
    note = (
        "Weight: how much a standard deviation counts in the distance; a column without one is not"
        " used. Gain: nats a feature that it adds to the likelihood of blocks of time left out,"
        " beside those above. Training: mean ± standard deviation of all features. Undefined:"
        f" share of {whose}."
    )
    return table_section("The predictors in figures", note, head, rows=rows)


def _model_sections(view: KernelView, frame: FrameView | None) -> list[str]:
    aside = f"<small>{escape(view.name)}</small>" if frame is not None else ""
    heading = f'<h2 class="sequence">What the model learned{aside}</h2>'
    note = (
        f"The noise predicted at the {len(view.places):,} centers, which are places of training"
        " samples: medians, and 16 to 84 %, in bins of equally many along each used predictor; all"
        " on the same scales. Other predictors vary along with it. σ is the scale of the"
        " Student-t, which its few outliers do not move. Below: where the centers lie (grey)"
        + " and the features of this frame (orange)" * (frame is not None)
        + ". What is undefined stands apart at the left."
    )
    cards = "\n".join(_course_panel(view, k, frame) for k in range(len(view.used)))
    courses = f'<p class="note">{note}</p>\n{CARDS}\n{cards}\n</div>'
    sections = [heading, courses, grid(_origin_panels(view))]
    if len(view.used) > 1:
        note = "In the colour of their σ." + " Orange rings: the frame’s features." * (
            frame is not None
        )
        title = "Where the centers lie, over the most telling predictors"
        sections.append(panel(title, note, centers_figure(view, frame), name="centers"))
    return [*sections, settings_section(view.model.training)]


def _course_panel(view: KernelView, k: int, frame: FrameView | None) -> str:
    column = view.used[k]
    share = profile_along(view.places[:, k], np.log(size_px(view.noise.scale))).share_explained
    note = f"weight {column.weight:g}; " + (
        f"{signed(column.gain)} nats; " if column.gain is not None else ""
    )
    note += f"tells {percent(share)} of the variance of ln σ"
    return panel(escape(column.name), note, course_figure(view, k, frame), name=f"course-{k}")


def _origin_panels(view: KernelView) -> list[str]:
    """How the model came about, and what it falls back on."""
    training = view.model.training
    model = view.model
    panels = []
    turns = training.get("iterations", [])
    if turns:
        note = f"Turn 0 has the noise of the static model. {END_ERROR}"
        panels.append(panel("Learning by turns", note, turns_figure(turns)))
    searches = training.get("searches", {})
    if any(search["gains"] for search in searches.values()):
        note = (
            "Likelihood of blocks of time left out, over that of the static model, nats a feature;"
            " higher is better. Predictors are added one by one, each the best beside those before."
            " Counts: how many errors a belief counts for; many hold it fast."
        )
        chosen = searches.get("neighbors", {}).get("chosen", model.shape_.neighbors)
        if chosen != model.shape_.neighbors:
            note += f" With all of the samples, K becomes {model.shape_.neighbors:,}."
        panels.append(panel("How it was chosen", note, gains_figure(searches)))
    prior_note = (
        f"What holds where no sample is near: ν = {readable(float(model.prior_.dof[0]))}, and the"
        " scale matrix as σ and correlations. Elsewhere, it counts as much as"
        f" {model.shape_.prior_counts:g} of the errors."
    )
    panels.append(
        table_section("The prior", prior_note, SCALE_HEAD, rows=scale_rows(model.prior_.scale[0]))
    )
    return [*panels, training_section(training)]
