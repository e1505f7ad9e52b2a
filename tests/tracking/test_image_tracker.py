"""Lucas–Kanade on a textured plane, rendered without interpolation, against the flow that its
homography gives."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.config import TrackingConfig
from probevo.geometry import se3
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking import ImageTracker, Tracks, tracker_for

SIZE_PX = WIDTH_PX, HEIGHT_PX = 320, 200
CAMERA = StereoCamera(
    fu_px=250.0, fv_px=250.0, cu_px=160.0, cv_px=100.0, baseline_m=0.3, size_px=SIZE_PX
)
DEPTH_M = 5.0
"""Of the plane, which faces the first camera: 15 px of disparity."""
CONFIG = TrackingConfig(num_features=150)
STEP = np.array([0.02, -0.01, -0.15, 0.004, -0.006, 0.01])
"""Log(T_curr_prev) of every step: forward, with a turn about all axes; up to 8 px of flow."""


def plane_points(pixels: FloatArray, T_cam_world: FloatArray) -> FloatArray:
    """Where the rays of left pixels [N, 2] meet the plane z = DEPTH_M of the world, [N, 3], m,
    world frame."""
    T_world_cam = se3.inverse(T_cam_world)
    normalized = (pixels - [CAMERA.cu_px, CAMERA.cv_px]) / [CAMERA.fu_px, CAMERA.fv_px]
    rays = np.column_stack([normalized, np.ones(len(pixels))]) @ T_world_cam[:3, :3].T
    center = T_world_cam[:3, 3]
    return center + rays * ((DEPTH_M - center[2]) / rays[:, 2])[:, None]


def texture(x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Smooth and random: 60 waves of 0.1 to 1.5 m, which are 5 to 75 px, around 128."""
    rng = np.random.default_rng(0)
    wave_rad_m, direction, phase = (
        2 * np.pi / np.geomspace(0.1, 1.5, 60),
        *rng.uniform(0, 2 * np.pi, (2, 60)),
    )
    along = np.multiply.outer(x_m, wave_rad_m * np.cos(direction)) + np.multiply.outer(
        y_m, wave_rad_m * np.sin(direction)
    )
    return 128.0 + 7.0 * np.sin(along + phase).sum(axis=-1)


def render(T_cam_world: FloatArray) -> Image:
    v, u = np.mgrid[:HEIGHT_PX, :WIDTH_PX].reshape(2, -1).astype(float)
    points = plane_points(np.column_stack([u, v]), T_cam_world)
    brightness = texture(points[:, 0], points[:, 1]).reshape(HEIGHT_PX, WIDTH_PX)
    return np.clip(np.round(brightness), 0, 255).astype(np.uint8)


