"""The solids that a ray may hit: lists for each patch of an image and each cell of the ground.

The lists keep the tests of rays against solids few: a ray through a pixel is only tested against
the candidates of its patch, a ray towards the sun only against the occluders of its cell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.compiled import compiled
from probevo_sim.scene.scene_arrays import SceneArrays, View

PATCH_PX = 16
"""Side of a patch of the image."""
NEAR_M = 0.05
"""Distance of the near plane: what is closer to the camera is not seen."""
SHADOW_CELL_M = 2.0
"""Side of a cell of the ground."""
SHADOW_REACH_M = 90.0
"""Shadows farther from the camera than this are left out."""


class Candidates(NamedTuple):
    """Lists of solids for the cells of a grid, stored one after another.

    The list of cell c is ``solids[first[c]:first[c + 1]]``.
    """

    first: IntArray
    """Where the list of each cell begins, and where the last one ends, [rows × columns + 1]."""
    solids: IntArray
    """Indices of the solids in all lists."""
    columns: int
    """Columns of the grid."""
    corner: FloatArray
    """Lower corner of the grid, [2]: px in the image, m on the ground."""
    nearest_m: FloatArray
    """Least depth of each solid along the camera's axis, [N].

    The lists of the image are in this order; the lists of the ground have no depths, [0]."""


def image_candidates(scene: SceneArrays, view: View, size_px: tuple[int, int]) -> Candidates:
    """Return the solids that each patch of an image may show, the nearest first.

    Args:
        scene: the solids.
        view: the camera.
        size_px: width and height of the image.
    """
    columns = -(-size_px[0] // PATCH_PX)
    rows = -(-size_px[1] // PATCH_PX)
    bounds, nearest_m = _image_bounds(scene.half_size_m, view.C_solid_cam, view.center_in_solid_m)
    box_px = bounds * view.focal_px + [view.cu_px, view.cu_px, view.cv_px, view.cv_px]

    # A pixel reaches half a pixel beyond its centre.
    cells = np.floor((box_px + np.array([-0.5, 0.5, -0.5, 0.5])) / PATCH_PX)
    cells = np.clip(np.nan_to_num(cells, nan=-2.0), -2, [columns, columns, rows, rows])
    visible = scene.seen & np.isfinite(nearest_m)
    first, solids = _fill_lists(
        cells.astype(np.int64),
        visible,
        np.argsort(nearest_m, kind="stable"),
        columns=columns,
        rows=rows,
    )
    return Candidates(first, solids, columns, corner=np.zeros(2), nearest_m=nearest_m)


def shadow_candidates(scene: SceneArrays, view: View) -> Candidates:
    """Return the occluders of each cell of the ground: solids whose shadow may touch it.

    The grid is centred on the camera. A point above the ground is looked up where its own shadow
    falls, because whatever occludes the point occludes that place, too. Without shadows there are
    no cells.
    """
    if scene.shadow == 0.0:
        return Candidates(
            np.zeros(1, np.int64),
            np.zeros(0, np.int64),
            0,
            corner=np.zeros(2),
            nearest_m=np.zeros(0),
        )
    corner_m = view.center_m[:2] - SHADOW_REACH_M
    size = round(2.0 * SHADOW_REACH_M / SHADOW_CELL_M)
    box_m = _shadow_bounds(
        scene.half_size_m, view.C_solid_world, view.world_in_solid_m, to_sun=scene.to_sun
    )
    cells = np.clip(np.floor((box_m - np.repeat(corner_m, 2)) / SHADOW_CELL_M), -2, size)
    first, solids = _fill_lists(
        cells.astype(np.int64),
        np.ones(len(cells), np.bool_),
        np.arange(len(cells)),
        columns=size,
        rows=size,
    )
    return Candidates(first, solids, size, corner=corner_m, nearest_m=np.zeros(0))


@compiled
def _image_bounds(
    half_size_m: FloatArray, C_solid_cam: FloatArray, center: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the bounds of each box in the image plane z = 1, and the least depth of each.

    The part of a box behind the near plane is clipped off.

    Args:
        half_size_m: of the boxes, [N, 3].
        C_solid_cam: their rotations, [N, 3, 3].
        center: the camera's centre in the axes of each box, [N, 3], m.

    Returns:
        (x0, x1, y0, y1) of each box, [N, 4], and its least z, [N], m; infinite bounds and an
        infinite z for a box behind the camera.
    """
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

        # The eight corners in the camera; bit j of k says on which side of axis j corner k lies.
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
            # Each edge contributes its two ends; an end before the near plane moves onto it.
            for k in range(8):
                for j in range(3):
                    other = k | (1 << j)
                    if other == k:
                        continue
                    za = corner[k, 2]
                    zb = corner[other, 2]
                    for end in range(2):
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
def _shadow_bounds(
    half_size_m: FloatArray,
    C_solid_world: FloatArray,
    world_in_solid_m: FloatArray,
    to_sun: FloatArray,
) -> FloatArray:
    """Return the bounds (x0, x1, y0, y1) of each solid's shadow on the ground, [N, 4], m.

    Args:
        half_size_m: of the boxes around the solids, [N, 3].
        C_solid_world: their rotations, [N, 3, 3].
        world_in_solid_m: the world's origin in the axes of each, [N, 3].
        to_sun: unit vector towards the sun in the world, [3].
    """
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
            # Corner k in the world, then moved along the light onto the ground z = 0.
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
    """Return lists of the solids that cover each of columns × rows cells: ``first``, ``solids``.

    Args:
        cells: first and last column, first and last row that each solid covers, [N, 4].
        wanted: the solids that are to be listed, [N].
        order: all solids in the order that each list is to have, [N].
        columns: of the grid.
        rows: of the grid.
    """
    # Clip the ranges to the grid, and make them half-open.
    ranges = np.empty_like(cells)
    for i in range(len(cells)):
        ranges[i, 0] = max(cells[i, 0], 0)
        ranges[i, 1] = min(cells[i, 1], columns - 1) + 1
        ranges[i, 2] = max(cells[i, 2], 0)
        ranges[i, 3] = min(cells[i, 3], rows - 1) + 1

    # Count the solids of each cell; the cumulative counts are where the lists begin.
    first = np.zeros(columns * rows + 1, np.int64)
    for i in order:
        if wanted[i]:
            for row in range(ranges[i, 2], ranges[i, 3]):
                for cell in range(row * columns + ranges[i, 0], row * columns + ranges[i, 1]):
                    first[cell + 1] += 1
    for cell in range(columns * rows):
        first[cell + 1] += first[cell]

    # Fill the lists.
    solids = np.empty(first[-1], np.int64)
    end = first.copy()
    for i in order:
        if wanted[i]:
            for row in range(ranges[i, 2], ranges[i, 3]):
                for cell in range(row * columns + ranges[i, 0], row * columns + ranges[i, 1]):
                    solids[end[cell]] = i
                    end[cell] += 1
    return first, solids
