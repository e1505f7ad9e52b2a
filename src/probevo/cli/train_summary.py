"""The summary of a trained model that ``probevo train`` prints."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from probevo.cli.text import columns

if TYPE_CHECKING:
    from probevo.noise.base import LearnedNoiseModel
    from probevo.output.inspection.subject import TrainingSummary

FEW_FRAMES = 200
"""Frames below which training warns. On KITTI, a ``gk`` of 77 frames gained nothing on other
drives, one of 244 frames of two drives did."""


def summary(model: LearnedNoiseModel, out: Path) -> list[str]:
    """Say in a few lines what was learned, and how the settings that were not given were chosen.

    Args:
        model: the trained model; ``summary`` in the module of its kind describes it.
        out: its file.
    """
    from probevo.entry_points import imported
    from probevo.noise.registry import kind_of

    module, _, _ = kind_of(model).inspection.partition(":")
    description: TrainingSummary = imported(f"{module}:summary")(model)
    lines = [columns(description.facts.items())]
    for paragraph in description.paragraphs:
        lines += ["", *paragraph.splitlines()]
    return [*lines, "", f"model: {out}"]


def few_frames_warning(model: LearnedNoiseModel) -> str:
    """Return what to do about a model that was learned from few frames; empty if there are
    enough."""
    from probevo.output.inspection.training_facts import num_frames, origin

    if num_frames(model.training) >= FEW_FRAMES:
        return ""
    return (
        f"it was learned from {origin(model.training)}. From so few, a model may fit this drive and"
        " gain nothing on others. Give more recordings of the same camera, a few hundred frames"
        " with what will be met later; probevo compare shows on one left out what is gained."
    )
