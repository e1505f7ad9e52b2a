"""The settings of the experiment of thesis Table 1.2."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo_paper.gk_tables import GkTableConfig

RowName = Literal["synthetic", "city", "residential", "road"]
ROWS: tuple[RowName, ...] = ("synthetic", "city", "residential", "road")


class Table12Config(GkTableConfig):
    """Rows of the table, lengths of their drives, and the settings of all runs and trainings."""

    rows: tuple[RowName, ...] = Field(ROWS, description="Of the table, those to repeat.")
    street_m: float = Field(
        120.0,
        gt=1,
        le=5000,
        description="Distance of the drives in city and residential, m; published are 333 and 714.",
    )
    road_m: float = Field(
        250.0, gt=1, le=5000, description="The same of the road; published are 724."
    )
    max_frames: int | None = Field(
        None, ge=2, description="Of each drive, train on and run so many frames."
    )
