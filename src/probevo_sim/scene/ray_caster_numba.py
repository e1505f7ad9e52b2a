"""Rays through an image, patch by patch: what each hits and its radiance, as compiled loops."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray
from probevo.compiled import compiled
from probevo_sim.scene.candidates import PATCH_PX, Candidates
from probevo_sim.scene.intersection_numba import Rays, hit_ground, hit_solid
from probevo_sim.scene.scene_arrays import SceneArrays, View
from probevo_sim.scene.shading_numba import shade_ground, shade_sky, shade_solid
from probevo_sim.scene.sunlight_numba import add_sunlight


class PixelSampling(NamedTuple):
    """The rays through each pixel."""

    offsets_px: FloatArray
    """(u, v) of each ray from the centre of the pixel, [K, 2]."""
    footprint_px: float
    """Side of the square over which each ray sees the mean of a texture."""


@compiled
def add_radiance(
    scene: SceneArrays,
    view: View,
    candidates: Candidates,
    occluders: Candidates,
    time_s: float,
    sampling: PixelSampling,
    image: NDArray[np.float32],
) -> None:
    """Add to each pixel of an image the radiance of its rays.

    Args:
        scene: what there is to see.
        view: from where, and where the solids are.
        candidates: the solids that each patch of the image may show.
        occluders: the solids that may cast a shadow on each cell of the ground.
        time_s: moves the leaves in the wind.
        sampling: the rays of a pixel.
        image: radiance, [height, width]; 1 is white.
    """
    offsets_px = sampling.offsets_px
    footprint_px = sampling.footprint_px
    rays = _packet(image.shape[0])
    for top in range(0, image.shape[0], PATCH_PX):
        for left in range(0, image.shape[1], PATCH_PX):
            cell = top // PATCH_PX * candidates.columns + left // PATCH_PX
            for k in range(len(offsets_px)):
                # Find the nearest hit of each ray of the patch, then shade the hits by kind.
                end = _cast(
                    scene,
                    view,
                    candidates,
                    cell=cell,
                    left_px=left + offsets_px[k, 0],
                    top_px=top + offsets_px[k, 1],
                    rays=rays,
                )
                shade_sky(scene, view, footprint_px, rays=rays)
                shade_ground(scene, view, footprint_px, rays=rays)
                for j in range(candidates.first[cell], end):
                    shade_solid(
                        scene,
                        view,
                        time_s,
                        footprint_px=footprint_px,
                        i=candidates.solids[j],
                        rays=rays,
                    )
                add_sunlight(scene, view, occluders, time_s=time_s, rays=rays)
                # Patches at the right and lower border reach beyond the image.
                for row in range(top, min(top + PATCH_PX, image.shape[0])):
                    for column in range(left, min(left + PATCH_PX, image.shape[1])):
                        image[row, column] += rays.radiance[(row - top) * PATCH_PX + column - left]


@compiled
def first_hits(
    scene: SceneArrays,
    view: View,
    candidates: Candidates,
    depth_m: FloatArray,
    hits: NDArray[np.int32],
) -> None:
    """Fill in what the ray through the centre of each pixel hits first, and at what depth.

    Args:
        scene: what there is to see.
        view: from where, and where the solids are.
        candidates: the solids that each patch of the image may show.
        depth_m: filled with the depth along the camera's axis, [height, width].
        hits: filled with the index of a solid, GROUND or SKY, [height, width].
    """
    rays = _packet(depth_m.shape[0])
    for top in range(0, depth_m.shape[0], PATCH_PX):
        for left in range(0, depth_m.shape[1], PATCH_PX):
            cell = top // PATCH_PX * candidates.columns + left // PATCH_PX
            _cast(
                scene,
                view,
                candidates,
                cell=cell,
                left_px=float(left),
                top_px=float(top),
                rays=rays,
            )
            for row in range(top, min(top + PATCH_PX, depth_m.shape[0])):
                for column in range(left, min(left + PATCH_PX, depth_m.shape[1])):
                    k = (row - top) * PATCH_PX + column - left
                    depth_m[row, column] = rays.depth_m[k]
                    hits[row, column] = rays.hit[k]


@compiled
def _packet(height_px: int) -> Rays:
    """Return memory for the rays of one patch of an image, row by row.

    Patches have as many rows as an image that is lower, such as a few rows of a rolling shutter.
    """
    n = min(height_px, PATCH_PX) * PATCH_PX
    return Rays(
        x=np.empty(n),
        y=np.empty(n),
        depth_m=np.empty(n),
        hit=np.empty(n, np.int64),
        radiance=np.empty(n),
        sun_radiance=np.empty(n),
        place_m=np.empty((3, n)),
        footprint_m=np.empty(n),
    )


@compiled
def _cast(
    scene: SceneArrays,
    view: View,
    candidates: Candidates,
    cell: int,
    left_px: float,
    top_px: float,
    rays: Rays,
) -> int:
    """Aim the packet at the patch whose first ray goes through (left, top), and find its hits.

    Returns the end, in ``candidates.solids``, of the solids that were tested: those after it lie
    behind all that is seen.
    """
    for row in range(len(rays.x) // PATCH_PX):
        for column in range(PATCH_PX):
            rays.x[row * PATCH_PX + column] = (left_px + column - view.cu_px) / view.focal_px
            rays.y[row * PATCH_PX + column] = (top_px + row - view.cv_px) / view.focal_px
    hit_ground(view, rays)

    # The solids are sorted by depth: stop at the first one behind the farthest hit of the packet.
    j = int(candidates.first[cell])
    end = int(candidates.first[cell + 1])
    while j < end and candidates.nearest_m[candidates.solids[j]] <= rays.depth_m.max():
        hit_solid(scene, view, candidates.solids[j], rays=rays)
        j += 1
    return j
