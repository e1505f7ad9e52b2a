"""Depth, disparity, flow and the moving mask are exact, and the images agree with them."""

from dataclasses import replace
from functools import cache
from typing import get_args

import cv2
import numpy as np
import pytest

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.geometry import se3
from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.recording import open_scene
from probevo_sim.scene.renderer import FULL_READOUT_S, FULL_SHUTTER_S, ROWS_AT_ONCE, Renderer
from probevo_sim.scene.sensor import expose
from probevo_sim.scene.solids import BOX, join, solid
from probevo_sim.scene.textures import Texture
from probevo_sim.scene.world import Movers
from sim.scene.small_world import (
    CAMERA,
    HEIGHT_M,
    SPEED_M_S,
    WALL_M,
    renderer,
    things,
    trajectory,
    world,
)

STEP_S = 0.1


def grey(radiance: FloatArray) -> Image:
    return expose(radiance, gain=1.2, noise=0.0, rng=np.random.default_rng(0))


def test_depth_of_ground_and_wall_is_that_of_the_plane() -> None:
    truth = renderer().pixel_truth(0.0, STEP_S)
    below = CAMERA.cv_px + CAMERA.fv_px * HEIGHT_M / WALL_M
    rows = np.arange(int(below) + 3, 128)
    middle = 160
    np.testing.assert_allclose(
        truth.depth_m[rows, middle], HEIGHT_M * CAMERA.fv_px / (rows - CAMERA.cv_px), rtol=1e-9
    )
    np.testing.assert_allclose(truth.depth_m[40 : int(below) - 2, middle], WALL_M, rtol=1e-9)


def test_depth_of_a_sphere_is_exact() -> None:
    """Its nearest point along the ray to its centre lies one radius before it."""
    center = np.array([3.0, HEIGHT_M - 1.0, 10.0])  # in the camera at t = 0: right, down, forward
    u, v = np.round(CAMERA.project(center)[:2]).astype(int)
    depth_m = renderer().pixel_truth(0.0, STEP_S).depth_m[v, u]
    ray = np.array([(u - CAMERA.cu_px) / CAMERA.fu_px, (v - CAMERA.cv_px) / CAMERA.fv_px, 1.0])
    assert np.linalg.norm(depth_m * ray - center) == pytest.approx(1.0, abs=1e-9)
    assert depth_m < 10.0


def test_the_sky_is_at_infinity() -> None:
    low_wall = join(
        [solid(BOX, (1.0, 80.0, 2.0), (WALL_M, 0.0, 1.0), texture=Texture.BRICK, tile_m=3.0)]
    )
    truth = renderer(world(low_wall)).pixel_truth(0.0, STEP_S)
    assert np.isinf(truth.depth_m[0]).all()
    np.testing.assert_array_equal(truth.disparity_px[0], 0.0)
    T_next_curr = se3.inverse(trajectory().T_world_cam(STEP_S)) @ trajectory().T_world_cam(0.0)
    u = np.arange(320)
    ray = np.stack(
        [
            (u - CAMERA.cu_px) / CAMERA.fu_px,
            np.full(320, -CAMERA.cv_px / CAMERA.fv_px),
            np.ones(320),
        ]
    )
    rotated = T_next_curr[:3, :3] @ ray
    flow_px = CAMERA.fu_px * rotated[0] / rotated[2] + CAMERA.cu_px - u
    np.testing.assert_allclose(truth.flow_px[0, :, 0], flow_px, atol=1e-9)


def test_flow_of_what_stands_still_follows_from_depth_and_motion() -> None:
    truth = renderer().pixel_truth(1.0, 1.0 + STEP_S)
    path = trajectory()
    v, u = np.mgrid[:128, :320].astype(float)
    pixels = np.stack([u, v, u - truth.disparity_px, v], axis=-1)
    T_next_curr = se3.inverse(path.T_world_cam(1.0 + STEP_S)) @ path.T_world_cam(1.0)
    moved = CAMERA.project(se3.transform(T_next_curr, CAMERA.triangulate(pixels)))
    np.testing.assert_allclose(truth.flow_px, (moved - pixels)[..., :2], atol=1e-9)


def moving_box(speed_m_s: float) -> Renderer:
    """Render a box that drives ahead of the camera, in the middle of the road."""
    box = solid(
        BOX, (3.0, 1.8, 1.4), (0.0, 0.0, 0.7), texture=Texture.CAR_FRONT, tile_m=1.8
    ).of_object(1)
    movers = Movers(
        np.array([10.0]),
        np.zeros(1),
        np.array([speed_m_s]),
        lateral_speed_m_s=np.zeros(1),
        ahead=np.zeros(1, np.bool_),
    )
    return renderer(world(join([things(), box]), movers))


