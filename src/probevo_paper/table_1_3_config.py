"""The settings of the experiment of thesis Table 1.3."""

from __future__ import annotations

from pydantic import Field

from probevo_paper.gk_tables import GkTableConfig


class Table13Config(GkTableConfig):
    """Number and length of the loops, and the settings of all runs and trainings."""

    trials: int = Field(
        5, ge=2, le=100, description="Loops to render, the first to train on; five were published."
    )
    distance_m: float = Field(
        40.0, gt=1, le=5000, description="Once around, m; published are 205 to 250."
    )
