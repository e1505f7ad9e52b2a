"""The settings of the experiments with HydraNet."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.config.settings import Settings

Experiment = Literal["numbers", "orbit"]
EXPERIMENTS: tuple[Experiment, ...] = ("numbers", "orbit")


class HydranetConfig(Settings):
    """Sizes of both experiments. The defaults are the thesis's, but for the repetitions."""

    experiments: tuple[Experiment, ...] = Field(
        EXPERIMENTS, min_length=1, description="Those to repeat: 1-D regression, orbiting camera."
    )
    repetitions: int = Field(
        20,
        ge=1,
        le=1000,
        description="Of the 1-D regression, each with other data.",
    )
    epochs: int = Field(3000, ge=1, le=100_000, description="Of the 1-D regression.")
    poses: int = Field(
        15_000,
        ge=100,
        le=1_000_000,
        description="Views to train on in orbit; a tenth more is left out.",
    )
    orbit_epochs: int = Field(
        100, ge=1, le=10_000, description="Of the orbiting camera's networks, at most."
    )
    heads: int = Field(25, ge=2, le=1000, description="Of hydra and hydra-sigma in orbit.")
    networks: int = Field(10, ge=2, le=1000, description="Of the ensemble in orbit; not published.")
    seed: int = Field(0, ge=0, description="Of data and networks; the same gives the same bytes.")
