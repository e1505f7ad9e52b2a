"""Sections that the pages on all kinds of noise models have in common."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import yaml
from markupsafe import Markup

from probevo.arrays import FloatArray
from probevo.output.inspection.subject import Findings, FrameView, Picture
from probevo.output.inspection.terms import column_notes
from probevo.output.page import body_panel, details, grid, heading, pictures, table_panel
from probevo.output.table import Table, text_table

HOW_IT_WAS_TRAINED = "How it was trained"
"""Heading of the last part of a page."""
_SHORT_HASH = 12


@dataclass(frozen=True)
class FramePart:
    """The part of a page that shows a frame as the model sees it."""

    frame: FrameView
    pictures: Mapping[str, Picture]
    """Pictures of the frame, by the names of their files."""
    panels: Sequence[Markup]
    """Panels that compare the frame with the training data."""
    remark: str = ""
    """Remark that the note above the pictures ends with."""


@dataclass(frozen=True)
class ModelPage:
    """The parts of the page on a model with predictors, from top to bottom."""

    learned: Sequence[Markup]
    """Sections on what the model has learned."""
    table: Table
    """Table with a row for each column of the predictors."""
    samples: str
    """Name of the samples that the table describes if there is no frame."""
    frame_part: FramePart | None
    """None if only the model is inspected."""
    origin: Sequence[Markup]
    """Sections on the training."""

    def findings(
        self, facts: Mapping[str, str], terms: Mapping[str, str], text_below: str = ""
    ) -> Findings:
        """Arrange the parts.

        Args:
            facts: facts about the model at the top of the page, by name.
            terms: meanings of those facts that only a model of this kind has, by name.
            text_below: text for the terminal below the table.
        """
        has_frame = self.frame_part is not None
        table = self.table if has_frame else self.table.without("this frame")
        notes = column_notes(table.heads, has_frame=has_frame, samples=self.samples)
        sections = [
            *self.learned,
            table_panel("The predictors in figures", [" ".join(notes)], table.without("unit")),
        ]
        drawn: Mapping[str, Picture] = {}
        if self.frame_part is not None:
            part = self.frame_part
            drawn = part.pictures
            sections.append(heading("In this frame"))
            sections.append(pictures_section(part.frame, drawn, part.remark))
            sections.append(grid(part.panels))
        sections += self.origin
        return Findings(
            sections=tuple(sections),
            text=table.as_text() + text_below,
            notes=notes,
            facts=facts,
            terms=terms,
            pictures=drawn,
        )


def percent(share: float) -> str:
    """Format a share, 0 … 1, in per cent; what is more than nothing never reads as nothing."""
    if share == 0.0:
        return "0 %"
    return "< 0.1 %" if share < 0.001 else f"{100.0 * share:.1f} %"


def frame_facts(frame: FrameView | None) -> dict[str, str]:
    """Describe a frame by its number of features and its image."""
    if frame is None:
        return {}
    width_px, height_px = frame.size_px
    area = f"{width_px}×{height_px} px"
    return {
        "Features": f"{len(frame.uv):,}",
        "Image": area if frame.left is not None else f"none; area of {area}",
    }


def pictures_section(frame: FrameView, drawn: Mapping[str, Picture], remark: str = "") -> Markup:
    """Show the pictures of a frame.

    Args:
        frame: the frame.
        drawn: its pictures, by the names of their files. Those of a column whose value all features
            share are named instead of shown.
        remark: what else the note above them says.
    """
    constant = [
        name
        for name, values in zip(frame.columns, frame.phi.T, strict=True)
        if name in drawn and is_constant(values)
    ]
    note = (
        "The ends of each bar are the 2 % and 98 % quantiles of this frame; ≤ and ≥ say that there"
        " are values beyond, in the same colour. Hollow grey rings: the predictor is undefined."
    )
    if constant:
        note += f" The same for all features, and so not drawn: {', '.join(constant)}."
    if remark:
        note += f" {remark}"
    shown = [picture for name, picture in drawn.items() if name not in constant]
    return body_panel("Its features", [note], pictures(shown, style="wide"))


def training_section(training: Mapping[str, Any]) -> Markup:
    """List the recordings that a model was trained on; empty if they are not known."""
    recordings = training.get("recordings", [])
    if not recordings:
        return Markup("")
    rows = [
        (
            str(recording["name"]),
            f"{recording['frames']:,}",
            f"{str(recording['sha256'])[:_SHORT_HASH]}…",
        )
        for recording in recordings
    ]
    return table_panel("Trained on", [], text_table(("recording", "frames", "SHA-256"), rows))


def settings_section(training: Mapping[str, Any]) -> Markup:
    """Show the settings that a model was trained with; empty if they are not known."""
    settings = training.get("settings")
    if not settings:
        return Markup("")
    text = yaml.safe_dump(settings, sort_keys=True, allow_unicode=True)
    return details("Settings of the training", text)


def is_constant(values: FloatArray) -> bool:
    """Test whether several features have one and the same value, as the angular rate has, [N]."""
    return len(values) > 1 and bool(np.all(values == values[0]))
