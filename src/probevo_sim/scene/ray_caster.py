"""Rays through an image, one patch of it at a time: what each one hits, and how bright it is there."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray
from probevo.compiled import compiled
from probevo_sim.scene.candidates import PATCH_PX, Candidates
from probevo_sim.scene.intersection import Rays, hit_ground, hit_solid
from probevo_sim.scene.scene_arrays import Posed, SceneArrays
from probevo_sim.scene.shading import shade_ground, shade_sky, shade_solid
from probevo_sim.scene.sunlight import add_sunlight


@compiled
def add_radiance(
    scene: SceneArrays,
    posed: Posed,
    lists: Candidates,
    casters: Candidates,
    time_s: float,
    offsets_px: FloatArray,
    footprint_px: float,
    image: NDArray[np.float32],
) -> None:
    """Add to each pixel the radiance of one ray for each of the offsets from its centre, [K, 2]."""
    rays = _packet()
    for top in range(0, image.shape[0], PATCH_PX):
        for left in range(0, image.shape[1], PATCH_PX):
            cell = top // PATCH_PX * lists.columns + left // PATCH_PX
            for k in range(len(offsets_px)):
                end = _cast(
                    scene,
                    posed,
                    lists,
                    cell=cell,
                    left_px=left + offsets_px[k, 0],
                    top_px=top + offsets_px[k, 1],
                    rays=rays,
                )
                shade_sky(scene, posed, footprint_px, rays=rays)
                shade_ground(scene, posed, footprint_px, rays=rays)
                for j in range(lists.first[cell], end):
                    shade_solid(
                        scene,
                        posed,
                        time_s,
                        footprint_px=footprint_px,
                        i=lists.solids[j],
                        rays=rays,
                    )
                add_sunlight(scene, posed, casters, time_s=time_s, rays=rays)
                for row in range(top, min(top + PATCH_PX, image.shape[0])):
                    for column in range(left, min(left + PATCH_PX, image.shape[1])):
                        image[row, column] += rays.radiance[(row - top) * PATCH_PX + column - left]


@compiled
def first_hits(
    scene: SceneArrays,
    posed: Posed,
    lists: Candidates,
    depth_m: FloatArray,
    hits: NDArray[np.int32],
) -> None:
    """Depth along the camera's axis and what is hit (a solid, GROUND or SKY) at the centre of each
    pixel."""
    rays = _packet()
    for top in range(0, depth_m.shape[0], PATCH_PX):
        for left in range(0, depth_m.shape[1], PATCH_PX):
            cell = top // PATCH_PX * lists.columns + left // PATCH_PX
            _cast(scene, posed, lists, cell=cell, left_px=float(left), top_px=float(top), rays=rays)
            for row in range(top, min(top + PATCH_PX, depth_m.shape[0])):
                for column in range(left, min(left + PATCH_PX, depth_m.shape[1])):
                    k = (row - top) * PATCH_PX + column - left
                    depth_m[row, column] = rays.depth_m[k]
                    hits[row, column] = rays.hit[k]


@compiled
def _packet() -> Rays:
    """Rays for one patch, row by row."""
    n = PATCH_PX * PATCH_PX
    return Rays(
        x=np.empty(n),
        y=np.empty(n),
        depth_m=np.empty(n),
        hit=np.empty(n, np.int64),
        radiance=np.empty(n),
        sunlit=np.empty(n),
        place_m=np.empty((3, n)),
        size_m=np.empty(n),
    )


@compiled
def _cast(
    scene: SceneArrays,
    posed: Posed,
    lists: Candidates,
    cell: int,
    left_px: float,
    top_px: float,
    rays: Rays,
) -> int:
    """Point the packet at the patch whose first ray goes through (left, top), and find what it
    hits.

    Returns where in ``lists.solids`` those end that were looked at: what comes after lies behind
    all that is seen.
    """
    for row in range(PATCH_PX):
        for column in range(PATCH_PX):
            rays.x[row * PATCH_PX + column] = (left_px + column - posed.cu_px) / posed.focal_px
            rays.y[row * PATCH_PX + column] = (top_px + row - posed.cv_px) / posed.focal_px
    hit_ground(posed, rays)
    j = int(lists.first[cell])
    end = int(lists.first[cell + 1])
    while j < end and lists.nearest_m[lists.solids[j]] <= rays.depth_m.max():
        hit_solid(scene, posed, lists.solids[j], rays=rays)
        j += 1
    return j
