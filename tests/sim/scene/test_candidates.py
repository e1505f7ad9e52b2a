"""No ray and no shadow misses a solid for want of a place in a list."""

import numpy as np
from sim.scene.small_world import CAMERA, world

from probevo.arrays import FloatArray
from probevo_sim.scene.candidates import SHADOW_REACH_M, Candidates, in_image, towards_sun
from probevo_sim.scene.drive import C_BODY_CAM
from probevo_sim.scene.ray_caster import add_radiance, first_hits
from probevo_sim.scene.scene_arrays import Posed, SceneArrays, pose_solids, scene_arrays
from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture

SIZE_PX = (320, 128)


def scattered(rng: np.random.Generator, count: int) -> Solids:
    """Solids of all sizes all around the camera, some of them beside and behind it."""
    return join(
        solid(
            int(rng.choice([BOX, ELLIPSOID])),
            rng.uniform(0.2, 6.0, 3),
            [*rng.uniform(-25.0, 25.0, 2), rng.uniform(0.0, 5.0)],
            texture=Texture.BRICK,
            tile_m=2.0,
            yaw_rad=rng.uniform(0.0, 6.0),
        )
        for _ in range(count)
    )


def posed_scene(solids: Solids, shadow: float = 0.0) -> tuple[SceneArrays, Posed]:
    place = world(solids)
    T_world_cam = np.eye(4)
    T_world_cam[:3, :3] = C_BODY_CAM
    T_world_cam[2, 3] = 1.5
    intrinsics = (CAMERA.fu_px, CAMERA.cu_px, CAMERA.cv_px)
    return scene_arrays(place, shadow), pose_solids(
        place, place.poses(0.0, T_world_cam), T_world_cam, intrinsics=intrinsics
    )


def everything_everywhere(lists: Candidates, nearest_m: FloatArray) -> Candidates:
    """Lists that hold all solids in each cell."""
    cells = len(lists.first) - 1
    order = np.argsort(nearest_m, kind="stable")
    first = np.arange(cells + 1) * len(order)
    return Candidates(
        first, np.tile(order, cells), lists.columns, corner=lists.corner, nearest_m=nearest_m
    )


def test_lists_of_the_image_miss_nothing() -> None:
    for seed in range(5):
        scene, posed = posed_scene(scattered(np.random.default_rng(seed), 60))
        lists = in_image(scene, posed, SIZE_PX)
        found = []
        for each in (lists, everything_everywhere(lists, lists.nearest_m)):
            depth_m = np.empty(SIZE_PX[::-1])
            hits = np.empty(SIZE_PX[::-1], np.int32)
            first_hits(scene, posed, each, depth_m=depth_m, hits=hits)
            found.append((depth_m, hits))
        np.testing.assert_array_equal(found[0], found[1])
        assert len(np.unique(found[0][1])) > 5


def test_lists_towards_the_sun_miss_nothing() -> None:
    """The same image, whether each cell lists the solids whose shadow touches it or all of them."""
    scene, posed = posed_scene(scattered(np.random.default_rng(1), 40), shadow=1.0)
    lists = in_image(scene, posed, SIZE_PX)
    casters = towards_sun(scene, posed)
    images = []
    for each in (casters, everything_everywhere(casters, np.zeros(40))):
        image = np.zeros(SIZE_PX[::-1], np.float32)
        add_radiance(
            scene,
            posed,
            lists,
            casters=each,
            time_s=0.0,
            offsets_px=np.zeros((1, 2)),
            footprint_px=1.0,
            image=image,
        )
        images.append(image)
    np.testing.assert_array_equal(images[0], images[1])


def test_what_is_not_seen_is_in_no_list_of_the_image_but_casts_its_shadow() -> None:
    ghost = solid(
        BOX, (1.0, 1.0, 1.0), (10.0, 0.0, 3.0), texture=Texture.PLAIN, tile_m=1.0, seen=False
    )
    scene, posed = posed_scene(ghost, shadow=1.0)
    assert len(in_image(scene, posed, SIZE_PX).solids) == 0
    casters = towards_sun(scene, posed)
    assert set(casters.solids.tolist()) == {0}
    cells = np.flatnonzero(np.diff(casters.first))
    # The sun stands in the west at a slope of 0.75: the shadow of what is 2.5 to 3.5 m high falls
    # 1.9 to 2.6 m east.
    east_m = cells % casters.columns * 2.0 - SHADOW_REACH_M
    assert east_m.min() >= 9.5 + 1.875 - 2.0
    assert east_m.max() <= 10.5 + 2.625
