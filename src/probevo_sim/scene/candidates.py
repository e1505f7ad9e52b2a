"""Which solids a ray may hit: lists for each patch of the image, and for each patch of the ground
towards the sun."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.compiled import compiled
from probevo_sim.scene.scene_arrays import Posed, SceneArrays

PATCH_PX = 16
NEAR_M = 0.05
SHADOW_CELL_M = 2.0
SHADOW_REACH_M = 90.0
"""Shadows further than this from the camera are left out."""


class Candidates(NamedTuple):
    """Lists of solids for the cells of a grid, one after another."""

    first: IntArray
    """Where the list of each cell begins, [rows × columns + 1]."""
    solids: IntArray
    columns: int
    corner: FloatArray
    """Lower corner of the grid, [2]: px in the image, m on the ground."""
    nearest_m: FloatArray
    """How near each solid comes to the camera along its axis, [N]: the lists are in this order."""


def in_image(scene: SceneArrays, posed: Posed, size_px: tuple[int, int]) -> Candidates:
    """For each patch of an image (width, height) the solids that it may show, the nearest first."""
    columns = -(-size_px[0] // PATCH_PX)
    rows = -(-size_px[1] // PATCH_PX)
    box_px, nearest_m = _image_boxes(scene.half_size_m, posed.C_solid_cam, posed.center_in_solid_m)
    box_px = box_px * posed.focal_px + [posed.cu_px, posed.cu_px, posed.cv_px, posed.cv_px]
    # A pixel reaches half a pixel beyond its centre.
    cells = np.floor((box_px + np.array([-0.5, 0.5, -0.5, 0.5])) / PATCH_PX)
    cells = np.clip(np.nan_to_num(cells, nan=-2.0), -2, [columns, columns, rows, rows]).astype(
        np.int64
    )
    visible = scene.seen & np.isfinite(nearest_m)
    first, solids = _fill_lists(
        cells, visible, np.argsort(nearest_m, kind="stable"), columns=columns, rows=rows
    )
    return Candidates(first, solids, columns, corner=np.zeros(2), nearest_m=nearest_m)


def towards_sun(scene: SceneArrays, posed: Posed) -> Candidates:
    """For each cell of the ground around the camera the solids whose shadow may touch it.

    A point above the ground is looked up where its own shadow falls: what shades it shades that
    place too. Where there
    are no shadows, there are no cells.
    """
    if scene.shadow == 0.0:
        return Candidates(
            np.zeros(1, np.int64),
            np.zeros(0, np.int64),
            0,
            corner=np.zeros(2),
            nearest_m=np.zeros(0),
        )
    corner_m = posed.center_m[:2] - SHADOW_REACH_M
    size = round(2.0 * SHADOW_REACH_M / SHADOW_CELL_M)
    box_m = _shadow_boxes(
        scene.half_size_m, posed.C_solid_world, posed.world_in_solid_m, to_sun=scene.to_sun
    )
    cells = np.clip(np.floor((box_m - np.repeat(corner_m, 2)) / SHADOW_CELL_M), -2, size).astype(
        np.int64
    )
    first, solids = _fill_lists(
        cells, np.ones(len(cells), np.bool_), np.arange(len(cells)), columns=size, rows=size
    )
    return Candidates(first, solids, size, corner=corner_m, nearest_m=np.zeros(0))


@compiled
def _image_boxes(
    half_size_m: FloatArray, C_solid_cam: FloatArray, center: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Bounds (x0, x1, y0, y1) of each box in the plane z = 1, [N, 4], and its nearest z, infinite
    if it is behind."""
    count = len(half_size_m)
    bounds = np.empty((count, 4))
    nearest = np.full(count, np.inf)
    corner = np.empty((8, 3))
    for i in range(count):
        x0 = np.inf
        x1 = -np.inf
        y0 = np.inf
        y1 = -np.inf
        low = np.inf
        high = -np.inf
        for k in range(8):
            for axis in range(3):
                total = 0.0
                for j in range(3):
                    sign = 1.0 if (k >> j) & 1 else -1.0
                    total += C_solid_cam[i, j, axis] * (sign * half_size_m[i, j] - center[i, j])
                corner[k, axis] = total
            low = min(low, corner[k, 2])
            high = max(high, corner[k, 2])
        if high > NEAR_M:
            nearest[i] = max(low, NEAR_M)
            for k in range(8):
                for j in range(3):
                    other = k | (1 << j)
                    if other == k:
                        continue
                    za = corner[k, 2]
                    zb = corner[other, 2]
                    for end in range(
                        2
                    ):  # each edge from its nearer to its farther end, cut at the near plane
                        z = za if end == 0 else zb
                        share = 0.0 if end == 0 else 1.0
                        if z < NEAR_M:
                            if max(za, zb) < NEAR_M:
                                continue
                            share = (NEAR_M - za) / (zb - za)
                            z = NEAR_M
                        x = corner[k, 0] + share * (corner[other, 0] - corner[k, 0])
                        y = corner[k, 1] + share * (corner[other, 1] - corner[k, 1])
                        x0 = min(x0, x / z)
                        x1 = max(x1, x / z)
                        y0 = min(y0, y / z)
                        y1 = max(y1, y / z)
        bounds[i, 0] = x0
        bounds[i, 1] = x1
        bounds[i, 2] = y0
        bounds[i, 3] = y1
    return bounds, nearest


