"""Houses: gabled ones in gardens, and blocks in town."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo_sim.scene.presets.furniture.parts import sloping
from probevo_sim.scene.solids import BOX, Solids, join, solid
from probevo_sim.scene.textures import Texture


class _Facade(NamedTuple):
    """The dimensions of a facade's texture."""

    floors: int
    """Floors of a tile."""
    floor_height: float
    tile_width: float
    """Width of a tile, which has four windows side by side."""


_FACADES = {
    Texture.FACADE_OFFICE: _Facade(4, 3.4, 13.0),
    Texture.FACADE_FLATS: _Facade(4, 3.0, 12.0),
    Texture.FACADE_OLD: _Facade(3, 3.8, 11.0),
}
_GROUND_FLOOR = 3.6
"""Height of the ground floor."""


def house(rng: np.random.Generator) -> Solids:
    """Build a gabled house of two floors, ridge and front along x, about 10 × 8 × 9."""
    # The walls below the eaves.
    length, depth, eaves = rng.uniform([9.0, 7.0, 5.0], [12.0, 9.0, 6.0])
    slope = rng.uniform(0.55, 0.76)
    wall = rng.uniform(0.35, 0.52)
    tiles = rng.uniform(0.2, 0.35)
    walls = solid(
        BOX,
        (length, depth, eaves),
        (0, 0, 0.5 * eaves),
        texture=Texture.FACADE_HOUSE,
        tile_m=[[depth, eaves], [length, eaves], [length, depth]],
        albedo=wall,
        shift_m=(rng.integers(3) / 3.0 * length, 0.0),
    )

    # The roof and the gable under it: two sloping halves each.
    half = 0.5 * depth
    rise = 0.5 * depth * np.tan(slope)
    run = 0.5 * depth / np.cos(slope)
    gable = Texture(rng.choice([Texture.BRICK, Texture.PLASTER, Texture.FENCE]))
    parts = [walls]
    for side in (-1, 1):
        # With this thickness, and slopes of at most 45°, the two halves fill the gable without
        # showing beyond each other's slope.
        middle = (0.0, 0.5 * side * half, eaves + 0.5 * rise)
        roll = -side * slope
        parts.append(
            sloping(
                (length - 0.1, run, half * np.sin(slope)), middle, gable, roll=roll, albedo=wall
            )
        )
        over = (0.0, (0.5 * half + 0.2) * side, eaves + 0.5 * rise - 0.2 * np.tan(slope) + 0.14)
        parts.append(
            sloping(
                (length + 0.8, run + 0.5, 0.14),
                over,
                Texture.ROOF,
                roll=roll,
                tile=3.0,
                albedo=tiles,
            )
        )
    chimney = (rng.uniform(-0.3, 0.3) * length, 0.15 * depth, eaves + 0.8 * rise)
    parts.append(
        solid(BOX, (0.6, 0.6, 2.0), chimney, texture=Texture.BRICK, tile_m=2.0, albedo=0.35)
    )
    return join(parts)


def block(
    rng: np.random.Generator, length: float = 16.0, depth: float = 12.0, floors: int | None = None
) -> Solids:
    """Build a town house along x: ground floor, floors above it, ledges, and boxes on the roof.

    Args:
        rng: source of what differs from house to house.
        length: extent along x.
        depth: extent along y.
        floors: floors above the ground floor; by default 3 to 6.
    """
    # Upper floors, with a facade whose windows are whole.
    front = Texture(rng.choice(np.array(list(_FACADES), dtype=np.int64)))
    facade = _FACADES[front]
    count = int(rng.integers(3, 7)) if floors is None else floors
    height = count * facade.floor_height
    width = 4.0 * length / max(1, round(4.0 * length / facade.tile_width))
    above = solid(
        BOX,
        (length, depth - 0.2, height),
        (0, 0, _GROUND_FLOOR + 0.5 * count * facade.floor_height),
        texture=front,
        tile_m=(width, facade.floor_height * facade.floors),
        albedo=rng.uniform(0.35, 0.55),
        shift_m=(
            0.25 * width * rng.integers(4),
            facade.floor_height * rng.integers(facade.floors),
        ),
    )
    parts = [
        _ground_floor(rng, length, depth, width_of_tile=width),
        above,
        *_doors(rng, length, depth),
    ]

    # Ledges above the ground floor and at the top.
    top = _GROUND_FLOOR
    for thick, out in ((0.3, 0.25), (0.5, 0.4)):
        ledge = (length, depth + 2 * out, thick)
        parts.append(
            solid(
                BOX,
                ledge,
                (0, 0, top),
                texture=Texture.CONCRETE,
                tile_m=3.0,
                albedo=rng.uniform(0.35, 0.55),
            )
        )
        top = _GROUND_FLOOR + height

    # Boxes on the roof.
    for x in rng.uniform(-0.4, 0.4, 2) * length:
        size = rng.uniform([1.5, 1.5, 1.2], [4.0, 4.0, 2.6])
        texture = Texture(rng.choice([Texture.BRICK, Texture.METAL]))
        parts.append(
            solid(BOX, size, (x, 0, top + 0.5 * size[2]), texture=texture, tile_m=3.0, albedo=0.35)
        )
    return join(parts)


def _ground_floor(
    rng: np.random.Generator, length: float, depth: float, width_of_tile: float
) -> Solids:
    """Build the ground floor: shop windows or a plain wall."""
    texture = Texture(
        rng.choice([Texture.BRICK, Texture.CONCRETE, Texture.FACADE_OFFICE, Texture.FACADE_OLD])
    )
    tile = (4.0, 4.0)
    if texture in _FACADES:
        tile = (width_of_tile, _GROUND_FLOOR * _FACADES[texture].floors)
    size = (length, depth, _GROUND_FLOOR)
    middle = (0, 0, 0.5 * _GROUND_FLOOR)
    return solid(BOX, size, middle, texture=texture, tile_m=tile, albedo=rng.uniform(0.3, 0.45))


def _doors(rng: np.random.Generator, length: float, depth: float) -> list[Solids]:
    """Build shop window, door and name board.

    Each passes through the whole house, so that both fronts show it.
    """
    shop = (0.3 * length, depth + 0.16, 2.2)
    board = (rng.uniform(1.5, 4.0), depth + 0.5, 0.6)
    shop_m = rng.uniform(-0.32, -0.2) * length
    door_m = rng.uniform(0.0, 0.15) * length
    board_m = rng.uniform(-0.3, 0.3) * length
    return [
        solid(
            BOX,
            shop,
            (shop_m, 0, 1.5),
            texture=Texture.FACADE_OFFICE,
            tile_m=(1.6 * shop[0], 4 * shop[2]),
            albedo=0.4,
        ),
        solid(
            BOX,
            (1.3, depth + 0.16, 2.5),
            (door_m, 0, 1.25),
            texture=Texture.FACADE_HOUSE,
            tile_m=(9.0, 6.0),
            shift_m=(4.0, 0.3),
        ),
        solid(
            BOX,
            board,
            (board_m, 0, 3.0),
            texture=Texture.SIGN,
            tile_m=(0.5 * board[0], board[2]),
            albedo=0.4,
        ),
    ]
