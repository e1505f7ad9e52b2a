"""The page on a static Student-t: one scale matrix for all features, whatever the frame."""

from __future__ import annotations

from markupsafe import Markup

from probevo.noise.student_t import StudentT
from probevo.output.inspection import predictors
from probevo.output.inspection.common_sections import settings_section, training_section
from probevo.output.inspection.subject import Findings, Picture, Subject, TrainingSummary
from probevo.output.inspection.training_facts import (
    em_figure,
    em_note,
    em_table,
    kept_text,
    learned_jitter_text,
    noise_of_text,
    origin,
    scale_table,
    sizes_text,
    time_correlation_text,
)
from probevo.output.page import grid, panel, table_panel
from probevo.output.svg import figure_style
from probevo.output.table import readable

_FRAME_REMARK = "To this model, all features are alike: it looks at none of these."


def sections(subject: Subject) -> Findings:
    """Show the scale matrix and how it was trained.

    Of a frame, its predictors are shown, too, although the model takes none.
    """
    model: StudentT = subject.model
    training = model.training
    pictures: dict[str, Picture] = {}
    shown: list[Markup] = []
    scale = scale_table(model.scale_)
    panels = [
        table_panel("The scale matrix", [f"As σ and correlations. {_spread_note(model)}"], scale)
    ]
    if training.get("iterations"):
        note = em_note(training, "a model that was not trained")
        with figure_style():
            panels.append(panel("EM iterations", note, em_figure(training["iterations"])))
    panels.append(training_section(training))
    shown.append(grid(panels))
    if subject.frame is not None:
        frame_findings = predictors.sections(subject, _FRAME_REMARK)
        pictures = dict(frame_findings.pictures)
        shown += frame_findings.sections
    shown.append(settings_section(training))
    facts = {
        "Trained on": origin(training) or "not known",
        "ν": readable(model.dof_),
        "Time-correlated error": time_correlation_text(model.time_correlation_ratio_),
        "Rig": learned_jitter_text(model.jitter_cov),
        "Noise of": noise_of_text(model.refers_to),
    }
    sizes = sizes_text(training)
    if sizes:
        facts["Errors"] = sizes
    return Findings(
        sections=tuple(shown),
        text=f"{scale.as_text()}\nν = {model.dof_:.3g}",
        notes=(
            "u_l, v_l, u_r, v_r: column and row of a feature in the left and in the right image.",
            f"σ, correlation: of the scale matrix. {_spread_note(model)}",
            "ν: degrees of freedom of the Student-t; the fewer, the more outliers.",
        ),
        facts=facts,
        pictures=pictures,
    )


def summary(model: StudentT) -> TrainingSummary:
    """Summarise the scale matrix that was learned, and the EM iterations."""
    training = model.training
    iterations = em_table(
        training["iterations"], "not trained", kept=training.get("kept_iteration")
    )
    facts = {
        "trained on": origin(training),
        "ν": f"{model.dof_:.3g}",
        "correlated": f"in time: {time_correlation_text(model.time_correlation_ratio_)}",
        "rig": learned_jitter_text(model.jitter_cov),
    }
    sizes = sizes_text(training)
    if sizes:
        facts["errors"] = sizes
    kept = kept_text(training)
    if kept:
        facts["kept"] = kept
    return TrainingSummary(
        facts=facts,
        paragraphs=(
            scale_table(model.scale_).as_text(),
            "\n".join([iterations.as_text(), *iterations.notes]),
        ),
    )


def _spread_note(model: StudentT) -> str:
    """Say how σ relates to the standard deviation, which is √(ν/(ν − 2)) σ for ν > 2."""
    if model.dof_ <= 2.0:
        return (
            f"With ν = {readable(model.dof_)}, errors have no finite standard deviation:"
            " outliers are many."
        )
    factor = (model.dof_ / (model.dof_ - 2.0)) ** 0.5
    return f"The standard deviation of errors, outliers included, is {readable(factor)} times σ."
