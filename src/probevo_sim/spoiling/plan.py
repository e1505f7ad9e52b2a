"""What is done to each frame of a spoiled recording, drawn before any image is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo_sim.spoiling.config import PRESETS, EffectName, SpoilConfig

FULL_SHAKE_PX = 20.0
"""Length of the way of a shaken camera during an exposure, at severity 1."""
FULL_EXPOSURE = 4.0
"""Largest factor by which the exposure jumps, up or down, at severity 1."""
DARKEST = 0.08
"""Gain in the dark at severity 1."""
FULL_NOISE_GREY = 8.0
"""Standard deviation of the noise in the dark, at severity 1."""
WORST_JPEG = 8
BEST_JPEG = 60
"""JPEG qualities at severity 1 and 0."""
_PLAN_KEY = 1


@dataclass(frozen=True)
class FramePlan:
    """What is done to one frame."""

    effect: EffectName | None = None
    """None for a clean frame."""
    amount: float = 0.0
    """How much, 0 to 1."""
    burst: int = -1
    """Number of the burst, from 0; −1 for a clean frame. Frames of a burst have dirt, occluders,
    and the direction of a shake in common."""
    position: int = 0
    """Place of the frame in its burst, from 0."""

    @property
    def record(self) -> dict[str, float | int | str]:
        """The same for the record; nothing for a clean frame."""
        if self.effect is None:
            return {}
        return {"effect": self.effect, "amount": self.amount, "burst": self.burst}


def plan_frames(config: SpoilConfig, count: int) -> list[FramePlan]:
    """Draw what is done to each of ``count`` frames.

    Bursts and clean stretches alternate; both have geometric lengths, the means of which give the
    share of clean frames that the settings ask for. They begin after the clean frames at the start.
    """
    effects = PRESETS[config.preset]
    clean = config.clean
    if config.preset == "frames":  # a frame is lost or not: more severe is more often
        clean = 1.0 - config.severity * (1.0 - config.clean)
    if not effects or clean >= 1.0:
        return [FramePlan()] * count
    rng = np.random.default_rng([config.seed, _PLAN_KEY])
    clean_frames = config.burst_frames * clean / (1.0 - clean)
    plans = [FramePlan()] * config.clean_start_frames
    burst = 0
    while len(plans) < count:
        length = int(rng.geometric(1.0 / config.burst_frames))
        effect = effects[int(rng.integers(len(effects)))]
        amount = config.severity * float(rng.uniform(0.5, 1.0))
        plans += [FramePlan(effect, amount, burst=burst, position=k) for k in range(length)]
        # A geometric number that may be 0, of that mean.
        plans += [FramePlan()] * int(rng.geometric(1.0 / (1.0 + clean_frames)) - 1)
        burst += 1
    return plans[:count]
