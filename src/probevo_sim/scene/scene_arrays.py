"""A world as the plain arrays that the compiled loops read, and what of it one camera sees at one
instant."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.geometry import se3
from probevo_sim.scene.textures import SIZE, Texture, make_textures
from probevo_sim.scene.world import Ground, World

GROUND = -1
SKY = -2
"""What a ray hits if it is no solid."""
MAP_CELL_M = 0.5
BLOCK_CELLS = 32
BLOCK_M = MAP_CELL_M * BLOCK_CELLS
LEAD_M = 150.0
"""How far beyond both ends of the road its bands go on."""


class SceneArrays(NamedTuple):
    """What does not change during a drive; see ``Solids``, ``Ground`` and ``World``."""

    shape: IntArray
    half_size_m: FloatArray
    object_index: IntArray
    texture: IntArray
    texels_per_m: FloatArray
    """[N, 3, 2]."""
    shift_m: FloatArray
    albedo: FloatArray
    contrast: FloatArray
    seen: BoolArray
    texels: NDArray[np.uint8]
    level_start: IntArray
    blotches: int
    clouds: int
    dapple: int
    repeated: int
    """The texture of leaves that repeat; they sway in the wind."""
    band_edge_m: FloatArray
    band_texture: IntArray
    band_texels_per_m: FloatArray
    band_albedo: FloatArray
    band_contrast: FloatArray
    map_corner_m: FloatArray
    map_blocks: IntArray
    """Number of each block of a grid over the world's x (columns) and y (rows); −1 far from the
    road."""
    road_distance_m: NDArray[np.float32]
    """Signed distance from the centre line at the nodes of each block, [blocks, BLOCK_CELLS + 1,
    BLOCK_CELLS + 1]."""
    to_sun: FloatArray
    sun: float
    sky: float
    shadow: float
    """Darkness of cast shadows, 0 … 1."""


def scene_arrays(world: World, shadow: float) -> SceneArrays:
    """The arrays of a world."""
    solids = world.solids
    ground = world.ground
    textures = make_textures()
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
        texels=textures.texels,
        level_start=textures.level_start,
        blotches=int(Texture.BLOTCHES),
        clouds=int(Texture.CLOUDS),
        dapple=int(Texture.DAPPLE),
        repeated=int(Texture.HEDGE_REPEATED),
        band_edge_m=ground.edge_m,
        band_texture=ground.texture,
        band_texels_per_m=SIZE / ground.tile_m,
        band_albedo=ground.albedo,
        band_contrast=ground.contrast,
        map_corner_m=corner_m,
        map_blocks=blocks,
        road_distance_m=distance_m,
        to_sun=world.to_sun,
        sun=world.sun,
        sky=world.sky,
        shadow=shadow,
    )


def _road_map(ground: Ground) -> tuple[FloatArray, IntArray, NDArray[np.float32]]:
    """Lower corner of a grid of blocks around the road, which of them are near it, and the nodes of
    those.

    Each block has BLOCK_CELLS cells a side. Blocks out of the bands' reach have no nodes: the map
    grows with the length of the road, not with the area around it.
    """
    reach_m = MAP_CELL_M + float(ground.edge_m[:-1].max(initial=0.0))
    along_m = np.arange(-LEAD_M, ground.route.length_m + LEAD_M, BLOCK_M / 4.0)
    line_m = ground.route.place(along_m, np.zeros_like(along_m))[:, :2, 3]
    around = np.arange(-np.ceil(reach_m / BLOCK_M) - 1, np.ceil(reach_m / BLOCK_M) + 2)
    corner_m = line_m.min(axis=0) + (around[0] - 1) * BLOCK_M
    center = np.floor((line_m - corner_m) / BLOCK_M)[:, None]
    offsets = np.stack(np.meshgrid(around, around), axis=-1).reshape(1, -1, 2)
    near = np.unique((center + offsets).reshape(-1, 2).astype(np.int64), axis=0)
    blocks = np.full(near.max(axis=0)[::-1] + 1, -1)
    blocks[near[:, 1], near[:, 0]] = np.arange(len(near))
    steps_m = MAP_CELL_M * np.arange(BLOCK_CELLS + 1)
    nodes_m = np.stack(np.meshgrid(steps_m, steps_m), axis=-1)
    distance_m = [ground.route.nearest(corner_m + BLOCK_M * block + nodes_m)[1] for block in near]
    return corner_m, blocks, np.array(distance_m, dtype=np.float32)


class Posed(NamedTuple):
    """The solids of a world as seen from one camera at one instant."""

    C_world_cam: FloatArray
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


def pose_solids(
    world: World,
    T_world_object: FloatArray,
    T_world_cam: FloatArray,
    intrinsics: tuple[float, float, float],
) -> Posed:
    """Solids whose objects are at ``T_world_object`` [1 + G, 4, 4], before a camera of (focal, cu,
    cv), px."""
    solids = world.solids
    T_solid_world = se3.inverse(T_world_object[solids.object_index] @ solids.T_object_solid)
    T_solid_cam = T_solid_world @ T_world_cam
    return Posed(
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
