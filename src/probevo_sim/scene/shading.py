"""How bright a hit is: texture, filtered over the footprint of the ray, in the light of sky and
sun."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled
from probevo_sim.scene.intersection import Rays
from probevo_sim.scene.scene_arrays import BLOCK_CELLS, BLOCK_M, GROUND, SKY, Posed, SceneArrays
from probevo_sim.scene.solids import BOX
from probevo_sim.scene.texture_filter import Texels, sample, sample_square
from probevo_sim.scene.textures import SIZE

BLOTCH_TEXELS_PER_M = SIZE / 29.0
BLOTCH_CONTRAST = 0.35
"""Weathering is laid over all that stands still, so that no two tiles look the same."""
CLOUD_HEIGHT_TEXELS = 150.0
CLOUD_CONTRAST = 0.35
SKY_RADIANCE = 0.85
SWAY_M = 0.12
SWAY_RAD_S = 4.5
"""Of leaves that repeat: they go to and fro, each hedge and each crown by itself."""
HAZE_M = 1500.0
"""Distance at which half of what is seen is haze."""

Vector = tuple[float, float, float]


@compiled
def shade_sky(scene: SceneArrays, posed: Posed, footprint_px: float, rays: Rays) -> None:
    """Radiance of the rays that hit nothing: clouds at infinity."""
    C = posed.C_world_cam
    texels = scene.texels
    level_start = scene.level_start
    step = footprint_px / posed.focal_px
    hits = rays.hit
    xs = rays.x
    ys = rays.y
    radiance = rays.radiance
    sunlit = rays.sunlit
    for k in range(len(xs)):
        if hits[k] != SKY:
            continue
        x = xs[k]
        y = ys[k]
        up = max(C[2, 0] * x + C[2, 1] * y + C[2, 2], 1e-3)
        east = (C[0, 0] * x + C[0, 1] * y + C[0, 2]) / up
        north = (C[1, 0] * x + C[1, 1] * y + C[1, 2]) / up
        scale = CLOUD_HEIGHT_TEXELS * step / up
        clouds = sample(
            texels,
            scene.clouds,
            level_start,
            a=CLOUD_HEIGHT_TEXELS * east,
            b=CLOUD_HEIGHT_TEXELS * north,
            au=scale * (C[0, 0] - east * C[2, 0]),
            av=scale * (C[0, 1] - east * C[2, 1]),
            bu=scale * (C[1, 0] - north * C[2, 0]),
            bv=scale * (C[1, 1] - north * C[2, 1]),
        )
        radiance[k] = SKY_RADIANCE * (1.0 + CLOUD_CONTRAST * up / (up + 0.15) * clouds)
        sunlit[k] = 0.0


@compiled
def shade_ground(scene: SceneArrays, posed: Posed, footprint_px: float, rays: Rays) -> None:
    """Radiance of the rays that hit the ground."""
    C = posed.C_world_cam
    center = posed.center_m
    texels = scene.texels
    level_start = scene.level_start
    edge_m = scene.band_edge_m
    blocks = scene.map_blocks
    distance_m = scene.road_distance_m
    texture = scene.band_texture
    texels_per_m = scene.band_texels_per_m
    albedo = scene.band_albedo
    contrast = scene.band_contrast
    corner_x = scene.map_corner_m[0]
    corner_y = scene.map_corner_m[1]
    sunlight = scene.sun * scene.to_sun[2]
    hits = rays.hit
    xs = rays.x
    ys = rays.y
    depths_m = rays.depth_m
    radiance = rays.radiance
    sunlit = rays.sunlit
    place_m = rays.place_m
    sizes_m = rays.size_m
    for k in range(len(xs)):
        if hits[k] != GROUND:
            continue
        x = xs[k]
        y = ys[k]
        depth_m = depths_m[k]
        dx = C[0, 0] * x + C[0, 1] * y + C[0, 2]
        dy = C[1, 0] * x + C[1, 1] * y + C[1, 2]
        dz = C[2, 0] * x + C[2, 1] * y + C[2, 2]
        east = center[0] + depth_m * dx
        north = center[1] + depth_m * dy
        step = footprint_px * depth_m / posed.focal_px
        au = step * (C[0, 0] - dx / dz * C[2, 0])
        av = step * (C[0, 1] - dx / dz * C[2, 1])
        bu = step * (C[1, 0] - dy / dz * C[2, 0])
        bv = step * (C[1, 1] - dy / dz * C[2, 1])
        band = _band(
            edge_m,
            blocks,
            distance_m,
            column=(east - corner_x) / BLOCK_M,
            row=(north - corner_y) / BLOCK_M,
        )
        scale = texels_per_m[band]
        detail = sample(
            texels,
            texture[band],
            level_start,
            a=east * scale,
            b=north * scale,
            au=au * scale,
            av=av * scale,
            bu=bu * scale,
            bv=bv * scale,
        )
        size_m = math.sqrt(max(au * au + bu * bu, av * av + bv * bv))
        reflectance = albedo[band] * (1.0 + contrast[band] * detail)
        reflectance *= 1.0 + contrast[band] * _weathering(
            texels, scene.blotches, level_start, a=east, b=north, size_m=size_m
        )
        clear = HAZE_M / (HAZE_M + depth_m)
        radiance[k] = clear * reflectance * scene.sky + (1.0 - clear) * SKY_RADIANCE
        sunlit[k] = clear * reflectance * sunlight
        place_m[0, k] = east
        place_m[1, k] = north
        place_m[2, k] = 0.0
        sizes_m[k] = size_m


@compiled
def _band(
    edge_m: FloatArray, blocks: IntArray, distance_m: NDArray[np.float32], column: float, row: float
) -> int:
    """The band of the ground at a place of the map, in blocks, by its distance from the road's
    centre line."""
    last = len(edge_m) - 1
    j = math.floor(column)
    i = math.floor(row)
    if not (0 <= j < blocks.shape[1] and 0 <= i < blocks.shape[0]):
        return last
    block = blocks[i, j]
    if block < 0:
        return last
    column = BLOCK_CELLS * (column - j)
    row = BLOCK_CELLS * (row - i)
    j = int(column)
    i = int(row)
    right = column - j
    up = row - i
    near = (1.0 - right) * distance_m[block, i, j] + right * distance_m[block, i, j + 1]
    far = (1.0 - right) * distance_m[block, i + 1, j] + right * distance_m[block, i + 1, j + 1]
    away_m = abs((1.0 - up) * near + up * far)
    for band in range(last):
        if away_m < edge_m[band]:
            return band
    return last


@compiled
def shade_solid(
    scene: SceneArrays, posed: Posed, time_s: float, footprint_px: float, i: int, rays: Rays
) -> None:
    """Radiance of the rays that hit solid ``i``."""
    C = posed.C_solid_cam[i]
    center = posed.center_in_solid_m[i]
    half = scene.half_size_m[i]
    C_solid_world = posed.C_solid_world[i]
    origin = posed.world_in_solid_m[i]
    texels = scene.texels
    level_start = scene.level_start
    shift_m = scene.shift_m[i]
    texels_per_m = scene.texels_per_m[i]
    texture = scene.texture[i]
    albedo = scene.albedo[i]
    contrast = scene.contrast[i]
    sun = _to_solid(C_solid_world, scene.to_sun)
    sway_m = SWAY_M * math.sin(SWAY_RAD_S * time_s + i) if texture[1] == scene.repeated else 0.0
    box = scene.shape[i] == BOX
    still = scene.object_index[i] == 0
    hits = rays.hit
    xs = rays.x
    ys = rays.y
    depths_m = rays.depth_m
    radiance = rays.radiance
    sunlit = rays.sunlit
    place_m = rays.place_m
    sizes_m = rays.size_m
    for k in range(len(xs)):
        if hits[k] != i:
            continue
        depth_m = depths_m[k]
        x = xs[k]
        y = ys[k]
        ray = (
            C[0, 0] * x + C[0, 1] * y + C[0, 2],
            C[1, 0] * x + C[1, 1] * y + C[1, 2],
            C[2, 0] * x + C[2, 1] * y + C[2, 2],
        )
        own = (
            center[0] + depth_m * ray[0],
            center[1] + depth_m * ray[1],
            center[2] + depth_m * ray[2],
        )
        face, normal = _face_of_box(own, half, ray) if box else _face_of_ellipsoid(own, half)
        slope = 1.0 / min(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2], -1e-4)
        over_u = slope * (normal[0] * C[0, 0] + normal[1] * C[1, 0] + normal[2] * C[2, 0])
        over_v = slope * (normal[0] * C[0, 1] + normal[1] * C[1, 1] + normal[2] * C[2, 1])
        first = 1 if face == 0 else 0
        second = 1 if face == 2 else 2
        step = footprint_px * depth_m / posed.focal_px
        au = step * (C[first, 0] - over_u * ray[first])
        av = step * (C[first, 1] - over_v * ray[first])
        bu = step * (C[second, 0] - over_u * ray[second])
        bv = step * (C[second, 1] - over_v * ray[second])
        a = own[first] + half[first] + shift_m[0] + sway_m
        b = own[second] + half[second] + shift_m[1]
        scale_a = texels_per_m[face, 0]
        scale_b = texels_per_m[face, 1]
        detail = sample(
            texels,
            texture[face],
            level_start,
            a=a * scale_a,
            b=b * scale_b,
            au=au * scale_a,
            av=av * scale_a,
            bu=bu * scale_b,
            bv=bv * scale_b,
        )
        size_m = math.sqrt(max(au * au + bu * bu, av * av + bv * bv))
        reflectance = albedo * (1.0 + contrast * detail)
        if still:
            reflectance *= 1.0 + contrast * _weathering(
                texels, scene.blotches, level_start, a=a + 7.0 * i, b=b + 3.0 * i, size_m=size_m
            )
        up = (
            C_solid_world[0, 2] * normal[0]
            + C_solid_world[1, 2] * normal[1]
            + C_solid_world[2, 2] * normal[2]
        )
        clear = HAZE_M / (HAZE_M + depth_m)
        light = scene.sky * (0.65 + 0.35 * up)
        radiance[k] = clear * reflectance * light + (1.0 - clear) * SKY_RADIANCE
        facing = max(normal[0] * sun[0] + normal[1] * sun[1] + normal[2] * sun[2], 0.0)
        sunlit[k] = clear * reflectance * scene.sun * facing
        place_m[0, k], place_m[1, k], place_m[2, k] = _to_world(C_solid_world, origin, own)
        sizes_m[k] = size_m


@compiled
def _face_of_box(own: Vector, half: FloatArray, ray: Vector) -> tuple[int, Vector]:
    """Through which face a ray came to a place on a box, and the normal there."""
    x = abs(own[0]) / half[0] if own[0] * ray[0] < 0.0 else -1.0
    y = abs(own[1]) / half[1] if own[1] * ray[1] < 0.0 else -1.0
    z = abs(own[2]) / half[2] if own[2] * ray[2] < 0.0 else -1.0
    if x >= y and x >= z:
        return 0, (-math.copysign(1.0, ray[0]), 0.0, 0.0)
    if y >= z:
        return 1, (0.0, -math.copysign(1.0, ray[1]), 0.0)
    return 2, (0.0, 0.0, -math.copysign(1.0, ray[2]))


@compiled
def _face_of_ellipsoid(own: Vector, half: FloatArray) -> tuple[int, Vector]:
    """The face that a box would have at a place on an ellipsoid, and the normal there."""
    x = own[0] / half[0]
    y = own[1] / half[1]
    z = own[2] / half[2]
    nx = x / half[0]
    ny = y / half[1]
    nz = z / half[2]
    scale = 1.0 / math.sqrt(nx * nx + ny * ny + nz * nz)
    face = 0 if abs(x) >= abs(y) and abs(x) >= abs(z) else (1 if abs(y) >= abs(z) else 2)
    return face, (scale * nx, scale * ny, scale * nz)


@compiled
def _to_solid(C_solid_world: FloatArray, vector: FloatArray) -> Vector:
    """A direction of the world in a solid's axes."""
    return (
        C_solid_world[0, 0] * vector[0]
        + C_solid_world[0, 1] * vector[1]
        + C_solid_world[0, 2] * vector[2],
        C_solid_world[1, 0] * vector[0]
        + C_solid_world[1, 1] * vector[1]
        + C_solid_world[1, 2] * vector[2],
        C_solid_world[2, 0] * vector[0]
        + C_solid_world[2, 1] * vector[1]
        + C_solid_world[2, 2] * vector[2],
    )


@compiled
def _to_world(C_solid_world: FloatArray, origin: FloatArray, own: Vector) -> Vector:
    """A place in a solid's axes, in the world; ``origin`` is the world's in the solid's."""
    x = own[0] - origin[0]
    y = own[1] - origin[1]
    z = own[2] - origin[2]
    return (
        C_solid_world[0, 0] * x + C_solid_world[1, 0] * y + C_solid_world[2, 0] * z,
        C_solid_world[0, 1] * x + C_solid_world[1, 1] * y + C_solid_world[2, 1] * z,
        C_solid_world[0, 2] * x + C_solid_world[1, 2] * y + C_solid_world[2, 2] * z,
    )


@compiled
def _weathering(
    texels: Texels, blotches: int, level_start: IntArray, a: float, b: float, size_m: float
) -> float:
    """Slow changes of the reflectance over metres, around 0; ``size_m`` is the footprint's."""
    step = size_m * BLOTCH_TEXELS_PER_M
    a = a * BLOTCH_TEXELS_PER_M
    b = b * BLOTCH_TEXELS_PER_M
    return BLOTCH_CONTRAST * sample_square(texels, blotches, level_start, a=a, b=b, side=step)
