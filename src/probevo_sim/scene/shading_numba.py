"""Shading: the radiance of each hit in the light of sky and sun, as compiled loops.

All surfaces are Lambertian. Their reflectance is an albedo times a texture that is filtered over
the footprint of the ray. Haze mixes in the radiance of the sky with distance. The part that comes
from the sun is kept apart, because it still depends on what occludes the sun.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled
from probevo_sim.scene.intersection_numba import Rays, Vector
from probevo_sim.scene.scene_arrays import (
    BLOCK_CELLS,
    BLOCK_M,
    GROUND,
    SKY,
    SceneArrays,
    View,
)
from probevo_sim.scene.solids import BOX
from probevo_sim.scene.stochastic_tiling_numba import sample_unrepeated
from probevo_sim.scene.texture_filter_numba import Footprint, sample, sample_square
from probevo_sim.scene.textures import SIZE

BLOTCH_TEXELS_PER_M = SIZE / 29.0
"""Scale of the texture of weathering, which makes the tiles of all that stands still differ."""
BLOTCH_CONTRAST = 0.35
"""How far weathering varies the reflectance."""
CLOUD_HEIGHT_TEXELS = 150.0
"""Height of the plane of clouds above the camera, in texels of their texture."""
CLOUD_CONTRAST = 0.35
SKY_RADIANCE = 0.85
GLOW_RADIANCE = 1.2
"""Radiance that full glow adds to the sky next to the sun."""
GLOW_RAD = 0.35
"""Angle from the sun over which the glow falls by a factor e."""
DISK_RAD = 0.02
"""Radius of the sun's disk: with its halo, which saturates the sensor."""
DISK_RADIANCE = 5.0
SWAY_M = 0.12
"""Amplitude with which leaves that repeat, and shadows of leaves, sway in the wind."""
SWAY_RAD_S = 4.5
"""Angular frequency of that; each hedge and each crown has its own phase, and so do places on the
ground."""
HAZE_M = 1500.0
"""Distance at which half of the radiance is that of haze."""


@compiled
def shade_sky(scene: SceneArrays, view: View, footprint_px: float, rays: Rays) -> None:
    """Set the radiance of the rays that hit nothing: clouds on a plane at infinity."""
    C = view.C_world_cam
    mipmaps = scene.mipmaps
    step = footprint_px / view.focal_px
    hits = rays.hit
    xs = rays.x
    ys = rays.y
    radiance = rays.radiance
    sun_radiance = rays.sun_radiance
    for k in range(len(xs)):
        if hits[k] != SKY:
            continue
        # Where the ray meets a plane at height 1 above the camera, and its footprint there.
        x = xs[k]
        y = ys[k]
        up = max(C[2, 0] * x + C[2, 1] * y + C[2, 2], 1e-3)
        east = (C[0, 0] * x + C[0, 1] * y + C[0, 2]) / up
        north = (C[1, 0] * x + C[1, 1] * y + C[1, 2]) / up
        scale = CLOUD_HEIGHT_TEXELS * step / up
        footprint = Footprint(
            a=CLOUD_HEIGHT_TEXELS * east,
            b=CLOUD_HEIGHT_TEXELS * north,
            a_by_u=scale * (C[0, 0] - east * C[2, 0]),
            a_by_v=scale * (C[0, 1] - east * C[2, 1]),
            b_by_u=scale * (C[1, 0] - north * C[2, 0]),
            b_by_v=scale * (C[1, 1] - north * C[2, 1]),
        )
        clouds = sample(mipmaps, scene.clouds, footprint)
        # Clouds fade towards the horizon.
        radiance[k] = SKY_RADIANCE * (1.0 + CLOUD_CONTRAST * up / (up + 0.15) * clouds)
        sun_radiance[k] = 0.0
        if scene.sky_glow > 0.0:
            ray = (east * up, north * up, C[2, 0] * x + C[2, 1] * y + C[2, 2])
            radiance[k] += scene.sky_glow * _glow(scene.to_sun, ray)


@compiled
def _glow(to_sun: FloatArray, ray: Vector) -> float:
    """Return what the sun adds to the radiance of the sky in the direction of a ray."""
    length = math.sqrt(ray[0] * ray[0] + ray[1] * ray[1] + ray[2] * ray[2])
    cosine = (to_sun[0] * ray[0] + to_sun[1] * ray[1] + to_sun[2] * ray[2]) / length
    angle = math.acos(min(max(cosine, -1.0), 1.0))
    if angle < DISK_RAD:
        return DISK_RADIANCE
    return GLOW_RADIANCE * math.exp(-angle / GLOW_RAD)


