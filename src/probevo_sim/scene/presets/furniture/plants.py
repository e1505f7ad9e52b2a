"""What grows, and rocks."""

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
"""Of each ball of a tree: distance from the trunk, height in the crown, size, as shares of the
crown's."""


def tree(
    rng: np.random.Generator, height: float | None = None, leaves: Texture = Texture.FOLIAGE
) -> Solids:
    """A trunk with a crown of several balls of leaves; 5 to 9 high unless told."""
    high = rng.uniform(5.0, 9.0) if height is None else height
    wide = rng.uniform(0.45, 0.65) * high
    clear = max(0.28 * high, 2.2)
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
    around = rng.uniform(0, 2 * np.pi)
    for k, (out, up, size) in enumerate(_CROWN):
        angle = around + 2.4 * k + rng.uniform(-0.3, 0.3)
        middle = (
            out * wide * np.cos(angle),
            out * wide * np.sin(angle),
            clear + up * (high - clear),
        )
        extent = size * np.array([wide, wide, min(high - clear, wide)]) * rng.uniform(0.85, 1.15, 3)
        parts.append(_ball(rng, extent, middle, tile=2.5, leaves=leaves, yaw_rad=angle))
    return join(parts)


def distant_tree(rng: np.random.Generator) -> Solids:
    """Two balls of leaves down to the ground, 8 to 14 high, for what stands behind other things."""
    high = rng.uniform(8.0, 14.0)
    upper = _ball(rng, (0.6 * high, 0.6 * high, 0.76 * high), (0, 0, 0.62 * high), tile=4.0)
    return join(
        [
            upper,
            _ball(
                rng,
                (0.7 * high, 0.7 * high, 0.7 * high),
                (0.1 * high, 0.2 * high, 0.3 * high),
                tile=4.0,
            ),
        ]
    )


def bush(rng: np.random.Generator, leaves: Texture = Texture.FOLIAGE) -> Solids:
    """Two balls of leaves, 0.8 to 1.6 high."""
    high = rng.uniform(0.8, 1.6)
    large = _ball(
        rng, (1.4 * high, 1.2 * high, 1.2 * high), (0, 0, 0.4 * high), tile=1.6, leaves=leaves
    )
    return join(
        [
            large,
            _ball(
                rng,
                (high, 0.9 * high, 0.9 * high),
                (0.4 * high, 0.3 * high, 0.3 * high),
                tile=1.6,
                leaves=leaves,
            ),
        ]
    )


def hedge(
    length: float, height: float, leaves: Texture = Texture.FOLIAGE, *, tile: float = 2.0
) -> Solids:
    """A clipped hedge along x, 0.7 deep."""
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
    """A boulder of one or two balls, half in the ground; 0.4 to 1.8 across unless told."""
    wide = rng.uniform(0.4, 1.8) if size is None else size
    balls = []
    for k in range(int(rng.integers(1, 3))):
        extent = wide * rng.uniform([0.7, 0.7, 0.6], [1.2, 1.0, 0.9]) * (1.0 - 0.35 * k)
        middle = (0.4 * wide * k, 0.2 * wide * k, 0.15 * extent[2])
        albedo = rng.uniform(0.3, 0.45)
        yaw = rng.uniform(0, np.pi)
        shift = rng.uniform(0, 2, 2)
        balls.append(
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
    return join(balls)


def _ball(
    rng: np.random.Generator,
    size: ArrayLike,
    middle: ArrayLike,
    tile: float,
    leaves: Texture = Texture.FOLIAGE,
    *,
    yaw_rad: float = 0.0,
) -> Solids:
    """A ball of leaves, each time a little brighter or darker."""
    return solid(
        ELLIPSOID,
        size,
        middle,
        texture=leaves,
        tile_m=tile,
        yaw_rad=yaw_rad,
        albedo=rng.uniform(0.2, 0.28),
        contrast=0.9,
        shift_m=rng.uniform(0, tile, 2),
    )
