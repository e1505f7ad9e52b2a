"""The input of ``probevo inspect``, and the sections that a kind of noise model makes of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from markupsafe import Markup

from probevo.arrays import FloatArray, Image

Picture = tuple[str, bytes]
"""Caption and JPEG file."""


@dataclass(frozen=True)
class FrameView:
    """The N features of one frame, and their M predictors."""

    recording: str
    """Name of the recording."""
    index: int
    """Index of the frame, from 0."""
    left: Image | None
    """Left image, [height, width], uint8; None where the recording has none."""
    size_px: tuple[int, int]
    """(width, height) of the image, or of the area in which features were seen."""
    uv: FloatArray
    """Positions of the features in the left image, [N, 2], px."""
    columns: Mapping[str, str]
    """Name and unit of each of the M columns."""
    phi: FloatArray
    """Places of the features in the prediction space, [N, M]; NaN where undefined."""


@dataclass(frozen=True)
class Subject:
    """The subject of an inspection: a noise model, the features of a frame, or both."""

    name: str = ""
    """Name of the model's file; empty without a model."""
    model: Any = None
    """The fitted model, of the kind that the module is for; None without one."""
    frame: FrameView | None = None
    """The frame; None if only the model is inspected."""
    units: Mapping[str, str] = field(default_factory=dict)
    """Unit of each column of the predictors whose unit is known."""

    @property
    def title(self) -> str:
        """Title of the page."""
        if self.frame is None:
            return f"What {self.name} learned" if self.name else ""
        seen_by = f", as {self.name} sees it" if self.name else ""
        return f"{self.frame.recording}, frame {self.frame.index}{seen_by}"


@dataclass(frozen=True)
class Findings:
    """The result of an inspection: page, text and pictures."""

    sections: tuple[Markup, ...]
    """Sections of the page, from top to bottom."""
    text: str
    """Text for the terminal."""
    notes: tuple[str, ...] = ()
    """Explanations of the heads and symbols of the text, one sentence each."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """Facts about the model at the top of the page, by name."""
    terms: Mapping[str, str] = field(default_factory=dict)
    """Meanings of those facts that only a model of this kind has, by name."""
    pictures: Mapping[str, Picture] = field(default_factory=dict)
    """Pictures of the frame with its features in different colours, by the names of their files."""


@dataclass(frozen=True)
class TrainingSummary:
    """The summary of a trained model that ``probevo train`` prints."""

    facts: Mapping[str, str]
    """Key figures by name."""
    paragraphs: tuple[str, ...]
    """Tables and remarks below them."""
