"""What the sun adds to what is seen, and what keeps it away: solids, and leaves in the wind."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled
from probevo_sim.scene.candidates import SHADOW_CELL_M, Candidates
from probevo_sim.scene.intersection import Rays, enter_box, enter_ellipsoid
from probevo_sim.scene.scene_arrays import Posed, SceneArrays
from probevo_sim.scene.solids import BOX
from probevo_sim.scene.texture_filter import sample_square
from probevo_sim.scene.textures import SIZE

CLEARANCE_M = 1e-3
"""What casts a shadow is further than this from the place that it shades."""
LEAVES_TEXELS_PER_M = SIZE / 7.0
LEAVES_DARKNESS = 0.5
LEAVES_BELOW_M = 0.5
"""Shadows of leaves fall on what is lower than this."""
WIND_M_S = (0.9, 0.45)
"""With which they wander over the ground."""


@compiled
def add_sunlight(
    scene: SceneArrays, posed: Posed, casters: Candidates, time_s: float, rays: Rays
) -> None:
    """Complete the radiance of a packet by the light of the sun, as far as it comes through."""
    hit = rays.hit
    radiance = rays.radiance
    sunlit = rays.sunlit
    place_m = rays.place_m
    size_m = rays.size_m
    if scene.shadow == 0.0:
        for k in range(len(radiance)):
            radiance[k] += sunlit[k]
        return
    C = posed.C_solid_world
    origin = posed.world_in_solid_m
    half = scene.half_size_m
    shape = scene.shape
    first = casters.first
    solids = casters.solids
    to_sun = scene.to_sun
    texels = scene.texels
    level_start = scene.level_start
    for k in range(len(radiance)):
        if sunlit[k] <= 0.0:
            continue
        # Where the shadow of this place falls on the ground: what shades it shades that place too.
        x = place_m[0, k]
        y = place_m[1, k]
        z = place_m[2, k]
        east = x - to_sun[0] / to_sun[2] * z
        north = y - to_sun[1] / to_sun[2] * z
        column = math.floor((east - casters.corner[0]) / SHADOW_CELL_M)
        row = math.floor((north - casters.corner[1]) / SHADOW_CELL_M)
        share = 1.0
        if 0 <= column < casters.columns and 0 <= row < casters.columns:
            cell = row * casters.columns + column
            for j in range(first[cell], first[cell + 1]):
                if solids[j] != hit[k] and _shades(
                    C, origin, half, shape=shape, i=solids[j], to_sun=to_sun, x=x, y=y, z=z
                ):
                    share = 1.0 - scene.shadow
                    break
        if share == 1.0 and z < LEAVES_BELOW_M:
            step = size_m[k] * LEAVES_TEXELS_PER_M
            a = (east - WIND_M_S[0] * time_s) * LEAVES_TEXELS_PER_M
            b = (north - WIND_M_S[1] * time_s) * LEAVES_TEXELS_PER_M
            leaves = sample_square(texels, scene.dapple, level_start, a=a, b=b, side=step)
            share = 1.0 - 0.5 * LEAVES_DARKNESS * scene.shadow * (1.0 - leaves)
        radiance[k] += share * sunlit[k]


@compiled
def _shades(
    C_solid_world: FloatArray,
    origin: FloatArray,
    half: FloatArray,
    shape: IntArray,
    i: int,
    to_sun: FloatArray,
    x: float,
    y: float,
    z: float,
) -> bool:
    """Whether solid ``i`` lies between a place of the world and the sun."""
    ox = _turn(C_solid_world, i, 0, x=x, y=y, z=z)
    dx = _turn(C_solid_world, i, 0, x=to_sun[0], y=to_sun[1], z=to_sun[2])
    oy = _turn(C_solid_world, i, 1, x=x, y=y, z=z)
    dy = _turn(C_solid_world, i, 1, x=to_sun[0], y=to_sun[1], z=to_sun[2])
    oz = _turn(C_solid_world, i, 2, x=x, y=y, z=z)
    dz = _turn(C_solid_world, i, 2, x=to_sun[0], y=to_sun[1], z=to_sun[2])
    ox = ox + origin[i, 0]
    oy = oy + origin[i, 1]
    oz = oz + origin[i, 2]
    if shape[i] == BOX:
        enter = enter_box(
            half[i, 0], half[i, 1], half[i, 2], ox=ox, oy=oy, oz=oz, dx=dx, dy=dy, dz=dz
        )
    else:
        enter = enter_ellipsoid(
            half[i, 0], half[i, 1], half[i, 2], ox=ox, oy=oy, oz=oz, dx=dx, dy=dy, dz=dz
        )
    return CLEARANCE_M < enter < np.inf


@compiled
def _turn(C: FloatArray, i: int, row: int, x: float, y: float, z: float) -> float:
    """One component of C[i] (x, y, z)."""
    turned: float = C[i, row, 0] * x + C[i, row, 1] * y + C[i, row, 2] * z
    return turned
