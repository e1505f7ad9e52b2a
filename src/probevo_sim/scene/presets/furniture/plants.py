"""Trees, bushes and hedges, and rocks."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture

_CROWN = (
    (0.0, 0.66, 0.72),
    (0.2, 0.36, 0.6),
    (0.22, 0.44, 0.6),
    (0.21, 0.38, 0.62),
    (0.2, 0.6, 0.6),
    (0.19, 0.68, 0.5),
)
"""The ellipsoids of a tree's crown: distance from the trunk, height, and size of each.

All are shares of the size of the crown."""


def tree(
    rng: np.random.Generator, height: float | None = None, leaves: Texture = Texture.FOLIAGE
) -> Solids:
    """Build a trunk with a crown of several ellipsoids of leaves; by default 5 to 9 high."""
    high = rng.uniform(5.0, 9.0) if height is None else height
    wide = rng.uniform(0.45, 0.65) * high
    clear = max(0.28 * high, 2.2)  # height of the lowest leaves
    parts = [
        solid(
            BOX,
            (0.05 * high, 0.05 * high, 0.7 * high),
            (0, 0, 0.35 * high),
            texture=Texture.BARK,
            tile_m=1.2,
            albedo=0.2,
        )
    ]

    # The ellipsoids follow each other around the trunk by about the golden angle.
    around = rng.uniform(0, 2 * np.pi)
    for k, (out, up, size) in enumerate(_CROWN):
        angle = around + 2.4 * k + rng.uniform(-0.3, 0.3)
        middle = (
            out * wide * np.cos(angle),
            out * wide * np.sin(angle),
            clear + up * (high - clear),
        )
        extent = size * np.array([wide, wide, min(high - clear, wide)]) * rng.uniform(0.85, 1.15, 3)
        parts.append(_leaves(rng, extent, middle, tile=2.5, texture=leaves, yaw_rad=angle))
    return join(parts)


def distant_tree(rng: np.random.Generator) -> Solids:
    """Build a simple tree for the background: leaves down to the ground, 8 to 14 high."""
    high = rng.uniform(8.0, 14.0)
    upper = _leaves(rng, (0.6 * high, 0.6 * high, 0.76 * high), (0, 0, 0.62 * high), tile=4.0)
    lower_middle = (0.1 * high, 0.2 * high, 0.3 * high)
    lower = _leaves(rng, (0.7 * high, 0.7 * high, 0.7 * high), lower_middle, tile=4.0)
    return join([upper, lower])


def bush(rng: np.random.Generator) -> Solids:
    """Build a bush of two ellipsoids of leaves, 0.8 to 1.6 high."""
    high = rng.uniform(0.8, 1.6)
    large_size = (1.4 * high, 1.2 * high, 1.2 * high)
    large = _leaves(rng, large_size, (0, 0, 0.4 * high), tile=1.6)
    small_size = (high, 0.9 * high, 0.9 * high)
    small_middle = (0.4 * high, 0.3 * high, 0.3 * high)
    small = _leaves(rng, small_size, small_middle, tile=1.6)
    return join([large, small])


def hedge(
    length: float, height: float, leaves: Texture = Texture.FOLIAGE, *, tile: float = 2.0
) -> Solids:
    """Build a clipped hedge along x, 0.7 deep."""
    return solid(
        BOX,
        (length, 0.7, height),
        (0, 0, 0.5 * height),
        texture=leaves,
        tile_m=tile,
        albedo=0.25,
        contrast=0.9,
    )


def rock(rng: np.random.Generator, size: float | None = None) -> Solids:
    """Build a boulder of one or two ellipsoids, half in the ground, 0.4 to 1.8 across."""
    wide = rng.uniform(0.4, 1.8) if size is None else size
    parts = []
    for k in range(int(rng.integers(1, 3))):
        extent = wide * rng.uniform([0.7, 0.7, 0.6], [1.2, 1.0, 0.9]) * (1.0 - 0.35 * k)
        middle = (0.4 * wide * k, 0.2 * wide * k, 0.15 * extent[2])
        albedo = rng.uniform(0.3, 0.45)
        yaw = rng.uniform(0, np.pi)
        shift = rng.uniform(0, 2, 2)
        parts.append(
            solid(
                ELLIPSOID,
                extent,
                middle,
                texture=Texture.ROCK,
                tile_m=1.5,
                yaw_rad=yaw,
                albedo=albedo,
                shift_m=shift,
            )
        )
    return join(parts)


def _leaves(
    rng: np.random.Generator,
    size: ArrayLike,
    middle: ArrayLike,
    *,
    tile: float,
    texture: Texture = Texture.FOLIAGE,
    yaw_rad: float = 0.0,
) -> Solids:
    """Build an ellipsoid of leaves, each time a little brighter or darker."""
    return solid(
        ELLIPSOID,
        size,
        middle,
        texture=texture,
        tile_m=tile,
        yaw_rad=yaw_rad,
        albedo=rng.uniform(0.2, 0.28),
        contrast=0.9,
        shift_m=rng.uniform(0, tile, 2),
    )
