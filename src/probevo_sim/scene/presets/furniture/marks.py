"""Marks that lie flat on the road."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture

MARK_HEIGHT = 0.003
"""Thickness of a mark."""


def lane_dash(length: float = 3.0, width: float = 0.14) -> Solids:
    """Build one painted dash along x, worn."""
    return _mark((length, width), Texture.ASPHALT, 1.5, albedo=0.62, contrast=0.6)


def crosswalk(width: float, length: float = 3.5) -> Solids:
    """Build white stripes along x, each 0.5 wide, side by side across a road of this width."""
    # The squares of the checkerboard are stretched to the length of a stripe.
    tile = np.array([[1.0, 1.0], [1.0, 1.0], [8.0 * length, 4.0]])
    return _mark((length, width), Texture.CHECKERBOARD, tile, albedo=0.44, contrast=0.4)


def manhole() -> Solids:
    """Build a round iron lid."""
    return solid(
        ELLIPSOID,
        (0.75, 0.75, 2 * MARK_HEIGHT),
        (0, 0, 0),
        texture=Texture.METAL,
        tile_m=0.5,
        albedo=0.16,
        contrast=1.0,
    )


def patch(rng: np.random.Generator) -> Solids:
    """Build a repaired patch of road, a little darker or brighter."""
    albedo = rng.choice([0.19, 0.36])
    texture = rng.choice([int(Texture.ASPHALT), int(Texture.CONCRETE)])
    return _mark(
        rng.uniform([0.8, 0.6], [3.0, 1.6]), Texture(texture), 2.0, albedo=albedo, contrast=0.8
    )


def arrow() -> Solids:
    """Build a painted arrow along x, 3 long."""
    shaft = _mark((2.0, 0.15), Texture.ASPHALT, 1.5, albedo=0.62, contrast=0.6)
    barb = (0.9, 0.18, MARK_HEIGHT)
    barbs = [
        solid(
            BOX,
            barb,
            (1.0, 0.24 * side, 0),
            texture=Texture.ASPHALT,
            tile_m=1.5,
            yaw_rad=-0.6 * side,
            albedo=0.62,
        )
        for side in (-1, 1)
    ]
    return join([shaft, *barbs])


def _mark(
    size: ArrayLike, texture: Texture, tile: ArrayLike, albedo: float, contrast: float
) -> Solids:
    """Build a flat mark of this size, (length, width)."""
    extent = np.r_[np.asarray(size, float), MARK_HEIGHT]
    return solid(
        BOX,
        extent,
        (0, 0, 0.5 * MARK_HEIGHT),
        texture=texture,
        tile_m=tile,
        albedo=albedo,
        contrast=contrast,
    )
