"""What the sun adds to what is seen, and what keeps it away: solids, and leaves in the wind."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled
from probevo.simulation.scene.candidates import SHADOW_CELL_M, Candidates
from probevo.simulation.scene.intersection import Rays, enter_box, enter_ellipsoid
from probevo.simulation.scene.scene_arrays import Posed, SceneArrays
from probevo.simulation.scene.solids import BOX
from probevo.simulation.scene.texture_filter import sample_square
from probevo.simulation.scene.textures import SIZE

CLEARANCE_M = 1e-3
"""What casts a shadow is further than this from the place that it shades."""
LEAVES_TEXELS_PER_M, LEAVES_DARKNESS = SIZE / 7.0, 0.5
LEAVES_BELOW_M = 0.5
"""Shadows of leaves fall on what is lower than this."""
WIND_M_S = (0.9, 0.45)
"""With which they wander over the ground."""


@compiled
def add_sunlight(scene: SceneArrays, posed: Posed, casters: Candidates, time_s: float, rays: Rays) -> None:
    """Complete the radiance of a packet by the light of the sun, as far as it comes through."""
    hit, radiance, sunlit, place_m, size_m = rays.hit, rays.radiance, rays.sunlit, rays.place_m, rays.size_m
    if scene.shadow == 0.0:
        for k in range(len(radiance)):
            radiance[k] += sunlit[k]
        return
    C, origin, half, shape = posed.C_solid_world, posed.world_in_solid_m, scene.half_size_m, scene.shape
    first, solids, to_sun = casters.first, casters.solids, scene.to_sun
    texels, level_start = scene.texels, scene.level_start
    for k in range(len(radiance)):
        if sunlit[k] <= 0.0:
            continue
        # Where the shadow of this place falls on the ground: what shades it shades that place too.
        x, y, z = place_m[0, k], place_m[1, k], place_m[2, k]
        east, north = x - to_sun[0] / to_sun[2] * z, y - to_sun[1] / to_sun[2] * z
        column = math.floor((east - casters.corner[0]) / SHADOW_CELL_M)
        row = math.floor((north - casters.corner[1]) / SHADOW_CELL_M)
        share = 1.0
        if 0 <= column < casters.columns and 0 <= row < casters.columns:
            cell = row * casters.columns + column
            for j in range(first[cell], first[cell + 1]):
                if solids[j] != hit[k] and _shades(C, origin, half, shape, solids[j], to_sun, x, y, z):
                    share = 1.0 - scene.shadow
                    break
        if share == 1.0 and z < LEAVES_BELOW_M:
            step = size_m[k] * LEAVES_TEXELS_PER_M
            a, b = (
                (east - WIND_M_S[0] * time_s) * LEAVES_TEXELS_PER_M,
                (north - WIND_M_S[1] * time_s) * LEAVES_TEXELS_PER_M,
            )
            leaves = sample_square(texels, scene.dapple, level_start, a, b, step)
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
    ox, dx = _turn(C_solid_world, i, 0, x, y, z), _turn(C_solid_world, i, 0, to_sun[0], to_sun[1], to_sun[2])
    oy, dy = _turn(C_solid_world, i, 1, x, y, z), _turn(C_solid_world, i, 1, to_sun[0], to_sun[1], to_sun[2])
    oz, dz = _turn(C_solid_world, i, 2, x, y, z), _turn(C_solid_world, i, 2, to_sun[0], to_sun[1], to_sun[2])
    ox, oy, oz = ox + origin[i, 0], oy + origin[i, 1], oz + origin[i, 2]
    if shape[i] == BOX:
        enter = enter_box(half[i, 0], half[i, 1], half[i, 2], ox, oy, oz, dx, dy, dz)
    else:
        enter = enter_ellipsoid(half[i, 0], half[i, 1], half[i, 2], ox, oy, oz, dx, dy, dz)
    return CLEARANCE_M < enter < np.inf


@compiled
def _turn(C: FloatArray, i: int, row: int, x: float, y: float, z: float) -> float:
    """One component of C[i] (x, y, z)."""
    turned: float = C[i, row, 0] * x + C[i, row, 1] * y + C[i, row, 2] * z
    return turned
