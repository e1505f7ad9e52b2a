"""The lists of candidates are complete: no ray and no shadow misses a solid."""

import numpy as np

from probevo.arrays import FloatArray
from probevo_sim.scene.candidates import (
    SHADOW_REACH_M,
    Candidates,
    image_candidates,
    shadow_candidates,
)
from probevo_sim.scene.drive import C_BODY_CAM
from probevo_sim.scene.ray_caster_numba import PixelSampling, add_radiance, first_hits
from probevo_sim.scene.scene_arrays import SceneArrays, View, scene_arrays, view_from
from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture
from sim.scene.small_world import CAMERA, world

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


def scene_and_view(solids: Solids, shadow: float = 0.0) -> tuple[SceneArrays, View]:
    place = world(solids)
    T_world_cam = np.eye(4)
    T_world_cam[:3, :3] = C_BODY_CAM
    T_world_cam[2, 3] = 1.5
    intrinsics = (CAMERA.fu_px, CAMERA.cu_px, CAMERA.cv_px)
    T_world_object = place.poses(0.0, T_world_cam)
    view = view_from(place, T_world_object, T_world_cam, intrinsics=intrinsics)
    return scene_arrays(place, shadow), view


def everything_everywhere(candidates: Candidates, nearest_m: FloatArray) -> Candidates:
    """Return lists that hold all solids in each cell."""
    cells = len(candidates.first) - 1
    order = np.argsort(nearest_m, kind="stable")
    first = np.arange(cells + 1) * len(order)
    return Candidates(
        first,
        np.tile(order, cells),
        candidates.columns,
        corner=candidates.corner,
        nearest_m=nearest_m,
    )


def test_lists_of_the_image_miss_nothing() -> None:
    for seed in range(5):
        scene, view = scene_and_view(scattered(np.random.default_rng(seed), 60))
        candidates = image_candidates(scene, view, SIZE_PX)
        found = []
        for each in (candidates, everything_everywhere(candidates, candidates.nearest_m)):
            depth_m = np.empty(SIZE_PX[::-1])
            hits = np.empty(SIZE_PX[::-1], np.int32)
            first_hits(scene, view, each, depth_m=depth_m, hits=hits)
            found.append((depth_m, hits))
        np.testing.assert_array_equal(found[0], found[1])
        assert len(np.unique(found[0][1])) > 5


def test_lists_towards_the_sun_miss_nothing() -> None:
    """The same image, whether each cell lists the solids whose shadow touches it or all of them."""
    scene, view = scene_and_view(scattered(np.random.default_rng(1), 40), shadow=1.0)
    candidates = image_candidates(scene, view, SIZE_PX)
    occluders = shadow_candidates(scene, view)
    images = []
    for each in (occluders, everything_everywhere(occluders, np.zeros(40))):
        image = np.zeros(SIZE_PX[::-1], np.float32)
        add_radiance(
            scene,
            view,
            candidates,
            occluders=each,
            time_s=0.0,
            sampling=PixelSampling(offsets_px=np.zeros((1, 2)), footprint_px=1.0),
            image=image,
        )
        images.append(image)
    np.testing.assert_array_equal(images[0], images[1])


def test_what_is_not_seen_is_in_no_list_of_the_image_but_casts_its_shadow() -> None:
    ghost = solid(
        BOX, (1.0, 1.0, 1.0), (10.0, 0.0, 3.0), texture=Texture.PLAIN, tile_m=1.0, seen=False
    )
    scene, view = scene_and_view(ghost, shadow=1.0)
    assert len(image_candidates(scene, view, SIZE_PX).solids) == 0
    occluders = shadow_candidates(scene, view)
    assert set(occluders.solids.tolist()) == {0}
    cells = np.flatnonzero(np.diff(occluders.first))
    # The sun stands in the west at a slope of 0.75: the shadow of what is 2.5 to 3.5 m high falls
    # 1.9 to 2.6 m east.
    east_m = cells % occluders.columns * 2.0 - SHADOW_REACH_M
    assert east_m.min() >= 9.5 + 1.875 - 2.0
    assert east_m.max() <= 10.5 + 2.625
