"""Settings for training networks that serve as sensors (``probevo train --kind rotation`` …)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Literal

from pydantic import Field

from probevo.config.settings import Settings

MethodName = Literal["hydra-sigma", "dropout", "ensemble"]
METHOD_SETTINGS: Mapping[MethodName, tuple[str, ...]] = {
    "hydra-sigma": ("heads", "networks"),
    "dropout": ("dropout", "passes"),
    "ensemble": ("networks",),
}
"""Settings that not every method takes."""


class NetworkSettings(Settings):
    """Size of a network, and length and data of its training."""

    method: MethodName = Field(
        "hydra-sigma",
        description=(
            "Of sun: where the covariance comes from. hydra-sigma learns one, and adds the spread"
            " of its networks and their heads; dropout and ensemble are baselines, which have the"
            " spread alone."
        ),
    )
    heads: int = Field(
        10,
        ge=2,
        le=1000,
        description="H, the heads of the network, whose estimates are averaged (HydraNet).",
    )
    dropout: float = Field(
        0.5,
        gt=0,
        lt=1,
        description="Of the method dropout: share of the units that a pass drops, as in Sun-BCNN.",
    )
    passes: int = Field(
        25,
        ge=2,
        le=1000,
        description="Of the method dropout: passes whose estimates are averaged, as in Sun-BCNN.",
    )
    networks: int = Field(
        5,
        ge=1,
        le=100,
        description=(
            "Of sun, methods hydra-sigma and ensemble: networks trained apart, whose estimates are"
            " averaged; those of ensemble each on a bootstrap sample."
        ),
    )
    epochs: int = Field(40, ge=1, le=100_000, description="Largest number of passes over the data.")
    patience: int = Field(
        10,
        ge=1,
        le=100_000,
        description="Epochs without a better likelihood of the data left out, before it stops.",
    )
    batch: int = Field(
        32,
        ge=1,
        le=100_000,
        description="Samples in a step of the optimiser; all of them where there are fewer.",
    )
    learning_rate: float = Field(1e-4, gt=0, le=1, description="Learning rate of Adam.")
    rotation_only: bool = Field(
        False,
        description="Of correction: correct the rotation alone, the ablation of DPC-Net.",
    )
    constant_covariance: bool = Field(
        False,
        description=(
            "Of correction: learn no covariance; that of the training data weights the loss, and is"
            " claimed, as in DPC-Net."
        ),
    )
    copies: int = Field(
        4,
        ge=1,
        le=1000,
        description=(
            "Of rotation and sun: number of times that an epoch uses each image, and as often its"
            " mirror image, each time as if the camera had turned by another random angle."
        ),
    )
    left_out: int = Field(
        1,
        ge=1,
        le=10_000,
        description=(
            "Number of recordings, the last ones named, that are not trained on: they decide when"
            " to stop, and calibrate the covariance."
        ),
    )
    seed: int = Field(0, ge=0, description="Seed; the same seed gives the same bytes on one CPU.")