def pose(index: int) -> FloatArray:
    """T_cam_world of a frame."""
    return np.asarray(se3.exp(index * STEP))


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    T_right_left = se3.exp(np.array([-CAMERA.baseline_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    return [
        Frame(k, 100_000_000 * k, render(pose(k)), right=render(T_right_left @ pose(k)))
        for k in range(4)
    ]


def follow(
    frames: Sequence[Frame], expected: FloatArray | None = None, config: TrackingConfig = CONFIG
) -> Tracks:
    """Tracks of the last frame; the search starts from the true motion, or from the one given."""
    tracker = ImageTracker(CAMERA, config)
    return [
        tracker.track(frame, se3.exp(STEP) if expected is None else expected) for frame in frames
    ][-1]


def true_pixels(left_px: FloatArray, index: int, at: int) -> FloatArray:
    """Observations in frame ``at``, [N, 4], of the points seen at left pixels [N, 2] of frame
    ``index``."""
    return CAMERA.project(se3.transform(pose(at), plane_points(left_px, pose(index))))


def median_error_px(tracks: Tracks, index: int) -> float:
    """Of the current observations, the left pixels of the previous frame being the points'
    identity."""
    return float(
        np.median(np.abs(tracks.curr_px - true_pixels(tracks.prev_px[:, :2], index - 1, index)))
    )


def test_tracked_positions_agree_with_the_homography(frames: list[Frame]) -> None:
    tracks = follow(frames[:2])
    true = true_pixels(tracks.prev_px[:, :2], 0, 1)
    assert len(tracks) > 60
    assert np.median(np.abs(tracks.curr_px[:, :2] - true[:, :2])) < 0.1


def test_right_positions_agree_with_the_depth(frames: list[Frame]) -> None:
    tracks = follow(frames[:2])
    for pixels, index in ((tracks.prev_px, 0), (tracks.curr_px, 1)):
        true = true_pixels(pixels[:, :2], index, index)
        assert np.median(np.abs(pixels[:, 2] - true[:, 2])) < 0.1
        assert np.median(np.abs(pixels[:, 3] - true[:, 3])) < 0.1


def test_positions_do_not_drift_over_several_frames(frames: list[Frame]) -> None:
    """The oldest points, found in frame 0, are still where it saw them after three steps."""
    tracker = ImageTracker(CAMERA, CONFIG)
    first, *_, last = [tracker.track(frame, se3.exp(STEP)) for frame in frames][1:]
    _, before, now = np.intersect1d(first.ids, last.ids, return_indices=True)
    true = true_pixels(first.prev_px[before, :2], 0, 3)
    assert len(now) > 30
    assert np.median(np.abs(last.curr_px[now] - true)) < 0.15


def test_points_are_found_from_a_poor_start(frames: list[Frame]) -> None:
    assert median_error_px(follow(frames[:2], np.eye(4)), 1) < 0.1


def test_identities_persist_and_ages_grow(frames: list[Frame]) -> None:
    """What is found in frame k and was found in k − 1 keeps its identity, is where it was, and is
    one frame older."""
    tracker = ImageTracker(CAMERA, CONFIG)
    steps = [tracker.track(frame, se3.exp(STEP)) for frame in frames]
    for before, now in pairwise(steps[1:]):
        common, i, j = np.intersect1d(before.ids, now.ids, return_indices=True)
        assert len(common) > 30
        np.testing.assert_array_equal(before.curr_px[i], now.prev_px[j])
        np.testing.assert_array_equal(before.age[i] + 1, now.age[j])
        assert (np.delete(now.age, j) == 2).all()


def test_no_identity_is_given_twice(frames: list[Frame]) -> None:
    """A new point's identity is larger than all that were given before."""
    tracker = ImageTracker(CAMERA, CONFIG)
    largest = -1
    for frame in frames:
        tracks = tracker.track(frame, se3.exp(STEP))
        assert len(np.unique(tracks.ids)) == len(tracks)
        assert (tracks.ids[tracks.age == 2] > largest).all()
        largest = max([largest, *tracks.ids[tracks.age > 2], *tracks.ids])


def test_what_no_longer_looks_as_at_first_sight_is_another_point() -> None:
    """A window that reaches out of the image cannot be compared: the point is followed, under a new
    identity."""
    sideways = np.array([-0.008, 0.0, 0.0, 0.0, 0.0, 0.0])  # 0.4 px a frame, to the left
    T_right_left = se3.exp(np.array([-CAMERA.baseline_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    poses = [np.asarray(se3.exp(k * sideways)) for k in range(8)]
    tracker = ImageTracker(CAMERA, CONFIG)
    renamed = 0
    steps = [
        tracker.track(
            Frame(k, 100_000_000 * k, render(T), right=render(T_right_left @ T)), se3.exp(sideways)
        )
        for k, T in enumerate(poses)
    ]
    for before, now in pairwise(steps[1:]):
        at_border = (
            before.curr_px[:, 2] < 5.9
        )  # with half a window of 5 px, and the pixel next to it
        followed = (now.prev_px[:, None] == before.curr_px[at_border]).all(axis=2).any(axis=1)
        assert not np.isin(now.ids[followed], before.ids).any()
        assert (now.age[followed] == 2).all()
        renamed += int(followed.sum())
    assert renamed > 5


def test_dropped_points_are_not_followed(frames: list[Frame]) -> None:
    tracker = ImageTracker(CAMERA, CONFIG)
    tracks = [tracker.track(frame, se3.exp(STEP)) for frame in frames[:2]][-1]
    dropped = tracks.ids[::2]
    tracker.drop(dropped)
    after = tracker.track(frames[2], se3.exp(STEP))
    assert not np.isin(after.ids, dropped).any()
    assert np.isin(after.ids, tracks.ids[1::2]).any()


def test_dropping_before_the_first_frame_does_nothing(frames: list[Frame]) -> None:
    tracker = ImageTracker(CAMERA, CONFIG)
    untouched = ImageTracker(CAMERA, CONFIG)
    tracker.drop(np.array([1, 2]))
    first, second = (
        [t.track(frame, np.eye(4)) for frame in frames[:2]][-1] for t in (tracker, untouched)
    )
    np.testing.assert_array_equal(first.curr_px, second.curr_px)


def test_the_first_frame_has_no_tracks(frames: list[Frame]) -> None:
    assert len(follow(frames[:1])) == 0


def test_points_that_leave_the_view_are_counted(frames: list[Frame]) -> None:
    """A motion of 4 m to the right takes the points of the left 200 px out of the image."""
    beyond = se3.exp(np.array([-4.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    tracker = ImageTracker(CAMERA, CONFIG)
    tracker.track(frames[0], np.eye(4))
    assert tracker.track(frames[1], beyond).rejected["left the view"] > 60


def test_points_that_vanish_are_counted(frames: list[Frame]) -> None:
    """Lucas–Kanade believes that it finds them on an even image; there they have nothing to be
    matched by."""
    grey = np.full((HEIGHT_PX, WIDTH_PX), 128, np.uint8)
    tracks = follow([frames[0], replace(frames[1], left=grey)])
    assert len(tracks) == 0
    assert sum(tracks.rejected.values()) >= len(follow(frames[:2]))


def test_rows_that_differ_are_counted(frames: list[Frame]) -> None:
    shifted = [replace(frame, right=np.roll(frame.right, 6, axis=0)) for frame in frames[:2]]
    tracks = follow(shifted)
    assert len(tracks) < 5
    assert tracks.rejected["rows differ"] > 60


def test_swapped_cameras_show_as_negative_disparity(frames: list[Frame]) -> None:
    swapped = [replace(frame, left=frame.right, right=frame.left) for frame in frames[:2]]
    tracks = follow(swapped)
    assert len(tracks) < 5
    assert tracks.rejected["negative disparity"] > 60


def test_a_change_of_exposure_between_frames_does_no_harm(frames: list[Frame]) -> None:
    assert frames[1].left is not None
    assert frames[1].right is not None
    darker = replace(frames[1], left=0.9 * frames[1].left - 20, right=0.9 * frames[1].right - 20)
    darker = replace(darker, left=np.clip(darker.left, 0, 255).astype(np.uint8))
    darker = replace(darker, right=np.clip(darker.right, 0, 255).astype(np.uint8))
    assert median_error_px(follow([frames[0], darker]), 1) < 0.1


def test_a_brighter_right_camera_does_no_harm(frames: list[Frame]) -> None:
    brighter = [
        replace(frame, right=np.clip(frame.right.astype(int) + 30, 0, 255).astype(np.uint8))
        for frame in frames[:2]
    ]
    assert median_error_px(follow(brighter), 1) < 0.1


def test_frames_without_texture_give_nothing() -> None:
    grey = np.full((HEIGHT_PX, WIDTH_PX), 128, np.uint8)
    assert len(follow([Frame(k, k, grey, right=grey) for k in range(3)])) == 0


def test_the_same_images_give_the_same_tracks(frames: list[Frame]) -> None:
    first = follow(frames)
    second = follow(frames)
    np.testing.assert_array_equal(first.curr_px, second.curr_px)
    np.testing.assert_array_equal(first.ids, second.ids)


def test_a_frame_of_features_is_refused() -> None:
    features = StereoFeatures(np.zeros(0, np.int64), np.zeros((0, 4)))
    with pytest.raises(ValueError, match="frame 2 has no images"):
        ImageTracker(CAMERA, CONFIG).track(Frame(2, 0, features=features), np.eye(4))


def test_frames_with_images_get_this_tracker(frames: list[Frame]) -> None:
    assert isinstance(tracker_for(frames[0], CAMERA, CONFIG), ImageTracker)
