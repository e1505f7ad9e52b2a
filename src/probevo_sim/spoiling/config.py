"""The settings by which a recording is spoiled."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.settings import Settings

EffectName = Literal[
    "shake", "flow_blur", "darkness", "exposure", "occluder", "dirt", "jpeg", "dropped", "frozen"
]
PresetName = Literal[
    "mixed", "blur", "darkness", "exposure", "occluders", "dirt", "jpeg", "frames", "delay"
]
PRESETS: dict[PresetName, tuple[EffectName, ...]] = {
    "mixed": (
        "shake",
        "flow_blur",
        "darkness",
        "exposure",
        "occluder",
        "dirt",
        "jpeg",
        "dropped",
        "frozen",
    ),
    "blur": ("shake", "flow_blur"),
    "darkness": ("darkness",),
    "exposure": ("exposure",),
    "occluders": ("occluder",),
    "dirt": ("dirt",),
    "jpeg": ("jpeg",),
    "frames": ("dropped", "frozen"),
    "delay": (),
}
"""What a burst may consist of, by the preset's name."""


class SpoilConfig(Settings):
    """How a recording is spoiled. The same settings give the same bytes on one machine."""

    preset: PresetName = Field(
        "mixed", description="What is done: everything in turn, one kind of it, or only a delay."
    )
    seed: int = Field(0, ge=0, description="Seed of bursts, places, and noise.")
    severity: float = Field(
        0.5, gt=0, le=1, description="From 0, which is nothing, to 1, which is a bad day."
    )
    clean: float = Field(
        0.2, ge=0, le=1, description="Share of the frames that are left as they are."
    )
    burst_frames: float = Field(
        6.0, ge=1, le=1000, description="Mean length of a burst, frames; its length is geometric."
    )
    right_late_frames: int = Field(
        0,
        ge=0,
        le=100,
        description="Frames by which the right images are late, all along; 1 for preset delay.",
    )

    @property
    def delay_frames(self) -> int:
        """Frames by which the right images are late."""
        if self.preset == "delay":
            return max(self.right_late_frames, 1)
        return self.right_late_frames
