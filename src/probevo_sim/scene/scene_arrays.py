"""A world as the plain arrays that the compiled loops read, and the view of it from one camera."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.geometry import se3
from probevo_sim.scene.textures import SIZE, Mipmaps, Texture, lattice_texels, make_textures
from probevo_sim.scene.world import Ground, World

GROUND = -1
"""Index of the ground where a ray's hit is recorded; solids count from 0."""
SKY = -2
"""Index of the sky, which a ray hits that meets nothing else."""
MAP_CELL_M = 0.5
"""Distance between the nodes of the map of distances from the road."""
BLOCK_CELLS = 32
"""Cells along one side of a block of that map."""
BLOCK_M = MAP_CELL_M * BLOCK_CELLS
LEAD_M = 150.0
"""How far the bands of the ground continue beyond both ends of the road."""


class SceneArrays(NamedTuple):
    """The part of a world that stays the same during a drive, of N solids and B bands of ground."""

    shape: IntArray
    """BOX or ELLIPSOID, [N]."""
    half_size_m: FloatArray
    """[N, 3]; see ``Solids``, like the fields up to ``seen``."""
    object_index: IntArray
    """[N]."""
    texture: IntArray
    """Layer of the texture on each face, [N, 3]."""
    texels_per_m: FloatArray
    """Scale of the texture along the two axes of each face, [N, 3, 2]."""
    shift_m: FloatArray
    """[N, 2]."""
    albedo: FloatArray
    """[N]."""
    contrast: FloatArray
    """[N]."""
    seen: BoolArray
    """[N]."""
    mipmaps: Mipmaps
    blotches: int
    """Layer of the texture of weathering."""
    clouds: int
    """Layer of the texture of the sky."""
    dapple: int
    """Layer of the texture of the light that falls through leaves."""
    repeated: int
    """Layer of the texture of leaves that repeat; they sway in the wind."""
    band_edge_m: FloatArray
    """[B]; see ``Ground``, like the other fields of bands."""
    band_texture: IntArray
    """[B]."""
    band_lattice_texels: IntArray
    """See ``lattice_texels``, [B]."""
    band_texels_per_m: FloatArray
    """[B]."""
    band_albedo: FloatArray
    """[B]."""
    band_contrast: FloatArray
    """[B]."""
    map_corner_m: FloatArray
    """Lower corner of the map of distances from the road in the world, (x, y), [2]."""
    map_blocks: IntArray
    """Number of each block of a grid over the world's y (rows) and x (columns), −1 far from the
    road."""
    road_distance_m: NDArray[np.float32]
    """Signed distance from the road's centre line at the nodes of each block,
    [blocks, BLOCK_CELLS + 1, BLOCK_CELLS + 1]."""
    to_sun: FloatArray
    """Unit vector towards the sun in the world, [3]."""
    sun_irradiance: float
    """See ``World``."""
    sky_irradiance: float
    """See ``World``."""
    sky_glow: float
    """See ``World``."""
    shadow: float
    """Darkness of cast shadows, 0 … 1."""


def scene_arrays(world: World, shadow: float) -> SceneArrays:
    """Return the arrays of a world, with cast shadows of darkness ``shadow``, 0 … 1."""
    solids = world.solids
    ground = world.ground
    corner_m, blocks, distance_m = _road_map(ground)
    return SceneArrays(
        shape=solids.shape,
        half_size_m=solids.half_size_m,
        object_index=solids.object_index,
        texture=solids.texture,
        texels_per_m=SIZE / solids.tile_m,
        shift_m=solids.shift_m,
        albedo=solids.albedo,
        contrast=solids.contrast,
        seen=solids.seen,
        mipmaps=make_textures(),
        blotches=int(Texture.BLOTCHES),
        clouds=int(Texture.CLOUDS),
        dapple=int(Texture.DAPPLE),
        repeated=int(Texture.HEDGE_REPEATED),
        band_edge_m=ground.edge_m,
        band_texture=ground.texture,
        band_lattice_texels=lattice_texels(ground.texture),
        band_texels_per_m=SIZE / ground.tile_m,
        band_albedo=ground.albedo,
        band_contrast=ground.contrast,
        map_corner_m=corner_m,
        map_blocks=blocks,
        road_distance_m=distance_m,
        to_sun=world.to_sun,
        sun_irradiance=world.sun_irradiance,
        sky_irradiance=world.sky_irradiance,
        sky_glow=world.sky_glow,
        shadow=shadow,
    )


