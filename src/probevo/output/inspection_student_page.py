"""One self-contained page on a static Student-t: one scale matrix for all features, whatever the
frame."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from probevo.noise.student_t import StudentT
from probevo.output.inspection_data import ColumnSummary, FrameView
from probevo.output.inspection_kernel_plots import turns_figure
from probevo.output.inspection_sections import (
    frame_facts,
    origin,
    page_title,
    pictures_section,
    settings_section,
    summary_section,
    table_section,
    training_section,
)
from probevo.output.metrics_table import readable
from probevo.output.model_facts import END_ERROR, SCALE_HEAD, lasting_text, scale_rows
from probevo.output.page import grid, panel, write_page
from probevo.output.svg import figure_style


def write_student_inspection(
    path: Path,
    name: str,
    model: StudentT,
    frame: FrameView | None,
    pictures: Mapping[str, tuple[str, bytes]],
    summaries: Sequence[ColumnSummary],
) -> None:
    """Write the page. The same arguments give the same bytes.

    Args:
        path: the HTML file.
        name: of the model.
        model: the model.
        frame: left out, only the model is shown; else its predictors, of which the model takes
            none.
        pictures: caption and JPEG file of the frame with its features in different colours, by the
            name of the column.
        summaries: figures of each column.

    Raises:
        InputError: the file cannot be written.
    """
    training = model.training
    sections = []
    if frame is not None:
        more = " To this model, all features are alike: it looks at none of these."
        sections = [
            pictures_section(frame, pictures, more),
            summary_section(summaries, trained=False, has_frame=True),
        ]
    source = origin(training).removeprefix(" from ") or "not known"
    facts = frame_facts(frame) | {"Trained on": source, "ν": readable(model.dof_)}
    facts["What lasts"] = lasting_text(model)
    facts["Noise of"] = (
        "single observations" if model.refers_to == "observation" else "residuals as a whole"
    )
    panels = [
        table_section("The scale matrix", _spread(model), SCALE_HEAD, rows=scale_rows(model.scale_))
    ]
    with figure_style():
        if training.get("iterations"):
            note = f"Turn 0 has the noise of a model that was not trained. {END_ERROR}"
            panels.append(panel("Learning by turns", note, turns_figure(training["iterations"])))
        panels.append(training_section(training))
        sections += [grid(panels), settings_section(training)]
    write_page(path, page_title(name, frame), facts, sections=sections)


def _spread(model: StudentT) -> str:
    """What σ is, beside the standard deviation."""
    said = "As σ and correlations. "
    if model.dof_ <= 2.0:
        return (
            said
            + f"With ν = {readable(model.dof_)}, errors have no finite standard deviation: outliers"
            " are many."
        )
    factor = (model.dof_ / (model.dof_ - 2.0)) ** 0.5
    return (
        said
        + f"The standard deviation of errors, outliers included, is {readable(factor)} times σ."
    )
