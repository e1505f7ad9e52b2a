"""Objects that stand on a pavement or along a road, and people who walk there."""

from __future__ import annotations

import numpy as np

from probevo_sim.scene.presets.furniture.parts import sloping
from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture


def person(rng: np.random.Generator) -> Solids:
    """Build a person who walks along x, 1.6 to 1.9 tall."""
    tall = rng.uniform(1.6, 1.9)
    trousers = rng.choice([0.08, 0.15, 0.25])
    coat = rng.choice([0.1, 0.25, 0.45, 0.6])
    stride = rng.uniform(0.15, 0.35)
    cloth = Texture.CLOTH
    # Legs and arms swing against each other.
    legs = [
        sloping(
            (0.17, 0.15, 0.5 * tall),
            (0.0, 0.1 * y, 0.49 * tall),
            cloth,
            pitch=y * stride,
            tile=0.6,
            albedo=trousers,
        )
        for y in (-1.0, 1.0)
    ]
    trunk = solid(
        ELLIPSOID,
        (0.3, 0.46, 0.5 * tall),
        (0, 0, 0.63 * tall),
        texture=cloth,
        tile_m=0.7,
        albedo=coat,
    )
    arms = [
        sloping(
            (0.12, 0.11, 0.4 * tall),
            (0, 0.23 * y, 0.82 * tall),
            cloth,
            pitch=-y * stride,
            tile=0.5,
            albedo=coat,
        )
        for y in (-1.0, 1.0)
    ]
    head = solid(
        ELLIPSOID,
        (0.22, 0.18, 0.145 * tall),
        (0, 0, 0.92 * tall),
        texture=Texture.BLOTCHES,
        tile_m=0.4,
        albedo=0.35,
    )
    return join([*legs, trunk, *arms, head])


def lamp_post(height: float = 6.5) -> Solids:
    """Build a pole with an arm to the left and a lamp at its end."""
    pole = solid(
        BOX,
        (0.14, 0.14, height),
        (0, 0, 0.5 * height),
        texture=Texture.METAL,
        tile_m=1.5,
        albedo=0.3,
    )
    foot = solid(
        BOX, (0.26, 0.26, 0.9), (0, 0, 0.45), texture=Texture.METAL, tile_m=0.9, albedo=0.2
    )
    arm = solid(
        BOX, (0.08, 1.7, 0.08), (0, 0.85, height), texture=Texture.METAL, tile_m=1.0, albedo=0.3
    )
    lamp = solid(
        BOX,
        (0.3, 0.7, 0.14),
        (0, 1.7, height - 0.05),
        texture=Texture.METAL,
        tile_m=0.5,
        albedo=0.6,
    )
    return join([pole, foot, arm, lamp])


def traffic_light() -> Solids:
    """Build a pole with a dark case of three lamps that faces back along x."""
    pole = solid(
        BOX, (0.12, 0.12, 3.0), (0, 0, 1.5), texture=Texture.METAL, tile_m=1.0, albedo=0.35
    )
    case = solid(
        BOX, (0.25, 0.34, 0.95), (-0.1, 0, 2.9), texture=Texture.PLAIN, tile_m=1.0, albedo=0.06
    )
    lamps = [
        solid(
            ELLIPSOID, (0.12, 0.22, 0.22), (-0.2, 0, z), texture=Texture.PLAIN, tile_m=1.0, albedo=a
        )
        for z, a in ((3.2, 0.8), (2.9, 0.15), (2.6, 0.15))
    ]
    return join([pole, case, *lamps])


def road_sign(rng: np.random.Generator) -> Solids:
    """Build a board on a pole that faces back along x."""
    high = rng.uniform(2.2, 2.6)
    wide = rng.uniform(0.55, 0.8)
    pole = solid(
        BOX, (0.07, 0.07, high), (0, 0, 0.5 * high), texture=Texture.METAL, tile_m=1.0, albedo=0.4
    )
    board = solid(
        BOX,
        (0.05, wide, 1.1 * wide),
        (-0.05, 0, high - 0.5 * wide),
        texture=Texture.SIGN,
        tile_m=[[wide, 1.1 * wide], [1.0, 1.0], [1.0, 1.0]],
    )
    return join([pole, board])


def bench() -> Solids:
    """Build a bench of slats on two feet, 1.8 along x, its back to the left."""
    seat = solid(
        BOX, (1.8, 0.45, 0.06), (0, 0, 0.45), texture=Texture.FENCE, tile_m=(0.9, 0.45), albedo=0.3
    )
    back = solid(
        BOX,
        (1.8, 0.06, 0.45),
        (0, 0.22, 0.72),
        texture=Texture.FENCE,
        tile_m=(0.9, 0.45),
        albedo=0.3,
    )
    feet = [
        solid(
            BOX, (0.1, 0.4, 0.43), (x, 0, 0.21), texture=Texture.CONCRETE, tile_m=1.0, albedo=0.35
        )
        for x in (-0.7, 0.7)
    ]
    return join([seat, back, *feet])


def litter_bin(rng: np.random.Generator) -> Solids:
    """Build a wheeled rubbish bin."""
    grey = rng.choice([0.1, 0.2, 0.35])
    body = solid(
        BOX,
        (0.55, 0.6, 0.95),
        (0, 0, 0.5),
        texture=Texture.PLASTER,
        tile_m=0.8,
        albedo=grey,
        contrast=0.9,
    )
    lid = solid(
        BOX, (0.6, 0.65, 0.1), (0, 0, 1.02), texture=Texture.METAL, tile_m=0.6, albedo=1.4 * grey
    )
    return join([body, lid])


def box(rng: np.random.Generator) -> Solids:
    """Build a cabinet of the telephone company, with posters."""
    size = rng.uniform([0.8, 0.4, 1.1], [1.3, 0.5, 1.4])
    case = solid(
        BOX,
        size,
        (0, 0, 0.5 * size[2]),
        texture=Texture.METAL,
        tile_m=1.1,
        albedo=rng.uniform(0.3, 0.5),
    )
    poster = (0.6 * size[0], size[1] + 0.01, 0.5 * size[2])
    posters = solid(
        BOX, poster, (0, 0, 0.6 * size[2]), texture=Texture.SIGN, tile_m=0.5, albedo=0.5
    )
    return join([case, posters])


def fence(length: float, height: float = 1.1) -> Solids:
    """Build a fence of wooden slats along x."""
    return solid(
        BOX,
        (length, 0.06, height),
        (0, 0, 0.5 * height),
        texture=Texture.FENCE,
        tile_m=(1.6, height),
        albedo=0.4,
    )


def guard_rail(length: float) -> Solids:
    """Build a rail along x on posts 4 apart."""
    rail = solid(
        BOX,
        (length, 0.08, 0.32),
        (0, 0, 0.62),
        texture=Texture.METAL,
        tile_m=(2.0, 0.64),
        albedo=0.45,
    )
    places = np.arange(-0.5 * length + 1.0, 0.5 * length, 4.0)
    posts = [
        solid(BOX, (0.1, 0.1, 0.6), (x, 0, 0.3), texture=Texture.METAL, tile_m=1.0, albedo=0.3)
        for x in places
    ]
    return join([rail, *posts])


def kerb(length: float) -> Solids:
    """Build a kerbstone along x, 0.12 high."""
    return solid(
        BOX,
        (length, 0.18, 0.12),
        (0, 0, 0.06),
        texture=Texture.CONCRETE,
        tile_m=(2.0, 0.6),
        albedo=0.45,
    )