def _road_map(ground: Ground) -> tuple[FloatArray, IntArray, NDArray[np.float32]]:
    """Return the map of distances from the road: corner, numbers of the blocks, and their nodes.

    Each block has BLOCK_CELLS cells a side. Blocks out of the bands' reach have no nodes, so the
    map grows with the length of the road, not with the area around it.
    """
    reach_m = MAP_CELL_M + float(ground.edge_m[:-1].max(initial=0.0))

    # Points of the centre line, closer together than a block is wide.
    spacing_m = BLOCK_M / 4.0
    line_m = _line(ground, LEAD_M, spacing_m)[:, :2, 3]

    # Number the blocks within reach of any of them.
    around = np.arange(-np.ceil(reach_m / BLOCK_M) - 1, np.ceil(reach_m / BLOCK_M) + 2)
    corner_m = line_m.min(axis=0) + (around[0] - 1) * BLOCK_M
    center = np.floor((line_m - corner_m) / BLOCK_M)[:, None]
    offsets = np.stack(np.meshgrid(around, around), axis=-1).reshape(1, -1, 2)
    near = np.unique((center + offsets).reshape(-1, 2).astype(np.int64), axis=0)
    blocks = np.full(near.max(axis=0)[::-1] + 1, -1)
    blocks[near[:, 1], near[:, 0]] = np.arange(len(near))

    # The distance from the centre line at the nodes of these blocks: roughly the distance from the
    # nearest of its points, positive to the left.
    steps_m = MAP_CELL_M * np.arange(BLOCK_CELLS + 1)
    node_offsets_m = np.stack(np.meshgrid(steps_m, steps_m), axis=-1)
    nodes_m = (corner_m + BLOCK_M * near)[:, None, None] + node_offsets_m
    T_world_line = _line(ground, LEAD_M + BLOCK_M * len(around), spacing_m)
    rough_m, nearest = KDTree(T_world_line[:, :2, 3]).query(nodes_m)
    T_world_nearest = T_world_line[nearest]
    to_node_m = nodes_m - T_world_nearest[..., :2, 3]
    distance_m = np.copysign(rough_m, np.sum(T_world_nearest[..., :2, 1] * to_node_m, axis=-1))

    # The distance is exact in the cells that the bands reach into. The other cells only have to be
    # beyond. A rough distance is too large by half the spacing at most.
    is_reached = rough_m <= reach_m + 0.5 * spacing_m + 2.0 * MAP_CELL_M
    distance_m[is_reached] = ground.route.nearest(nodes_m[is_reached])[1]
    return corner_m, blocks, distance_m.astype(np.float32)


def _line(ground: Ground, lead_m: float, spacing_m: float) -> FloatArray:
    """Return T_world_line, [N, 4, 4], m, of points of the centre line; their y is to its left."""
    along_m = np.arange(-lead_m, ground.route.length_m + lead_m, spacing_m)
    return ground.route.place(along_m, np.zeros_like(along_m))


class View(NamedTuple):
    """The N solids of a world as seen from one camera at one instant."""

    C_world_cam: FloatArray
    """[3, 3]."""
    center_m: FloatArray
    """The camera's centre in the world, [3]."""
    focal_px: float
    cu_px: float
    cv_px: float
    C_solid_cam: FloatArray
    """[N, 3, 3]."""
    center_in_solid_m: FloatArray
    """The camera's centre in each solid's axes, [N, 3]."""
    C_solid_world: FloatArray
    """[N, 3, 3]."""
    world_in_solid_m: FloatArray
    """The world's origin in each solid's axes, [N, 3]."""


def view_from(
    world: World,
    T_world_object: FloatArray,
    T_world_cam: FloatArray,
    intrinsics: tuple[float, float, float],
) -> View:
    """Return the view of a world from one camera.

    Args:
        world: the solids and the object that each belongs to.
        T_world_object: poses of the objects, as ``World.poses`` gives them, [2 + G, 4, 4], m.
        T_world_cam: pose of the camera, [4, 4], m.
        intrinsics: (focal length, cu, cv) of the camera, px.
    """
    solids = world.solids
    T_solid_world = se3.inverse(T_world_object[solids.object_index] @ solids.T_object_solid)
    T_solid_cam = T_solid_world @ T_world_cam
    return View(
        C_world_cam=np.ascontiguousarray(T_world_cam[:3, :3]),
        center_m=np.ascontiguousarray(T_world_cam[:3, 3]),
        focal_px=intrinsics[0],
        cu_px=intrinsics[1],
        cv_px=intrinsics[2],
        C_solid_cam=np.ascontiguousarray(T_solid_cam[:, :3, :3]),
        center_in_solid_m=np.ascontiguousarray(T_solid_cam[:, :3, 3]),
        C_solid_world=np.ascontiguousarray(T_solid_world[:, :3, :3]),
        world_in_solid_m=np.ascontiguousarray(T_solid_world[:, :3, 3]),
    )
