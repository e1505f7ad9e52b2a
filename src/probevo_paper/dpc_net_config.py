"""The settings of the experiment with DPC-Net."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.config.settings import Settings


class DpcNetConfig(Settings):
    """Sizes of the experiment, which takes some ten minutes on two cores by default."""

    drives: int = Field(
        4,
        ge=2,
        le=100,
        description="Rendered drives to learn from; streets of a city and of houses take turns.",
    )
    estimator: Literal["two-frame", "window"] = Field(
        "two-frame", description="Of the odometry whose motions are corrected."
    )
    distance_m: float = Field(100.0, ge=20, le=5000, description="Length of each drive, m.")
    focal_error: float = Field(
        0.03, ge=-0.5, le=0.5, description="Share by which the focal length is wrong."
    )
    radial_distortion: float = Field(
        0.03, ge=-0.2, le=0.2, description="k1 of the distortion that the calibration lacks."
    )
    heads: int = Field(10, ge=2, le=1000, description="Of the networks.")
    epochs: int = Field(40, ge=1, le=100_000, description="Of the networks, at most.")
    seed: int = Field(0, ge=0, description="Of drives and networks.")