@compiled
def _shadow_boxes(
    half_size_m: FloatArray,
    C_solid_world: FloatArray,
    world_in_solid_m: FloatArray,
    to_sun: FloatArray,
) -> FloatArray:
    """Bounds (x0, x1, y0, y1) of each solid's shadow on the ground, [N, 4], m."""
    count = len(half_size_m)
    bounds = np.empty((count, 4))
    slope_x = to_sun[0] / to_sun[2]
    slope_y = to_sun[1] / to_sun[2]
    for i in range(count):
        x0 = np.inf
        x1 = -np.inf
        y0 = np.inf
        y1 = -np.inf
        for k in range(8):
            x = 0.0
            y = 0.0
            z = 0.0
            for j in range(3):
                sign = 1.0 if (k >> j) & 1 else -1.0
                offset = sign * half_size_m[i, j] - world_in_solid_m[i, j]
                x += C_solid_world[i, j, 0] * offset
                y += C_solid_world[i, j, 1] * offset
                z += C_solid_world[i, j, 2] * offset
            x = x - slope_x * z
            y = y - slope_y * z
            x0 = min(x0, x)
            x1 = max(x1, x)
            y0 = min(y0, y)
            y1 = max(y1, y)
        bounds[i, 0] = x0
        bounds[i, 1] = x1
        bounds[i, 2] = y0
        bounds[i, 3] = y1
    return bounds


@compiled
def _fill_lists(
    cells: IntArray, wanted: BoolArray, order: IntArray, columns: int, rows: int
) -> tuple[IntArray, IntArray]:
    """Lists for columns × rows cells of the solids whose range of cells (c0, c1, r0, r1), [N, 4],
    covers them."""
    ranges = np.empty_like(cells)
    ranges[:, 0] = np.maximum(cells[:, 0], 0)
    ranges[:, 1] = np.minimum(cells[:, 1], columns - 1) + 1
    ranges[:, 2] = np.maximum(cells[:, 2], 0)
    ranges[:, 3] = np.minimum(cells[:, 3], rows - 1) + 1
    first = np.zeros(columns * rows + 1, np.int64)
    for i in order:
        if wanted[i]:
            for row in range(ranges[i, 2], ranges[i, 3]):
                first[row * columns + ranges[i, 0] + 1 : row * columns + ranges[i, 1] + 1] += 1
    first = np.cumsum(first)
    solids = np.empty(first[-1], np.int64)
    end = first.copy()
    for i in order:
        if wanted[i]:
            for row in range(ranges[i, 2], ranges[i, 3]):
                for cell in range(row * columns + ranges[i, 0], row * columns + ranges[i, 1]):
                    solids[end[cell]] = i
                    end[cell] += 1
    return first, solids
