"""Sunlight: what the sun adds to the radiance of a hit, and what occludes it, as compiled loops.

Solids cast shadows; so do leaves, which are a texture on the ground that sways in the wind.
"""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled
from probevo_sim.scene.candidates import SHADOW_CELL_M, Candidates
from probevo_sim.scene.intersection_numba import Rays, Vector, enter_box, enter_ellipsoid
from probevo_sim.scene.scene_arrays import SceneArrays, View
from probevo_sim.scene.shading_numba import SWAY_M, SWAY_RAD_S
from probevo_sim.scene.solids import BOX
from probevo_sim.scene.stochastic_tiling_numba import sample_unrepeated
from probevo_sim.scene.texture_filter_numba import Footprint
from probevo_sim.scene.textures import SIZE

CLEARANCE_M = 1e-3
"""An occluder is farther than this from the place that it shades."""
LEAVES_TEXELS_PER_M = SIZE / 7.0
"""Scale of the texture of leaves on the ground."""
LEAVES_DARKNESS = 0.5
"""Share of the sunlight that leaves take away where they are densest."""
LEAVES_BELOW_M = 0.5
"""Shadows of leaves fall on what is lower than this."""
WIND = (0.89, 0.45)
"""Direction in which the shadows of leaves sway over the ground, along x and y of the world."""
GUST_M_S = 3.0
"""Velocity of the gusts over the ground: how fast the phase of the sway travels."""


@compiled
def add_sunlight(
    scene: SceneArrays, view: View, occluders: Candidates, time_s: float, rays: Rays
) -> None:
    """Add the light of the sun to the radiance of a packet, as far as nothing occludes it.

    Args:
        scene: solids, textures, and the darkness of shadows.
        view: poses of the solids at this time.
        occluders: the solids that may cast a shadow on each cell of the ground.
        time_s: sways the shadows of leaves.
        rays: shaded packet; its ``radiance`` is completed.
    """
    hit = rays.hit
    radiance = rays.radiance
    sun_radiance = rays.sun_radiance
    place_m = rays.place_m
    footprint_m = rays.footprint_m
    if scene.shadow == 0.0:
        for k in range(len(radiance)):
            radiance[k] += sun_radiance[k]
        return
    first = occluders.first
    solids = occluders.solids
    to_sun = scene.to_sun
    for k in range(len(radiance)):
        if sun_radiance[k] <= 0.0:
            continue
        # Where the shadow of this place falls on the ground: an occluder of the place occludes
        # that point, too, and is in the list of its cell.
        x = place_m[0, k]
        y = place_m[1, k]
        z = place_m[2, k]
        east = x - to_sun[0] / to_sun[2] * z
        north = y - to_sun[1] / to_sun[2] * z
        column = math.floor((east - occluders.corner[0]) / SHADOW_CELL_M)
        row = math.floor((north - occluders.corner[1]) / SHADOW_CELL_M)

        # Cast a shadow ray against each occluder, but not against the solid that was hit itself.
        visibility = 1.0
        if 0 <= column < occluders.columns and 0 <= row < occluders.columns:
            cell = row * occluders.columns + column
            for j in range(first[cell], first[cell + 1]):
                if solids[j] != hit[k] and _occludes(scene, view, solids[j], place=(x, y, z)):
                    visibility = 1.0 - scene.shadow
                    break

        # Low places in the sun lie under leaves, which sway in the gusts.
        if visibility == 1.0 and z < LEAVES_BELOW_M:
            travelled_s = (WIND[0] * east + WIND[1] * north) / GUST_M_S
            sway_m = SWAY_M * math.sin(SWAY_RAD_S * (time_s - travelled_s))
            side = footprint_m[k] * LEAVES_TEXELS_PER_M
            footprint = Footprint(
                a=(east - WIND[0] * sway_m) * LEAVES_TEXELS_PER_M,
                b=(north - WIND[1] * sway_m) * LEAVES_TEXELS_PER_M,
                a_by_u=side,
                a_by_v=0.0,
                b_by_u=0.0,
                b_by_v=side,
            )
            leaves = sample_unrepeated(scene.mipmaps, scene.dapple, 1, footprint=footprint)
            visibility = 1.0 - 0.5 * LEAVES_DARKNESS * scene.shadow * (1.0 - leaves)
        radiance[k] += visibility * sun_radiance[k]


@compiled
def _occludes(scene: SceneArrays, view: View, i: int, place: Vector) -> bool:
    """Return whether solid ``i`` lies between a place of the world and the sun."""
    # The shadow ray in the solid's own axes.
    C = view.C_solid_world
    to_sun = (scene.to_sun[0], scene.to_sun[1], scene.to_sun[2])
    world = view.world_in_solid_m
    origin = (
        _rotated(C, i, 0, vector=place) + world[i, 0],
        _rotated(C, i, 1, vector=place) + world[i, 1],
        _rotated(C, i, 2, vector=place) + world[i, 2],
    )
    direction = (
        _rotated(C, i, 0, vector=to_sun),
        _rotated(C, i, 1, vector=to_sun),
        _rotated(C, i, 2, vector=to_sun),
    )
    half = scene.half_size_m
    half_size = (half[i, 0], half[i, 1], half[i, 2])
    if scene.shape[i] == BOX:
        enter = enter_box(half_size, origin, direction)
    else:
        enter = enter_ellipsoid(half_size, origin, direction)
    return CLEARANCE_M < enter < np.inf


@compiled
def _rotated(C: FloatArray, i: int, row: int, vector: Vector) -> float:
    """Return component ``row`` of C[i] · vector, with C [N, 3, 3]."""
    rotated: float = C[i, row, 0] * vector[0] + C[i, row, 1] * vector[1] + C[i, row, 2] * vector[2]
    return rotated
