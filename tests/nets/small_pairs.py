"""Pairs of images for the tests: fields of flow of a camera that turns before a plane."""

from __future__ import annotations

import numpy as np

from probevo.geometry import so3
from probevo.nets.flow_field import CELLS, cell_rays, rotated
from probevo.nets.image_pairs import ImagePairs

NOISE = 0.002
"""Of the flow of a cell, in normalised coordinates."""


def small_pairs(count: int, seed: int = 0, turn_rad: float = 0.01) -> ImagePairs:
    """Pairs of a camera that drives at random speeds and turns."""
    rng = np.random.default_rng(seed)
    x, y = cell_rays()
    depth = 1.0 / (0.02 + np.abs(y) * 0.6)
    forward = rng.uniform(0.0, 1.0, (count, 1, 1))
    phi = rng.normal(0.0, turn_rad, (count, 3))
    fields = np.zeros((count, 4, *CELLS))
    fields[:, 0] = forward * x / depth
    fields[:, 1] = forward * y / depth
    fields = rotated(fields, so3.exp(phi))
    fields[:, :2] += rng.normal(0.0, NOISE, fields[:, :2].shape)
    fields[:, 2:] = rng.normal(1.0, 0.3, fields[:, 2:].shape)
    return ImagePairs(fields.astype(np.float32), phi)
