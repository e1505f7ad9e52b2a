"""What ``probevo train`` says of the model that it has learned."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from probevo.cli.text import columns, table

if TYPE_CHECKING:
    from probevo.noise.gk.generalized_kernel import GeneralizedKernel
    from probevo.noise.model_io import Learned
    from probevo.noise.probe.nearest_neighbors import NearestNeighbors
    from probevo.noise.student_t import StudentT


def summary(model: Learned, out: Path) -> list[str]:
    """A few lines on what was learned, and how what was not given came about."""
    from probevo.noise.gk.generalized_kernel import GeneralizedKernel
    from probevo.noise.student_t import StudentT

    if isinstance(model, GeneralizedKernel):
        lines = _of_kernel(model)
    elif isinstance(model, StudentT):
        lines = _of_student_t(model)
    else:
        lines = _of_neighbors(model)
    return [*lines, "", f"model: {out}"]


def _source(model: Learned) -> str:
    recordings = model.training["recordings"]
    frames = sum(recording["frames"] for recording in recordings)
    return f"{frames:,} frames of {len(recordings)} recordings"


def _of_neighbors(model: NearestNeighbors) -> list[str]:
    rows = [
        ("samples", f"{len(model.index_.values):,} from {_source(model)}"),
        ("predictors", ", ".join(model.columns)),
        ("K", f"{model.neighbors}"),
        ("γ", f"{model.exponent:g}"),
    ]
    lines = [columns(rows)]
    titles = {
        "neighbors": ("K", "squared error of left-out samples", 1.0),
        "exponent": ("γ", "mean error on the training drives, mm", 1e3),
    }
    for name, search in model.training["searches"].items():
        title, meaning, factor = titles[name]
        errors = [f"{factor * error:.4g}" for error in search["errors"]]
        lines += [
            "",
            table((title, *(f"{c:g}" for c in search["candidates"])), [(meaning, *errors)]),
        ]
    if model.exponent == 0.0:
        lines += [
            "",
            (
                "γ is 0: nothing shows that any feature is better than another; the model is the"
                " static one."
            ),
        ]
        if model.training["settings"]["supervision"] in ("gt", "sparse"):
            lines += ["A truth that jumps from frame to frame hides it: try --supervision none."]
    return lines


def _of_kernel(model: GeneralizedKernel) -> list[str]:
    from probevo.output.model_facts import gained, lasting_text, signed, used_columns

    used = used_columns(model)
    searches = model.training["searches"]
    shape = model.shape_
    unused = [name for name in model.columns if name not in {column.name for column in used}]
    rows = [
        ("samples", f"{model.samples_:,} from {_source(model)}"),
        ("predictors", ", ".join(column.name for column in used)),
        *([("not used", ", ".join(unused))] if unused else []),
        (
            "K",
            (
                f"{shape.neighbors}"
                if model.variant == "robust"
                else f"all within ρ = {shape.reach:.3g}"
            ),
        ),
        (
            "ν",
            (
                f"{float(model.prior_.dof[0]):.3g} of the prior, which has the weight of"
                f" {shape.prior_counts:g} errors"
            ),
        ),
        ("what lasts", lasting_text(model)),
    ]
    gain = gained(searches)
    if gain is not None:
        rows.append(
            (
                "gain",
                f"{signed(gain)} nats a feature over the static model, on blocks of time left out",
            )
        )
    lines = [columns(rows)]
    if any(column.gain is not None for column in used):
        gains = [(column.name, f"{column.weight:g}", signed(column.gain)) for column in used]
        lines += ["", table(("predictor", "weight", "gain, nats a feature"), gains)]
    if "weights" in searches and not searches["weights"]["candidates"]:
        lines += [
            "",
            "No predictor shows which feature is better than another: all are taken, alike.",
        ]
    return [*lines, *_turns(model, "the static model")]


def _of_student_t(model: StudentT) -> list[str]:
    from probevo.output.model_facts import SCALE_HEAD, lasting_text, scale_rows

    rows = [
        ("trained on", _source(model)),
        ("ν", f"{model.dof_:.3g}"),
        ("what lasts", lasting_text(model)),
    ]
    scale = table(SCALE_HEAD, scale_rows(model.scale_))
    return [columns(rows), "", scale, *_turns(model, "not trained")]


def _turns(model: GeneralizedKernel | StudentT, first: str) -> list[str]:
    """How well each turn of EM explains the drives."""
    from probevo.output.model_facts import END_ERROR, TURNS_HEAD, turn_rows

    turns = model.training["iterations"]
    known = any("loop_error_m" in turn for turn in turns)
    width = len(TURNS_HEAD) if known else len(TURNS_HEAD) - 1
    shown = table(TURNS_HEAD[:width], [row[:width] for row in turn_rows(turns, first)])
    return ["", shown, *([END_ERROR] if known else [])]
