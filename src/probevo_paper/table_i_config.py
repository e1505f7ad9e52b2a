"""The settings of the Table I experiment."""

from __future__ import annotations

from pydantic import Field

from probevo.config import OdometryConfig


class TableIConfig(OdometryConfig):
    """All runs share these; the estimators differ in noise model, RANSAC and pre-filter alone."""

    max_frames: int | None = Field(
        None,
        ge=2,
        description="Stop each trial after so many frames. What was published is of whole drives.",
    )
