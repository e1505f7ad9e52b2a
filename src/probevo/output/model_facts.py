"""What models of full covariances are and how they came about, in the figures that terminal and
page share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from probevo.arrays import FloatArray
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.student_t import StudentT

SEARCHED = {
    "weights": "predictors",
    "reach": "ρ",
    "neighbors": "K",
    "bias_counts": "counts for no bias",
    "prior_counts": "counts for the prior",
    "dof_counts": "counts for ν",
}
"""What may have been searched for, in that order, and what it is called."""
SCALE_HEAD = ("", "σ, px", "correlation: u_l", "v_l", "u_r")
TURNS_HEAD = ("turn", "likelihood, nats a feature", "end error, m")
END_ERROR = (
    "End error: how far the motions end from where they should, which learning does not see unless"
    " it is told."
)


@dataclass(frozen=True)
class UsedColumn:
    """A column of φ that says something about the noise."""

    index: int
    """Among the M columns."""
    name: str
    weight: float
    """How much a standard deviation of it counts."""
    gain: float | None
    """What it adds, beside those before it, nats a feature; None if it was not searched for."""


def used_columns(model: GeneralizedKernel) -> tuple[UsedColumn, ...]:
    """Those whose weight is not 0, in the order in which they were chosen; those that were not, the
    heaviest first."""
    weights = model.metric_.weight
    search = model.training.get("searches", {}).get("weights", {"candidates": [], "gains": []})
    gains = dict(zip(search["candidates"], np.diff([0.0, *search["gains"]]).tolist(), strict=True))
    chosen = [model.columns.index(name) for name in gains]
    others = sorted(
        (m for m in np.flatnonzero(weights).tolist() if m not in chosen), key=lambda m: -weights[m]
    )
    return tuple(
        UsedColumn(m, model.columns[m], float(weights[m]), gain=gains.get(model.columns[m]))
        for m in (*chosen, *others)
    )


def gained(searches: Mapping[str, Mapping[str, Any]]) -> float | None:
    """What the model gains over the static one, nats a feature that was left out; None if nothing
    was searched for."""
    for name in reversed(SEARCHED):
        search = searches.get(name)
        if search and name == "weights":
            return float(search["gains"][-1]) if search["gains"] else None
        if search:
            return float(search["gains"][search["candidates"].index(search["chosen"])])
    return None


def turn_rows(turns: Sequence[Mapping[str, float]], first: str) -> list[tuple[str, ...]]:
    """A row under ``TURNS_HEAD`` for each turn of EM.

    Args:
        turns: what each found, given the noise that the one before had learned.
        first: the noise that the first was given.
    """
    return [
        (
            f"0: {first}" if number == 0 else f"{number}",
            f"{turn['log_likelihood']:.4f}",
            f"{turn['loop_error_m']:.3f}" if "loop_error_m" in turn else "–",
        )
        for number, turn in enumerate(turns)
    ]


def scale_rows(scale: FloatArray) -> list[tuple[str, ...]]:
    """A row under ``SCALE_HEAD`` for each coordinate of a scale [4, 4], px², and one for the
    disparity."""
    sigma = np.sqrt(np.diagonal(scale))
    correlation = scale / np.outer(sigma, sigma)
    rows = []
    for i, name in enumerate(("u_l", "v_l", "u_r", "v_r")):
        shown = [f"{correlation[i, j]:+.2f}".replace("-", "−") if j < i else "" for j in range(3)]
        rows.append((name, f"{sigma[i]:.3f}", *shown))
    disparity = np.sqrt(scale[0, 0] + scale[2, 2] - 2.0 * scale[0, 2])
    return [*rows, ("disparity, u_l − u_r", f"{disparity:.3f}", "", "", "")]


def lasting_text(model: GeneralizedKernel | StudentT) -> str:
    """How much of the error of a disparity is the same in both frames."""
    return (
        f"{model.time_correlation_ratio:.2g} times what is new of a disparity's error in a frame"
        if model.time_correlation_ratio
        else "none"
    )


def signed(value: float | None) -> str:
    """A gain; nothing if it is not known."""
    return "–" if value is None else f"{value:+.3f}".replace("-", "−")