@compiled
def shade_ground(scene: SceneArrays, view: View, footprint_px: float, rays: Rays) -> None:
    """Set the radiance of the rays that hit the ground, apart from the sun's, and the sun's."""
    C = view.C_world_cam
    center = view.center_m
    mipmaps = scene.mipmaps
    edge_m = scene.band_edge_m
    blocks = scene.map_blocks
    distance_m = scene.road_distance_m
    texture = scene.band_texture
    lattice_texels = scene.band_lattice_texels
    texels_per_m = scene.band_texels_per_m
    albedo = scene.band_albedo
    contrast = scene.band_contrast
    corner_x = scene.map_corner_m[0]
    corner_y = scene.map_corner_m[1]
    sun_irradiance = scene.sun_irradiance * scene.to_sun[2]
    hits = rays.hit
    xs = rays.x
    ys = rays.y
    depths_m = rays.depth_m
    radiance = rays.radiance
    sun_radiance = rays.sun_radiance
    place_m = rays.place_m
    footprints_m = rays.footprint_m
    for k in range(len(xs)):
        if hits[k] != GROUND:
            continue
        # The hit in the world.
        x = xs[k]
        y = ys[k]
        depth_m = depths_m[k]
        dx = C[0, 0] * x + C[0, 1] * y + C[0, 2]
        dy = C[1, 0] * x + C[1, 1] * y + C[1, 2]
        dz = C[2, 0] * x + C[2, 1] * y + C[2, 2]
        east = center[0] + depth_m * dx
        north = center[1] + depth_m * dy

        # Derivatives of (east, north) by the image coordinates, times the size of the ray.
        step = footprint_px * depth_m / view.focal_px
        au = step * (C[0, 0] - dx / dz * C[2, 0])
        av = step * (C[0, 1] - dx / dz * C[2, 1])
        bu = step * (C[1, 0] - dy / dz * C[2, 0])
        bv = step * (C[1, 1] - dy / dz * C[2, 1])

        # Reflectance: the texture of the band of the ground, weathered.
        band = _band(
            edge_m,
            blocks,
            distance_m,
            column=(east - corner_x) / BLOCK_M,
            row=(north - corner_y) / BLOCK_M,
        )
        scale = texels_per_m[band]
        footprint = Footprint(
            a=east * scale,
            b=north * scale,
            a_by_u=au * scale,
            a_by_v=av * scale,
            b_by_u=bu * scale,
            b_by_v=bv * scale,
        )
        detail = sample_unrepeated(mipmaps, texture[band], lattice_texels[band], footprint)
        footprint_m = math.sqrt(max(au * au + bu * bu, av * av + bv * bv))
        reflectance = albedo[band] * (1.0 + contrast[band] * detail)
        reflectance *= 1.0 + contrast[band] * _weathering(
            scene, east, north, footprint_m=footprint_m
        )

        # Light of the sky and haze; light of the sun apart.
        transmittance = HAZE_M / (HAZE_M + depth_m)
        radiance[k] = (
            transmittance * reflectance * scene.sky_irradiance
            + (1.0 - transmittance) * SKY_RADIANCE
        )
        sun_radiance[k] = transmittance * reflectance * sun_irradiance
        place_m[0, k] = east
        place_m[1, k] = north
        place_m[2, k] = 0.0
        footprints_m[k] = footprint_m


