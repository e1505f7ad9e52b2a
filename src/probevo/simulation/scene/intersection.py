"""Where rays enter solids."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled
from probevo.simulation.scene.candidates import NEAR_M
from probevo.simulation.scene.scene_arrays import GROUND, SKY, Posed, SceneArrays
from probevo.simulation.scene.solids import BOX


class Rays(NamedTuple):
    """A packet of n rays of one camera; each array is [n] but for one.

    All rays of a packet are taken through a step together: what a solid's test needs then stays in registers, and the
    overhead of a call is paid once for the packet.
    """

    x: FloatArray
    """The ray's direction in the camera is (x, y, 1)."""
    y: FloatArray
    depth_m: FloatArray
    """Of the first hit, along the camera's axis."""
    hit: IntArray
    """What is hit: a solid, GROUND or SKY."""
    radiance: FloatArray
    """As seen with the light of the sky alone; in the end, with all light."""
    sunlit: FloatArray
    """What the sun adds to it where nothing is in its way."""
    place_m: FloatArray
    """Where the world is hit, [3, n]; defined where ``sunlit`` is above 0."""
    size_m: FloatArray
    """Of the ray's footprint there."""


@compiled
def hit_ground(posed: Posed, rays: Rays) -> None:
    """Start a packet: each ray hits the ground, or goes to the sky."""
    down_x, down_y, down_z = posed.C_world_cam[2, 0], posed.C_world_cam[2, 1], posed.C_world_cam[2, 2]
    height_m = posed.center_m[2]
    x, y, depth_m, hit = rays.x, rays.y, rays.depth_m, rays.hit
    for k in range(len(x)):
        down = down_x * x[k] + down_y * y[k] + down_z
        depth_m[k] = -height_m / down if down < 0.0 else np.inf
        hit[k] = GROUND if down < 0.0 else SKY


@compiled
def hit_solid(scene: SceneArrays, posed: Posed, i: int, rays: Rays) -> None:
    """Let those rays of a packet hit solid ``i`` that enter it before what they hit so far."""
    C, center, half = posed.C_solid_cam[i], posed.center_in_solid_m[i], scene.half_size_m[i]
    ox, oy, oz, hx, hy, hz = center[0], center[1], center[2], half[0], half[1], half[2]
    xx, xy, xz = C[0, 0], C[0, 1], C[0, 2]
    yx, yy, yz = C[1, 0], C[1, 1], C[1, 2]
    zx, zy, zz = C[2, 0], C[2, 1], C[2, 2]
    box = scene.shape[i] == BOX
    x, y, depth_m, hit = rays.x, rays.y, rays.depth_m, rays.hit
    for k in range(len(x)):
        dx, dy, dz = xx * x[k] + xy * y[k] + xz, yx * x[k] + yy * y[k] + yz, zx * x[k] + zy * y[k] + zz
        in_box = enter_box(hx, hy, hz, ox, oy, oz, dx, dy, dz)
        enter = in_box if box else enter_ellipsoid(hx, hy, hz, ox, oy, oz, dx, dy, dz)
        if NEAR_M < enter < depth_m[k]:
            depth_m[k], hit[k] = enter, i


@compiled
def enter_box(
    hx: float, hy: float, hz: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:
    """k where the ray o + k d enters a box of half sizes h around the origin; infinite if it misses."""
    ix, iy, iz = 1.0 / _not_zero(dx), 1.0 / _not_zero(dy), 1.0 / _not_zero(dz)
    rx, ry, rz = abs(hx * ix), abs(hy * iy), abs(hz * iz)
    mx, my, mz = -ox * ix, -oy * iy, -oz * iz
    enter = max(max(mx - rx, my - ry), mz - rz)
    leave = min(min(mx + rx, my + ry), mz + rz)
    return enter if enter <= leave else np.inf


@compiled
def enter_ellipsoid(
    hx: float, hy: float, hz: float, ox: float, oy: float, oz: float, dx: float, dy: float, dz: float
) -> float:
    """The same for an ellipsoid."""
    ox, oy, oz, dx, dy, dz = ox / hx, oy / hy, oz / hz, dx / hx, dy / hy, dz / hz
    a, b = dx * dx + dy * dy + dz * dz, ox * dx + oy * dy + oz * dz
    root = b * b - a * (ox * ox + oy * oy + oz * oz - 1.0)
    return (-b - math.sqrt(root)) / a if root >= 0.0 else np.inf


@compiled
def _not_zero(d: float) -> float:
    """A ray along a face would bring infinity minus infinity."""
    return d if abs(d) > 1e-12 else 1e-12
