"""The textures of a scene: procedural grey tiles that wrap around, with their mip levels."""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import IntArray
from probevo_sim.scene.texture_patterns import canvas, facades, ground, plants, surfaces, vehicles

SIZE = canvas.SIDE
"""Texels along one side of a tile at mip level 0, the finest."""


class Texture(IntEnum):
    """The name of every texture; its value is the layer in ``Mipmaps``."""

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


class Mipmaps(NamedTuple):
    """All L textures with all their mip levels, read-only.

    A tile wraps around at its edges. Its mean is 0.5, which is stored as 127.5.
    """

    texels: NDArray[np.uint8]
    """[L, M]: of each texture the mip levels one after another, level 0 first, row-major.

    The column is the first texture coordinate, the row the second. Rows grow upwards on a wall:
    row 0 is the foot of a facade.
    """
    level_start: IntArray
    """Index of the first texel of each level, [n_levels]; level l has (SIZE >> l)² texels."""


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
"""The function that draws each texture, and the standard deviation that the texture is given."""

_LATTICE_TEXELS = {Texture.CONCRETE: SIZE // 2, Texture.PAVING: SIZE // 4}
"""Distance after which the joints of textures repeat that have any."""


def lattice_texels(textures: IntArray) -> IntArray:
    """Return after how many texels the joints of each texture repeat, [N]: 1 without joints."""
    return np.array([_LATTICE_TEXELS.get(Texture(layer), 1) for layer in textures])


@cache
def make_textures() -> Mipmaps:
    """Draw every texture with its mip levels, the same on each call."""
    layers = []
    for texture in Texture:
        draw, deviation = _PATTERNS[texture]
        level = _normalized(draw(np.random.default_rng(int(texture))), deviation)

        # Each level is the 2×2 box mean of the one before, down to a single texel.
        levels = [level]
        while len(level) > 1:
            level = canvas.downsampled(level)
            levels.append(level)
        layers.append(np.concatenate([level.ravel() for level in levels]))
    texels = np.rint(255 * np.array(layers)).astype(np.uint8)
    texels.setflags(write=False)  # the result is cached, and so shared by all callers
    texels_of_level = (SIZE >> np.arange(SIZE.bit_length())) ** 2
    return Mipmaps(texels, level_start=np.cumsum(texels_of_level) - texels_of_level)


def _normalized(tile: canvas.Tile, deviation: float) -> canvas.Tile:
    """Return the tile within 0 … 1, with mean 0.5 and, before clipping, this standard deviation."""
    drawn_deviation = tile.std()
    scale = deviation / drawn_deviation if drawn_deviation > 0 else 0.0
    tile = (tile - tile.mean()) * scale
    shift = 0.5
    for _ in range(8):  # clipping moves the mean, so the shift is found by iteration
        shift += 0.5 - float(np.clip(tile + shift, 0, 1).mean())
    return np.clip(tile + shift, 0, 1)