@compiled
def _band(
    edge_m: FloatArray, blocks: IntArray, distance_m: NDArray[np.float32], column: float, row: float
) -> int:
    """Return the band of the ground at a place, by its distance from the road's centre line.

    Args:
        edge_m: outer edges of the bands; see ``SceneArrays`` for this and the next two.
        blocks: the map's blocks.
        distance_m: distances at the nodes of each block.
        column: place on the map along x, in blocks.
        row: place on the map along y, in blocks.
    """
    last = len(edge_m) - 1
    j = math.floor(column)
    i = math.floor(row)
    if not (0 <= j < blocks.shape[1] and 0 <= i < blocks.shape[0]):
        return last
    block = blocks[i, j]
    if block < 0:
        return last

    # Bilinear interpolation between the four nodes of the cell.
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
    scene: SceneArrays, view: View, time_s: float, footprint_px: float, i: int, rays: Rays
) -> None:
    """Set the radiance of the rays that hit solid ``i``, apart from the sun's, and the sun's."""
    C = view.C_solid_cam[i]
    center = view.center_in_solid_m[i]
    half = scene.half_size_m[i]
    C_solid_world = view.C_solid_world[i]
    world_in_solid_m = view.world_in_solid_m[i]
    mipmaps = scene.mipmaps
    shift_m = scene.shift_m[i]
    texels_per_m = scene.texels_per_m[i]
    texture = scene.texture[i]
    albedo = scene.albedo[i]
    contrast = scene.contrast[i]
    to_sun = _to_solid(C_solid_world, scene.to_sun)
    sway_m = SWAY_M * math.sin(SWAY_RAD_S * time_s + i) if texture[1] == scene.repeated else 0.0
    is_box = scene.shape[i] == BOX
    is_at_rest = scene.object_index[i] == 0
    hits = rays.hit
    xs = rays.x
    ys = rays.y
    depths_m = rays.depth_m
    radiance = rays.radiance
    sun_radiance = rays.sun_radiance
    place_m = rays.place_m
    footprints_m = rays.footprint_m
    for k in range(len(xs)):
        if hits[k] != i:
            continue
        # The ray, its hit and the surface normal in the solid's own axes.
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
        face, normal = _face_of_box(own, half, ray) if is_box else _face_of_ellipsoid(own, half)

        # Derivatives of the hit by the image coordinates (u, v): the tangent plane is where
        # normal · derivative = 0. The two axes that are not the face's are texture coordinates.
        slope = 1.0 / min(normal[0] * ray[0] + normal[1] * ray[1] + normal[2] * ray[2], -1e-4)
        over_u = slope * (normal[0] * C[0, 0] + normal[1] * C[1, 0] + normal[2] * C[2, 0])
        over_v = slope * (normal[0] * C[0, 1] + normal[1] * C[1, 1] + normal[2] * C[2, 1])
        first = 1 if face == 0 else 0
        second = 1 if face == 2 else 2
        step = footprint_px * depth_m / view.focal_px
        au = step * (C[first, 0] - over_u * ray[first])
        av = step * (C[first, 1] - over_v * ray[first])
        bu = step * (C[second, 0] - over_u * ray[second])
        bv = step * (C[second, 1] - over_v * ray[second])

        # Reflectance: the texture of the face, weathered if the solid is at rest.
        a = own[first] + half[first] + shift_m[0] + sway_m
        b = own[second] + half[second] + shift_m[1]
        scale_a = texels_per_m[face, 0]
        scale_b = texels_per_m[face, 1]
        footprint = Footprint(
            a=a * scale_a,
            b=b * scale_b,
            a_by_u=au * scale_a,
            a_by_v=av * scale_a,
            b_by_u=bu * scale_b,
            b_by_v=bv * scale_b,
        )
        detail = sample(mipmaps, texture[face], footprint)
        footprint_m = math.sqrt(max(au * au + bu * bu, av * av + bv * bv))
        reflectance = albedo * (1.0 + contrast * detail)
        if is_at_rest:
            reflectance *= 1.0 + contrast * _weathering(
                scene, a + 7.0 * i, b + 3.0 * i, footprint_m=footprint_m
            )

        # Irradiance of the sky, of which a face sees the more the more it looks up.
        up = (
            C_solid_world[0, 2] * normal[0]
            + C_solid_world[1, 2] * normal[1]
            + C_solid_world[2, 2] * normal[2]
        )
        transmittance = HAZE_M / (HAZE_M + depth_m)
        irradiance = scene.sky_irradiance * (0.65 + 0.35 * up)
        radiance[k] = (
            transmittance * reflectance * irradiance + (1.0 - transmittance) * SKY_RADIANCE
        )

        # Irradiance of the sun by Lambert's cosine law.
        cosine = max(normal[0] * to_sun[0] + normal[1] * to_sun[1] + normal[2] * to_sun[2], 0.0)
        sun_radiance[k] = transmittance * reflectance * scene.sun_irradiance * cosine
        place_m[0, k], place_m[1, k], place_m[2, k] = _to_world(
            C_solid_world, world_in_solid_m, own
        )
        footprints_m[k] = footprint_m


@compiled
def _face_of_box(own: Vector, half: FloatArray, ray: Vector) -> tuple[int, Vector]:
    """Return the face through which a ray came to a place on a box, and the outward normal."""
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
    """Return the face that a box would have at a place on an ellipsoid, and the outward normal."""
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
    """Rotate a direction of the world into a solid's axes."""
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
def _to_world(C_solid_world: FloatArray, world_in_solid_m: FloatArray, own: Vector) -> Vector:
    """Transform a place from a solid's axes, in which the world's origin is given, to the world."""
    x = own[0] - world_in_solid_m[0]
    y = own[1] - world_in_solid_m[1]
    z = own[2] - world_in_solid_m[2]
    return (
        C_solid_world[0, 0] * x + C_solid_world[1, 0] * y + C_solid_world[2, 0] * z,
        C_solid_world[0, 1] * x + C_solid_world[1, 1] * y + C_solid_world[2, 1] * z,
        C_solid_world[0, 2] * x + C_solid_world[1, 2] * y + C_solid_world[2, 2] * z,
    )


@compiled
def _weathering(scene: SceneArrays, a_m: float, b_m: float, footprint_m: float) -> float:
    """Return the slow variation of the reflectance over metres at surface coordinates, around 0."""
    side = footprint_m * BLOTCH_TEXELS_PER_M
    a = a_m * BLOTCH_TEXELS_PER_M
    b = b_m * BLOTCH_TEXELS_PER_M
    return BLOTCH_CONTRAST * sample_square(scene.mipmaps, scene.blotches, a, b=b, side=side)
