"""From radiance to grey values: exposure, noise, eight bits."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo_sim.scene.renderer import FloatImage

WHITE = 260.0
"""Grey value of radiance 1; what is brighter than 255 is cut off."""
FULL_NOISE_GREY = 12.0
DARK_SHARE = 0.3
"""Standard deviation at grey 128, and the share of its variance that is left in the dark."""
FULL_EXPOSURE = 4.0
EXPOSURE_MEMORY = 0.6
"""Largest factor of the exposure, up or down; how much of its logarithm one frame keeps of the
last."""


def exposures(count: int, strength: float, rng: np.random.Generator) -> FloatArray:
    """Gain of each of ``count`` frames: a random walk pulled back to 1, within a factor of 4 for a
    strength of 1."""
    steps = rng.normal(size=count)
    level = 0.0
    levels = np.empty(count)
    for k in range(count):
        level = EXPOSURE_MEMORY * level + np.sqrt(1.0 - EXPOSURE_MEMORY**2) * steps[k]
        levels[k] = level
    return FULL_EXPOSURE ** (strength * np.tanh(levels))


def expose(radiance: FloatImage, gain: float, noise: float, rng: np.random.Generator) -> Image:
    """The image, [height, width], uint8, that a sensor makes of a radiance.

    Args:
        radiance: 1 is white, [height, width].
        gain: of the exposure.
        noise: strength, 0 … 1; its variance grows with the light (shot noise) from a floor (read
            noise).
        rng: of the noise; none is drawn without noise.
    """
    grey = np.float32(gain * WHITE) * radiance
    if noise > 0.0:
        variance = (noise * FULL_NOISE_GREY) ** 2 * (DARK_SHARE + (1.0 - DARK_SHARE) / 128.0 * grey)
        grey = grey + np.sqrt(variance) * rng.standard_normal(grey.shape, dtype=np.float32)
    image: Image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    return image
