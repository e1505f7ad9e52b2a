"""The textures of a rendered scene: procedural grey tiles that wrap around, each as a pyramid of
box means."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from functools import cache

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import IntArray
from probevo_sim.scene.texture_patterns import canvas, facades, ground, plants, surfaces, vehicles

SIZE = canvas.SIDE
"""Texels a side of a tile's finest level."""


class Texture(IntEnum):
    """Every texture; the value is its layer in the pyramid."""

    PLAIN = 0
    ASPHALT = 1
    CONCRETE = 2
    PAVING = 3
    GRASS = 4
    DIRT = 5
    FACADE_OFFICE = 6
    FACADE_FLATS = 7
    FACADE_OLD = 8
    FACADE_HOUSE = 9
    BRICK = 10
    PLASTER = 11
    ROOF = 12
    FOLIAGE = 13
    HEDGE_REPEATED = 14
    BARK = 15
    FENCE = 16
    METAL = 17
    CAR_SIDE = 18
    CAR_FRONT = 19
    CAR_TOP = 20
    CLOTH = 21
    ROCK = 22
    SIGN = 23
    CHECKERBOARD = 24
    CLOUDS = 25
    BLOTCHES = 26
    DAPPLE = 27


@dataclass(frozen=True)
class TexturePyramid:
    """All textures at all scales, shared and read-only. A tile wraps around; its mean is 0.5, that
    is 127.5."""

    texels: NDArray[np.uint8]
    """[L, M]: of each texture its levels one after another, level 0 first, row-major. Column =
    first texture coordinate, row = second, growing upward on a wall: row 0 is the foot of a facade.
    """
    level_start: IntArray
    """[n_levels]: where each level begins; level l has (SIZE >> l)² texels."""


_PATTERNS: dict[Texture, tuple[Callable[[np.random.Generator], canvas.Tile], float]] = {
    Texture.PLAIN: (surfaces.plain, 0.0),
    Texture.ASPHALT: (ground.asphalt, 0.13),
    Texture.CONCRETE: (ground.concrete, 0.12),
    Texture.PAVING: (ground.paving, 0.15),
    Texture.GRASS: (plants.grass, 0.18),
    Texture.DIRT: (ground.dirt, 0.17),
    Texture.FACADE_OFFICE: (facades.facade_office, 0.26),
    Texture.FACADE_FLATS: (facades.facade_flats, 0.24),
    Texture.FACADE_OLD: (facades.facade_old, 0.22),
    Texture.FACADE_HOUSE: (facades.facade_house, 0.2),
    Texture.BRICK: (surfaces.brick, 0.16),
    Texture.PLASTER: (surfaces.plaster, 0.08),
    Texture.ROOF: (surfaces.roof, 0.18),
    Texture.FOLIAGE: (plants.foliage, 0.24),
    Texture.HEDGE_REPEATED: (plants.hedge_repeated, 0.24),
    Texture.BARK: (plants.bark, 0.2),
    Texture.FENCE: (surfaces.fence, 0.22),
    Texture.METAL: (surfaces.metal, 0.16),
    Texture.CAR_SIDE: (vehicles.car_side, 0.28),
    Texture.CAR_FRONT: (vehicles.car_front, 0.28),
    Texture.CAR_TOP: (vehicles.car_top, 0.25),
    Texture.CLOTH: (surfaces.cloth, 0.15),
    Texture.ROCK: (ground.rock, 0.2),
    Texture.SIGN: (surfaces.sign, 0.4),
    Texture.CHECKERBOARD: (surfaces.checkerboard, 0.5),
    Texture.CLOUDS: (surfaces.clouds, 0.18),
    Texture.BLOTCHES: (surfaces.blotches, 0.18),
    Texture.DAPPLE: (plants.dapple, 0.4),
}
"""What draws each texture, and the standard deviation that it is given."""


@cache
def make_textures() -> TexturePyramid:
    """Draw every texture, the same on each call."""
    layers = []
    for texture in Texture:
        draw, spread = _PATTERNS[texture]
        level = _toned(draw(np.random.default_rng(int(texture))), spread)
        levels = [level]
        while len(level) > 1:
            level = canvas.reduced(level)
            levels.append(level)
        layers.append(np.concatenate([level.ravel() for level in levels]))
    texels = np.rint(255 * np.array(layers)).astype(np.uint8)
    texels.setflags(write=False)
    texels_of_level = (SIZE >> np.arange(SIZE.bit_length())) ** 2
    return TexturePyramid(texels, np.cumsum(texels_of_level) - texels_of_level)


def _toned(tile: canvas.Tile, spread: float) -> canvas.Tile:
    """The tile within 0 … 1, of mean 0.5 and, but for what that cuts off, of this standard
    deviation."""
    deviation = tile.std()
    tile = (tile - tile.mean()) * (spread / deviation if deviation > 0 else 0.0)
    shift = 0.5
    for _ in range(8):  # cutting off moves the mean
        shift += 0.5 - float(np.clip(tile + shift, 0, 1).mean())
    return np.clip(tile + shift, 0, 1)
