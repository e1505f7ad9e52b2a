"""Settings of the training of networks that measure (``probevo train --kind rotation`` …)."""

from __future__ import annotations

from pydantic import Field

from probevo.settings import Settings


class NetworkSettings(Settings):
    """How large a network is, how long it is trained, and on what."""

    heads: int = Field(
        10, ge=2, le=1000, description="H, estimates of one input, whose mean is taken (HydraNet)."
    )
    epochs: int = Field(40, ge=1, le=100_000, description="Times that all data are used, at most.")
    patience: int = Field(
        10,
        ge=1,
        le=100_000,
        description="Epochs without a better likelihood of what is left out, before it stops.",
    )
    batch: int = Field(32, ge=1, le=100_000, description="Data of a step of the optimiser.")
    learning_rate: float = Field(1e-4, gt=0, le=1, description="Of Adam.")
    rotation_only: bool = Field(
        False,
        description="Of correction: correct the rotation alone, the ablation of DPC-Net.",
    )
    constant_covariance: bool = Field(
        False,
        description=(
            "Of correction: learn no covariance; that of the training data weighs the loss, and is"
            " claimed, as in DPC-Net."
        ),
    )
    copies: int = Field(
        4,
        ge=1,
        le=1000,
        description=(
            "Of rotation and sun: times that all images are used; all but the first are turned"
            " further by a random angle, as the camera would have seen it."
        ),
    )
    left_out: int = Field(
        1,
        ge=1,
        le=10_000,
        description=(
            "Recordings, the last ones named, that are not learned from: they stop the training,"
            " and calibrate the covariance."
        ),
    )
    seed: int = Field(0, ge=0, description="The same gives the same bytes on one CPU.")
