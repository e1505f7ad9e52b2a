"""The settings of the experiment of thesis section 5.7."""

from __future__ import annotations

from pydantic import Field

from probevo.config.settings import Settings


class SunConfig(Settings):
    """A drive among random points, by a stereo camera with a simulated sun sensor.

    The same settings give the same bytes.
    """

    seed: int = Field(0, ge=0, description="Seed of points, noise and sun sensor.")
    drives: int = Field(
        3, ge=1, le=1000, description="Drives to average over; a single drift says little."
    )
    frames: int = Field(5001, ge=12, le=100_000, description="Frames of a drive.")
    step_m: float = Field(0.2, gt=0, le=10, description="Way from frame to frame; 1 km in all.")
    points: int = Field(
        12, ge=8, le=1000, description="Points of each pair of frames: few, for the path to drift."
    )
    sigma_px: float = Field(
        1.0, gt=0, le=100, description="σ of a coordinate; the heading drifts by 7° a kilometre."
    )
    elevation_deg: float = Field(
        10.0,
        gt=-90,
        lt=90,
        description=(
            "Height of the sun. Turns about its direction are not seen; the higher it is, the more"
            " of the heading they are."
        ),
    )
