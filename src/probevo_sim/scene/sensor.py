"""The image sensor: from radiance to grey values by exposure, noise and quantisation."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, Image
from probevo_sim.scene.renderer import FloatImage

WHITE_GREY = 260.0
"""Grey value of radiance 1; the sensor saturates at 255."""
FULL_NOISE_GREY = 12.0
"""Standard deviation of the full noise at grey 128."""
READ_NOISE_SHARE = 0.3
"""Share of that variance which does not depend on the light; the rest is shot noise."""
FULL_EXPOSURE = 4.0
"""Largest factor by which the exposure changes, up or down."""
EXPOSURE_CORRELATION = 0.6
"""Correlation of the logarithm of the exposure from one frame to the next."""


def exposures(count: int, strength: float, rng: np.random.Generator) -> FloatArray:
    """Return the gain of each of ``count`` frames, [count]: a first-order autoregressive process.

    The gain varies around 1; for a strength of 1 it stays within a factor of 4.
    """
    steps = rng.normal(size=count)
    level = 0.0
    levels = np.empty(count)
    for k in range(count):
        level = EXPOSURE_CORRELATION * level + np.sqrt(1.0 - EXPOSURE_CORRELATION**2) * steps[k]
        levels[k] = level
    return FULL_EXPOSURE ** (strength * np.tanh(levels))


def expose(radiance: FloatImage, gain: float, noise: float, rng: np.random.Generator) -> Image:
    """Expose an image, [height, width], uint8.

    Args:
        radiance: [height, width]; 1 is white.
        gain: gain of the exposure.
        noise: strength of the noise, 0 … 1; its variance is the sum of the read noise's and the
            shot noise's, which grows with the light.
        rng: source of the noise; nothing is drawn without noise.
    """
    grey = np.float32(gain * WHITE_GREY) * radiance
    if noise > 0.0:
        shot_noise = (1.0 - READ_NOISE_SHARE) / 128.0 * grey
        variance = (noise * FULL_NOISE_GREY) ** 2 * (READ_NOISE_SHARE + shot_noise)
        grey = grey + np.sqrt(variance) * rng.standard_normal(grey.shape, dtype=np.float32)
    image: Image = np.clip(np.rint(grey), 0, 255).astype(np.uint8)
    return image