def test_what_moves_is_marked_and_keeps_its_place_if_it_moves_with_the_camera() -> None:
    scene = moving_box(SPEED_M_S)
    truth = scene.pixel_truth(0.0, STEP_S)
    u = 160
    v = 75
    assert truth.moving[v, u]
    assert 0.01 < truth.moving.mean() < 0.2
    T_next_curr = se3.inverse(trajectory().T_world_cam(STEP_S)) @ trajectory().T_world_cam(0.0)
    # The box keeps its distance, so only the camera's rotation moves it in the image.
    rotation_px = CAMERA.fu_px * T_next_curr[0, 2]
    assert truth.flow_px[v, u, 0] == pytest.approx(rotation_px, abs=0.3)
    assert not renderer().pixel_truth(0.0, STEP_S).moving.any()


def textured_points(image: Image, disparity_px: FloatArray, count: int) -> FloatArray:
    """Find corners whose window lies on one surface: its disparities fit a plane to 0.05 px."""
    corners = cv2.goodFeaturesToTrack(image, count, 0.01, 4)[:, 0]
    half = 7
    kept = []
    window = np.column_stack(
        [np.ones((2 * half + 1) ** 2), *np.mgrid[-half : half + 1, -half : half + 1].reshape(2, -1)]
    )
    residual_maker = np.eye(len(window)) - window @ np.linalg.pinv(window)
    for u, v in np.round(corners).astype(int).tolist():
        patch = disparity_px[max(v - half, 0) : v + half + 1, max(u - half, 0) : u + half + 1]
        if patch.size == len(window) and np.abs(residual_maker @ patch.ravel()).max() < 0.05:
            kept.append((u, v))
    return np.array(kept, dtype=np.float32).reshape(-1, 2)


def feature_errors(
    first: Image, second: Image, flow_px: FloatArray, points: FloatArray
) -> FloatArray:
    """Return the displacement of points between two images beyond the true flow, [N, 2], px.

    The second image is warped back by the true flow of each pixel, so that perspective is no part
    of the error.
    """
    v, u = np.mgrid[: first.shape[0], : first.shape[1]].astype(np.float32)
    there = np.dstack([u, v]) + flow_px.astype(np.float32)
    warped = cv2.remap(second, there, None, cv2.INTER_CUBIC)
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-4)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        first, warped, points[:, None], None, winSize=(11, 11), maxLevel=0, criteria=criteria
    )
    target = there[points[:, 1].astype(int), points[:, 0].astype(int)]
    inside: BoolArray = ((target > 9) & (target < [first.shape[1] - 10, first.shape[0] - 10])).all(
        axis=1
    )
    return (found[:, 0] - points)[inside & (status[:, 0] > 0)]


@pytest.mark.slow
@pytest.mark.parametrize("preset", get_args(PresetName))
def test_correlated_images_agree_with_the_truth_at_a_thousand_points(preset: PresetName) -> None:
    """Median errors of flow are below 0.055 px, of disparity 0.05 px, of rows 0.02 px.

    In no direction is the median more than 0.01 px. The points, about as many in time as in stereo,
    come from pairs of frames all along the drive, each image of which is rendered once.
    """
    recording = open_scene(SceneConfig(preset=preset))
    flow_error = [np.zeros((0, 2))]
    stereo_error = [np.zeros((0, 2))]
    images = cache(recording.images)
    first = np.linspace(0, len(recording) - 3, 20).astype(int)
    frames = iter((first[:, None] + np.arange(2)).ravel().tolist())
    while len(np.concatenate([*flow_error, *stereo_error])) < 1000:
        index = next(frames)
        left, right = images(index)
        following, _ = images(index + 1)
        truth = recording.pixel_truth(index)
        points = textured_points(left, truth.disparity_px, 600)
        flow_error.append(feature_errors(left, following, truth.flow_px, points))
        to_right = np.dstack([-truth.disparity_px, np.zeros_like(truth.disparity_px)])
        stereo_error.append(feature_errors(left, right, to_right, points))
    flow = np.concatenate(flow_error)
    stereo = np.concatenate(stereo_error)
    medians = [np.median(np.linalg.norm(flow, axis=1)), *np.median(np.abs(stereo), axis=0)]
    print(f"{preset}: flow {medians[0]:.3f}, disparity {medians[1]:.3f}, rows {medians[2]:.3f} px")
    assert medians[0] < 0.055
    assert medians[1] < 0.05
    assert medians[2] < 0.02
    assert np.abs(np.median(flow, axis=0)).max() < 0.01
    assert np.abs(np.median(stereo, axis=0)).max() < 0.01


