"""The settings by which a recording is spoiled."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, field_validator

from probevo.config.settings import Settings

EffectName = Literal[
    "shake", "flow_blur", "darkness", "exposure", "occluder", "dirt", "jpeg", "dropped", "frozen"
]
PresetName = Literal[
    "mixed",
    "blur",
    "darkness",
    "exposure",
    "occluders",
    "dirt",
    "jpeg",
    "frames",
    "delay",
    "calibration",
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
    "calibration": (),
}
"""What a burst may consist of, by the preset's name."""
StressPreset = Literal[
    "mixed", "blur", "darkness", "exposure", "occluders", "dirt", "jpeg", "frames"
]
"""The presets that have a severity."""
FOCAL_ERROR = 0.03
RADIAL_DISTORTION = 0.03
"""Errors of the preset calibration, unless others are given."""
CLEAN_START_FRAMES = 5
"""Frames at the start of a recording under stress that are clean: images that are frozen from the
first frame on look like a camera at rest."""


class SpoilConfig(Settings):
    """How a recording is spoiled. The same settings give the same bytes on one machine."""

    preset: PresetName = Field(
        "mixed", description="What is done: everything in turn, one kind of it, or only a delay."
    )
    seed: int = Field(0, ge=0, description="Seed of bursts, places, and noise.")
    severity: float = Field(
        0.5,
        gt=0,
        le=1,
        description=(
            "Above 0, which would be nothing, up to 1, which is a bad day. A frame is lost or not:"
            " with preset frames, the severity scales how many are; with mixed, it does not matter"
            " to them."
        ),
    )
    clean: float = Field(
        0.2,
        ge=0,
        le=1,
        description=(
            "Share of the frames that are left as they are; with preset frames, that at severity 1."
        ),
    )
    burst_frames: float = Field(
        6.0, ge=1, le=1000, description="Mean length of a burst, frames; its length is geometric."
    )
    clean_start_frames: int = Field(
        1, ge=1, le=1000, description="Frames at the start that are left as they are."
    )
    right_late_frames: int = Field(
        0,
        ge=0,
        le=100,
        description="Frames by which the right images are late, all along; 1 for preset delay.",
    )
    focal_error: float = Field(
        0.0,
        ge=-0.5,
        le=0.5,
        description=(
            "Share by which the focal length of the calibration is too large, all along; 0.03 for"
            " preset calibration."
        ),
    )
    radial_distortion: float = Field(
        0.0,
        ge=-0.2,
        le=0.2,
        description=(
            "k1 of a radial distortion that the calibration does not know of, all along: x becomes"
            " x (1 + k1 r²); 0.03 for preset calibration."
        ),
    )

    def effective(self) -> SpoilConfig:
        """Return the settings with what the preset stands for, as they can be evaluated by."""
        focal_error, radial_distortion = self.wrong_calibration
        return self.model_copy(
            update={
                "right_late_frames": self.delay_frames,
                "focal_error": focal_error,
                "radial_distortion": radial_distortion,
            }
        )

    @property
    def delay_frames(self) -> int:
        """Frames by which the right images are late."""
        if self.preset == "delay":
            return max(self.right_late_frames, 1)
        return self.right_late_frames

    @property
    def wrong_calibration(self) -> tuple[float, float]:
        """The error of the focal length, a share, and the radial distortion k1."""
        if self.preset == "calibration" and not (self.focal_error or self.radial_distortion):
            return FOCAL_ERROR, RADIAL_DISTORTION
        return self.focal_error, self.radial_distortion


class StressConfig(Settings):
    """Which spoiled versions of a recording the odometry is run on."""

    presets: tuple[StressPreset, ...] = Field(
        ("blur", "darkness", "exposure", "occluders", "dirt", "jpeg", "frames", "mixed"),
        min_length=1,
        description="What is done, one after the other.",
    )
    severities: tuple[Annotated[float, Field(gt=0, le=1)], ...] = Field(
        (0.25, 0.5, 0.75, 1.0),
        min_length=1,
        description="How strong it is; of `frames`, how large a share of the bursts is lost.",
    )
    repeats: int = Field(
        1, ge=1, le=1000, description="Runs of each preset and severity, with other seeds."
    )
    clean: float = Field(
        0.2, ge=0, lt=1, description="Share of the frames that are left as they are."
    )
    burst_frames: float = Field(6.0, ge=1, le=1000, description="Mean length of a burst, frames.")

    @field_validator("presets", "severities")
    @classmethod
    def _check_distinct(cls, values: tuple[object, ...]) -> tuple[object, ...]:
        if len(set(values)) < len(values):
            raise ValueError("it should name each once")
        return values

    def spoiling(self, preset: StressPreset, severity: float, seed: int) -> SpoilConfig:
        """Return how a recording is spoiled for one of the runs."""
        return SpoilConfig(
            preset=preset,
            seed=seed,
            severity=severity,
            clean=self.clean,
            burst_frames=self.burst_frames,
            clean_start_frames=CLEAN_START_FRAMES,
        )
