"""Where rays enter solids."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled
from probevo_sim.scene.candidates import NEAR_M
from probevo_sim.scene.scene_arrays import GROUND, SKY, Posed, SceneArrays
from probevo_sim.scene.solids import BOX


class Rays(NamedTuple):
    """A packet of n rays of one camera; each array is [n] but for one.

    All rays of a packet are taken through a step together: what a solid's test needs then stays in
    registers, and the
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
    down_x = posed.C_world_cam[2, 0]
    down_y = posed.C_world_cam[2, 1]
    down_z = posed.C_world_cam[2, 2]
    height_m = posed.center_m[2]
    x = rays.x
    y = rays.y
    depth_m = rays.depth_m
    hit = rays.hit
    for k in range(len(x)):
        down = down_x * x[k] + down_y * y[k] + down_z
        depth_m[k] = -height_m / down if down < 0.0 else np.inf
        hit[k] = GROUND if down < 0.0 else SKY


@compiled
def hit_solid(scene: SceneArrays, posed: Posed, i: int, rays: Rays) -> None:
    """Let those rays of a packet hit solid ``i`` that enter it before what they hit so far."""
    C = posed.C_solid_cam[i]
    center = posed.center_in_solid_m[i]
    half = scene.half_size_m[i]
    ox = center[0]
    oy = center[1]
    oz = center[2]
    hx = half[0]
    hy = half[1]
    hz = half[2]
    xx = C[0, 0]
    xy = C[0, 1]
    xz = C[0, 2]
    yx = C[1, 0]
    yy = C[1, 1]
    yz = C[1, 2]
    zx = C[2, 0]
    zy = C[2, 1]
    zz = C[2, 2]
    box = scene.shape[i] == BOX
    x = rays.x
    y = rays.y
    depth_m = rays.depth_m
    hit = rays.hit
    for k in range(len(x)):
        dx = xx * x[k] + xy * y[k] + xz
        dy = yx * x[k] + yy * y[k] + yz
        dz = zx * x[k] + zy * y[k] + zz
        in_box = enter_box(hx, hy, hz, ox=ox, oy=oy, oz=oz, dx=dx, dy=dy, dz=dz)
        enter = (
            in_box if box else enter_ellipsoid(hx, hy, hz, ox=ox, oy=oy, oz=oz, dx=dx, dy=dy, dz=dz)
        )
        if NEAR_M < enter < depth_m[k]:
            depth_m[k] = enter
            hit[k] = i


@compiled
def enter_box(
    hx: float,
    hy: float,
    hz: float,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
) -> float:
    """k where the ray o + k d enters a box of half sizes h around the origin; infinite if it
    misses."""
    ix = 1.0 / _not_zero(dx)
    iy = 1.0 / _not_zero(dy)
    iz = 1.0 / _not_zero(dz)
    rx = abs(hx * ix)
    ry = abs(hy * iy)
    rz = abs(hz * iz)
    mx = -ox * ix
    my = -oy * iy
    mz = -oz * iz
    enter = max(max(mx - rx, my - ry), mz - rz)
    leave = min(min(mx + rx, my + ry), mz + rz)
    return enter if enter <= leave else np.inf


@compiled
def enter_ellipsoid(
    hx: float,
    hy: float,
    hz: float,
    ox: float,
    oy: float,
    oz: float,
    dx: float,
    dy: float,
    dz: float,
) -> float:
    """The same for an ellipsoid."""
    ox = ox / hx
    oy = oy / hy
    oz = oz / hz
    dx = dx / hx
    dy = dy / hy
    dz = dz / hz
    a = dx * dx + dy * dy + dz * dz
    b = ox * dx + oy * dy + oz * dz
    root = b * b - a * (ox * ox + oy * oy + oz * oz - 1.0)
    return (-b - math.sqrt(root)) / a if root >= 0.0 else np.inf


@compiled
def _not_zero(d: float) -> float:
    """A ray along a face would bring infinity minus infinity."""
    return d if abs(d) > 1e-12 else 1e-12
