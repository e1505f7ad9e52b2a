"""The settings of the blur experiment, PROBE Fig. 5."""

from __future__ import annotations

from pydantic import Field

from probevo.config.settings import Settings


class BlurConfig(Settings):
    """Length and seed of the experiment. The same settings give the same bytes."""

    instants: int = Field(
        120,
        ge=20,
        le=5000,
        description=(
            "Synchronised exposures, 0.2 s apart; half of them in slow motion, half in fast. Fewer"
            " than 60 leave too few for intervals to mean much."
        ),
    )
    seed: int = Field(0, ge=0, description="Of the motion and of the noise in the images.")