@pytest.mark.parametrize("strength", [0.3, 0.8])
def test_blur_is_the_mean_over_the_time_that_the_shutter_is_open(strength: float) -> None:
    """It is nearer to the mean of sharp images over that time than over half or twice that time.

    Of 8 images over twice the time, the middle half covers that time, and the middle quarter half
    of it.
    """
    blurred, _ = renderer(blur=strength).pair(1.0)
    sharp = renderer()
    times_s = 1.0 + 2.0 * FULL_SHUTTER_S * strength * ((np.arange(8) + 0.5) / 8 - 0.5)
    images = np.array([sharp.pair(t_s)[0] for t_s in times_s])
    middles = [images[3:5], images[2:6], images]
    error = [np.abs(cv2.blur(blurred - middle.mean(axis=0), (3, 3))).mean() for middle in middles]
    assert error[1] < 0.7 * min(error[0], error[2])


def test_a_rectification_error_moves_the_rows_of_the_right_image_only() -> None:
    good = renderer()
    bad = renderer(rectification=1.0)
    np.testing.assert_array_equal(good.pair(0.0)[0], bad.pair(0.0)[0])
    truth = good.pixel_truth(0.0, STEP_S)
    left, right = map(grey, bad.pair(0.0))
    to_right = np.dstack([-truth.disparity_px, np.zeros_like(truth.disparity_px)])
    error = feature_errors(left, right, to_right, textured_points(left, truth.disparity_px, 400))
    assert 0.1 < np.median(np.abs(error[:, 1])) < 1.0


def test_same_instant_same_bytes() -> None:
    first = renderer(blur=0.3, shadows=1.0)
    second = renderer(blur=0.3, shadows=1.0)
    np.testing.assert_array_equal(first.pair(0.7), second.pair(0.7))


def test_a_camera_without_a_size_is_refused() -> None:
    with pytest.raises(ValueError, match="size_px"):
        Renderer(world(), trajectory(), replace(CAMERA, size_px=None), effects=Effects())


def test_the_rows_of_a_rolling_shutter_are_of_their_own_times() -> None:
    """Each pair of rows is that of a global shutter at its time; the middle is that of the
    frame."""
    rolling = renderer(rolling_shutter=0.5).pair(1.0)
    height = CAMERA.size_px[1] if CAMERA.size_px else 0
    for top in (0, 62, 126):
        late_s = 0.5 * FULL_READOUT_S * ((top + 0.5) / (height - 1) - 0.5)
        rows = slice(top, top + ROWS_AT_ONCE)
        for found, expected in zip(rolling, renderer().pair(1.0 + late_s), strict=True):
            np.testing.assert_allclose(found[rows], expected[rows], atol=1e-5)
    of_row_63_s = 0.5 * FULL_READOUT_S * (63.0 / (height - 1) - 0.5)
    assert abs(of_row_63_s) < 2e-4


def test_the_truth_of_a_rolling_shutter_is_of_the_times_of_its_rows() -> None:
    """Each row is as a global shutter at its time sees it, and its flow leads to where the row in
    which a point then lies sees it."""
    height = CAMERA.size_px[1] if CAMERA.size_px else 0

    def late_s(row: float) -> float:
        middle = ROWS_AT_ONCE * np.floor(row / ROWS_AT_ONCE) + 0.5
        return FULL_READOUT_S * float(middle / (height - 1) - 0.5)

    truth = renderer(rolling_shutter=1.0).pixel_truth(1.0, 1.0 + STEP_S)
    for v, u in ((10, 200), (63, 160), (90, 60), (110, 160)):
        next_v = float(np.rint(v + truth.flow_px[v, u, 1]))
        time_s = 1.0 + late_s(v)
        expected = renderer().pixel_truth(time_s, 1.0 + STEP_S + late_s(next_v))
        assert truth.depth_m[v, u] == pytest.approx(expected.depth_m[v, u], rel=1e-12)
        assert truth.disparity_px[v, u] == pytest.approx(expected.disparity_px[v, u], rel=1e-12)
        np.testing.assert_allclose(truth.flow_px[v, u], expected.flow_px[v, u], atol=1e-9)
    at_once = renderer().pixel_truth(1.0, 1.0 + STEP_S)
    assert abs(truth.depth_m[10, 200] - at_once.depth_m[10, 200]) > 0.1
