"""Vehicles other than passenger cars and vans, and the one that carries the cameras."""

from __future__ import annotations

import numpy as np

from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture

_COACHWORK = (Texture.CAR_FRONT, Texture.CAR_SIDE, Texture.CAR_TOP)


def lorry(rng: np.random.Generator) -> Solids:
    """Build a lorry, 10 m long, 2.5 m wide and 3.6 m high."""
    size_m = (2.1, 2.45, 2.7)
    cab = solid(
        BOX,
        size_m,
        (3.95, 0, 1.75),
        texture=_COACHWORK,
        tile_m=[[2.45, 2.7], [4.2, 2.7], [2.1, 2.45]],
        albedo=rng.uniform(0.25, 0.7),
    )
    frame = solid(
        BOX, (9.0, 0.9, 0.5), (-0.3, 0, 0.75), texture=Texture.METAL, tile_m=1.5, albedo=0.12
    )
    return join(
        [
            cab,
            frame,
            _load((7.6, 2.5, 2.6), (-1.2, 0, 2.3), rng),
            *_wheels((-3.8, -2.6, 3.6), 2.52, 1.0),
        ]
    )


def bus(rng: np.random.Generator) -> Solids:
    """Build a town bus, 11 m long, 2.5 m wide and 3.1 m high, with windows and advertisements."""
    paint = rng.uniform(0.3, 0.65)
    shift_m = rng.uniform(0.0, 10.0, 2)
    body = solid(
        BOX,
        (11.0, 2.5, 2.75),
        (0, 0, 1.72),
        texture=(Texture.CAR_FRONT, Texture.METAL, Texture.METAL),
        tile_m=2.75,
        albedo=paint,
    )
    glass = (Texture.CAR_TOP, Texture.FACADE_OFFICE, Texture.METAL)
    windows = solid(
        BOX,
        (10.4, 2.54, 0.95),
        (-0.2, 0, 2.2),
        texture=glass,
        tile_m=[[2.5, 0.95], [5.2, 3.8], [3.0, 3.0]],
        albedo=0.2,
        shift_m=shift_m,
    )
    board = solid(
        BOX,
        (3.0, 2.56, 0.8),
        (rng.uniform(-2.5, 2.5), 0, 1.15),
        texture=Texture.SIGN,
        tile_m=[1.5, 0.8],
        albedo=0.5,
    )
    return join([body, windows, board, *_wheels((-3.2, 3.4), 2.54, 0.95)])


def field_rover(rng: np.random.Generator) -> Solids:
    """Build a planetary rover, 1.7 m long and 1.6 m high.

    It is a box on six wheels with a solar panel and a mast.
    """
    body = solid(
        BOX,
        (1.3, 0.8, 0.4),
        (0, 0, 0.6),
        texture=Texture.METAL,
        tile_m=0.7,
        albedo=rng.uniform(0.4, 0.7),
    )
    panel = solid(
        BOX,
        (1.5, 1.3, 0.05),
        (-0.1, 0, 0.86),
        texture=Texture.FACADE_OFFICE,
        tile_m=1.0,
        albedo=0.2,
    )
    mast = solid(
        BOX, (0.08, 0.08, 0.7), (0.5, 0, 1.2), texture=Texture.METAL, tile_m=0.5, albedo=0.6
    )
    head = solid(
        BOX, (0.18, 0.4, 0.16), (0.5, 0, 1.55), texture=Texture.SIGN, tile_m=0.4, albedo=0.5
    )
    return join([body, panel, mast, head, *_wheels((-0.6, 0.0, 0.6), 1.25, 0.45)])


def own_vehicle() -> Solids:
    """Build the vehicle that carries the cameras, which is not seen but casts a shadow.

    It is a van with a rack, a mast and antennas on its roof. Its origin lies on the ground under
    the camera, which looks out above the windscreen.
    """
    boxes = [
        ((4.6, 1.9, 1.1), (-1.3, 0.0, 0.75)),
        ((3.0, 1.7, 0.45), (-2.0, 0.0, 1.45)),
        ((1.6, 1.5, 0.1), (-1.6, 0.0, 1.95)),
        ((0.12, 0.12, 1.5), (-1.1, 0.55, 2.7)),
        ((0.5, 0.9, 0.12), (-1.1, 0.35, 3.2)),
        ((0.1, 0.1, 1.0), (-2.2, -0.5, 2.4)),
    ]
    return join(
        solid(BOX, size_m, center_m, texture=Texture.PLAIN, tile_m=1.0, seen=False)
        for size_m, center_m in boxes
    )


def _load(
    size_m: tuple[float, float, float],
    center_m: tuple[float, float, float],
    rng: np.random.Generator,
) -> Solids:
    """Build the box behind a cab, with a firm's board on its sides."""
    texture = Texture(rng.choice([Texture.METAL, Texture.FENCE, Texture.CLOTH]))
    box = solid(
        BOX,
        size_m,
        center_m,
        texture=texture,
        tile_m=2.2,
        albedo=rng.uniform(0.3, 0.65),
        shift_m=rng.uniform(0.0, 5.0, 2),
    )
    board_m = (0.5 * size_m[0], size_m[1] + 0.03, 0.45 * size_m[2])
    tile_m = [[0.8 * size_m[1], board_m[2]], [board_m[0], board_m[2]], [1.0, 1.0]]
    side = solid(BOX, board_m, center_m, texture=Texture.SIGN, tile_m=tile_m, albedo=0.5)
    door_m = (size_m[0] + 0.03, 0.8 * size_m[1], board_m[2])
    door = solid(BOX, door_m, center_m, texture=Texture.SIGN, tile_m=tile_m, albedo=0.5)
    return join([box, side, door])


def _wheels(axles_m: tuple[float, ...], track_m: float, diameter_m: float) -> list[Solids]:
    """Build a pair of wheels with bright rims for each axle.

    Args:
        axles_m: place of each axle along x.
        track_m: width over the tyres.
        diameter_m: of the tyres.
    """
    wheels = []
    for x in axles_m:
        for side in (-0.5, 0.5):
            tyre = (x, side * (track_m - 0.3), 0.5 * diameter_m)
            rim = (x, side * (track_m - 0.2), 0.5 * diameter_m)
            wheels.append(
                solid(
                    ELLIPSOID,
                    (diameter_m, 0.3, diameter_m),
                    tyre,
                    texture=Texture.ROCK,
                    tile_m=0.5,
                    albedo=0.07,
                )
            )
            rim_m = 0.55 * diameter_m
            wheels.append(
                solid(
                    ELLIPSOID,
                    (rim_m, 0.24, rim_m),
                    rim,
                    texture=Texture.BLOTCHES,
                    tile_m=0.4,
                    albedo=0.35,
                )
            )
    return wheels
