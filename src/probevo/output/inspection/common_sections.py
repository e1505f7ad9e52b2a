"""Sections that the pages on all kinds of noise models have in common."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml
from markupsafe import Markup

from probevo.arrays import FloatArray
from probevo.output.inspection.subject import FrameView, Picture
from probevo.output.page import body_panel, details, pictures, table_panel
from probevo.output.table import text_table

IN_THE_FRAME = "In this frame"
HOW_IT_WAS_TRAINED = "How it was trained"
"""Headings of the parts behind what was learned."""
_SHORT_HASH = 12


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
