"""Intersections of rays with the ground and with solids, as compiled loops."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled
from probevo_sim.scene.candidates import NEAR_M
from probevo_sim.scene.scene_arrays import GROUND, SKY, SceneArrays, View
from probevo_sim.scene.solids import BOX

Vector = tuple[float, float, float]
"""Components (x, y, z), which compiled code keeps in registers."""


class Rays(NamedTuple):
    """A packet of n rays of one camera; each array is [n] unless stated otherwise.

    All rays of a packet are taken through a step together. What the test of a solid needs then
    stays in registers, and the overhead of a call is paid once for the packet.
    """

    x: FloatArray
    """The ray's direction in the camera is (x, y, 1)."""
    y: FloatArray
    depth_m: FloatArray
    """Depth of the nearest hit so far, along the camera's axis."""
    hit: IntArray
    """What is hit there: the index of a solid, GROUND or SKY."""
    radiance: FloatArray
    """Radiance in the light of the sky; once sunlight has been added, in all light."""
    sun_radiance: FloatArray
    """Radiance that the sun adds where nothing occludes it."""
    place_m: FloatArray
    """The hit in the world, [3, n]; defined where ``sun_radiance`` is above 0."""
    footprint_m: FloatArray
    """Size of the ray's footprint at the hit."""


@compiled
def hit_ground(view: View, rays: Rays) -> None:
    """Start a packet: let each ray hit the ground, or the sky if it does not point downwards."""
    down_x = view.C_world_cam[2, 0]
    down_y = view.C_world_cam[2, 1]
    down_z = view.C_world_cam[2, 2]
    height_m = view.center_m[2]
    x = rays.x
    y = rays.y
    depth_m = rays.depth_m
    hit = rays.hit
    for k in range(len(x)):
        down = down_x * x[k] + down_y * y[k] + down_z
        depth_m[k] = -height_m / down if down < 0.0 else np.inf
        hit[k] = GROUND if down < 0.0 else SKY


@compiled
def hit_solid(scene: SceneArrays, view: View, i: int, rays: Rays) -> None:
    """Record solid ``i`` as the hit of those rays that enter it before their nearest hit so far."""
    # Rays in the solid's own axes: the origin is the camera's centre, the directions are rotated.
    C = view.C_solid_cam[i]
    center = view.center_in_solid_m[i]
    half = scene.half_size_m[i]
    origin = (center[0], center[1], center[2])
    half_size = (half[0], half[1], half[2])
    xx = C[0, 0]
    xy = C[0, 1]
    xz = C[0, 2]
    yx = C[1, 0]
    yy = C[1, 1]
    yz = C[1, 2]
    zx = C[2, 0]
    zy = C[2, 1]
    zz = C[2, 2]
    is_box = scene.shape[i] == BOX
    x = rays.x
    y = rays.y
    depth_m = rays.depth_m
    hit = rays.hit
    for k in range(len(x)):
        direction = (
            xx * x[k] + xy * y[k] + xz,
            yx * x[k] + yy * y[k] + yz,
            zx * x[k] + zy * y[k] + zz,
        )
        enter = enter_box(half_size, origin, direction)
        if not is_box:
            enter = enter_ellipsoid(half_size, origin, direction)
        if NEAR_M < enter < depth_m[k]:
            depth_m[k] = enter
            hit[k] = i


@compiled
def enter_box(half_size: Vector, origin: Vector, direction: Vector) -> float:
    """Return k where the ray origin + k direction enters a box around 0; infinite if it misses.

    The ray is inside each pair of opposite faces over an interval of k (slab method); it is inside
    the box where the three intervals overlap.
    """
    ix = 1.0 / _away_from_zero(direction[0])
    iy = 1.0 / _away_from_zero(direction[1])
    iz = 1.0 / _away_from_zero(direction[2])
    rx = abs(half_size[0] * ix)
    ry = abs(half_size[1] * iy)
    rz = abs(half_size[2] * iz)
    mx = -origin[0] * ix
    my = -origin[1] * iy
    mz = -origin[2] * iz
    enter = max(max(mx - rx, my - ry), mz - rz)
    leave = min(min(mx + rx, my + ry), mz + rz)
    return enter if enter <= leave else np.inf


@compiled
def enter_ellipsoid(half_size: Vector, origin: Vector, direction: Vector) -> float:
    """Return k where the ray origin + k direction enters an ellipsoid; infinite if it misses.

    The ellipsoid has its centre at 0 and the given semi-axes.
    """
    # Scaled by its semi-axes the ellipsoid is a unit sphere: |o + k d|² = 1 is quadratic in k.
    ox = origin[0] / half_size[0]
    oy = origin[1] / half_size[1]
    oz = origin[2] / half_size[2]
    dx = direction[0] / half_size[0]
    dy = direction[1] / half_size[1]
    dz = direction[2] / half_size[2]
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    discriminant = b * b - a * (ox * ox + oy * oy + oz * oz - 1.0)
    return (-b - math.sqrt(discriminant)) / a if discriminant >= 0.0 else np.inf


@compiled
def _away_from_zero(d: float) -> float:
    """Return d, or 1e-12 if it is smaller: a ray along a face would give infinity − infinity."""
    return d if abs(d) > 1e-12 else 1e-12
