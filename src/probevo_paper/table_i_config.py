"""The settings of the Table I experiment."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.config import OdometryConfig


class TableIConfig(OdometryConfig):
    """The settings of all runs; estimators differ only in noise model, RANSAC and pre-filter."""

    estimator: Literal["two-frame", "window"] = Field(
        "two-frame", description="Of all runs; what was published is of two frames."
    )
    max_frames: int | None = Field(
        None,
        ge=2,
        description="Stop each trial after so many frames. What was published is of whole drives.",
    )
