"""The summary of a trained model that ``probevo train`` prints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from probevo.cli.text import columns

if TYPE_CHECKING:
    from probevo.noise.base import LearnedNoiseModel
    from probevo.output.inspection.subject import TrainingSummary


def summary(model: LearnedNoiseModel, out: Path) -> list[str]:
    """Say in a few lines what was learned, and how the settings that were not given were chosen.

    Args:
        model: the trained model; ``summary`` in the module of its kind describes it.
        out: its file.
    """
    from probevo.noise.registry import imported, kind_of

    module, _, _ = kind_of(model).inspection.partition(":")
    found: TrainingSummary = imported(f"{module}:summary")(model)
    lines = [columns(found.facts.items())]
    for paragraph in found.paragraphs:
        lines += ["", *paragraph.splitlines()]
    return [*lines, "", f"model: {out}"]
