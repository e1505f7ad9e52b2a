"""Lucas–Kanade on a textured plane, rendered without interpolation, against the flow that its
homography gives."""

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise

import cv2
import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.config import TrackingConfig
from probevo.geometry import se3
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking import ImageTracker, Tracked, TrackingState, Tracks, tracker_for

WIDTH_PX = 320
HEIGHT_PX = 200
SIZE_PX = (WIDTH_PX, HEIGHT_PX)
CAMERA = StereoCamera(
    fu_px=250.0, fv_px=250.0, cu_px=160.0, cv_px=100.0, baseline_m=0.3, size_px=SIZE_PX
)
DEPTH_M = 5.0
"""Of the plane, which faces the first camera: 15 px of disparity."""
CONFIG = TrackingConfig(num_features=150)
STEP = np.array([0.02, -0.01, -0.15, 0.004, -0.006, 0.01])
"""Log(T_curr_prev) of every step: forward, with a turn about all axes; up to 8 px of flow."""


def plane_points(pixels: FloatArray, T_cam_world: FloatArray) -> FloatArray:
    """Return where the rays of left pixels [N, 2] meet the plane z = DEPTH_M of the world, [N, 3],
    m, world frame."""
    T_world_cam = se3.inverse(T_cam_world)
    normalized = (pixels - [CAMERA.cu_px, CAMERA.cv_px]) / [CAMERA.fu_px, CAMERA.fv_px]
    rays = np.column_stack([normalized, np.ones(len(pixels))]) @ T_world_cam[:3, :3].T
    center = T_world_cam[:3, 3]
    return center + rays * ((DEPTH_M - center[2]) / rays[:, 2])[:, None]


def texture(x_m: FloatArray, y_m: FloatArray) -> FloatArray:
    """Return a smooth random texture around 128: 60 waves of 0.1 to 1.5 m, which are 5 to 75 px."""
    rng = np.random.default_rng(0)
    wave_rad_m = 2 * np.pi / np.geomspace(0.1, 1.5, 60)
    direction, phase = rng.uniform(0, 2 * np.pi, (2, 60))
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
    """Return T_cam_world of a frame."""
    return np.asarray(se3.exp(index * STEP))


@pytest.fixture(scope="module")
def frames() -> list[Frame]:
    T_right_left = se3.exp(np.array([-CAMERA.baseline_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    return [
        Frame(k, 100_000_000 * k, render(pose(k)), right=render(T_right_left @ pose(k)))
        for k in range(4)
    ]


def track_all(
    frames: Sequence[Frame], T_start: FloatArray | None = None, config: TrackingConfig = CONFIG
) -> list[Tracked]:
    """Track every frame from the state that the one before left.

    The search starts from the true motion, or from the one given.
    """
    tracker = ImageTracker(CAMERA, config)
    start = se3.exp(STEP) if T_start is None else T_start
    state = TrackingState.none()
    found = []
    for frame in frames:
        tracked = tracker.track(state, frame, start)
        state = tracked.state
        found.append(tracked)
    return found


def follow(
    frames: Sequence[Frame], T_start: FloatArray | None = None, config: TrackingConfig = CONFIG
) -> Tracks:
    """Return the tracks of the last frame."""
    return track_all(frames, T_start, config)[-1].tracks


def true_pixels(left_px: FloatArray, index: int, at: int) -> FloatArray:
    """Return the observations in frame ``at``, [N, 4], of the points seen at left pixels [N, 2] of
    frame ``index``."""
    return CAMERA.project(se3.transform(pose(at), plane_points(left_px, pose(index))))


def median_error_px(tracks: Tracks, index: int) -> float:
    """Return the median error of the current observations; a point is what the left pixels of the
    previous frame show."""
    true = true_pixels(tracks.prev_px[:, :2], index - 1, index)
    return float(np.median(np.abs(tracks.curr_px - true)))


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
    steps = track_all(frames)
    first = steps[1].tracks
    last = steps[-1].tracks
    _, in_first, in_last = np.intersect1d(first.ids, last.ids, return_indices=True)
    true = true_pixels(first.prev_px[in_first, :2], 0, 3)
    assert len(in_last) > 30
    assert np.median(np.abs(last.curr_px[in_last] - true)) < 0.15


def test_points_are_found_from_a_poor_start(frames: list[Frame]) -> None:
    assert median_error_px(follow(frames[:2], np.eye(4)), 1) < 0.1


def test_identities_persist_and_ages_grow(frames: list[Frame]) -> None:
    """What is found in frame k and was found in k − 1 keeps its identity, is where it was, and is
    one frame older."""
    steps = [tracked.tracks for tracked in track_all(frames)]
    for prev, curr in pairwise(steps[1:]):
        common, i, j = np.intersect1d(prev.ids, curr.ids, return_indices=True)
        assert len(common) > 30
        np.testing.assert_array_equal(prev.curr_px[i], curr.prev_px[j])
        np.testing.assert_array_equal(prev.age[i] + 1, curr.age[j])
        assert (np.delete(curr.age, j) == 2).all()


def test_no_identity_is_given_twice(frames: list[Frame]) -> None:
    """A new point's identity is larger than all that were given before."""
    largest = -1
    for tracked in track_all(frames):
        tracks = tracked.tracks
        assert len(np.unique(tracks.ids)) == len(tracks)
        assert (tracks.ids[tracks.age == 2] > largest).all()
        largest = max([largest, *tracks.ids[tracks.age > 2], *tracks.ids])


def test_what_cannot_be_compared_with_its_first_sight_is_lost() -> None:
    """As where the window reaches out of the image: which point is followed there is not known."""
    sideways = np.array([-0.008, 0.0, 0.0, 0.0, 0.0, 0.0])  # 0.4 px a frame, to the left
    T_right_left = se3.exp(np.array([-CAMERA.baseline_m, 0.0, 0.0, 0.0, 0.0, 0.0]))
    poses = [np.asarray(se3.exp(k * sideways)) for k in range(8)]
    frames = [
        Frame(k, 100_000_000 * k, render(T), right=render(T_right_left @ T))
        for k, T in enumerate(poses)
    ]
    lost = 0
    for tracked in track_all(frames, se3.exp(sideways)):
        # With half a window of 5 px, and the pixel next to it.
        assert (tracked.state.pixels[:, 2] >= 5.9).all()
        lost += tracked.tracks.rejected.get("no longer looks as at first sight", 0)
    assert lost > 5


def test_dropped_points_are_not_followed(frames: list[Frame]) -> None:
    tracked = track_all(frames[:2])[-1]
    ids = tracked.tracks.ids
    dropped = ids[::2]
    after = ImageTracker(CAMERA, CONFIG).track(
        tracked.state.without(dropped), frames[2], se3.exp(STEP)
    )
    assert not np.isin(after.tracks.ids, dropped).any()
    assert np.isin(after.tracks.ids, ids[1::2]).any()


def test_dropping_before_the_first_frame_does_nothing(frames: list[Frame]) -> None:
    tracker = ImageTracker(CAMERA, CONFIG)
    followed = []
    for state in (TrackingState.none().without(np.array([1, 2])), TrackingState.none()):
        first = tracker.track(state, frames[0], np.eye(4))
        followed.append(tracker.track(first.state, frames[1], np.eye(4)).tracks)
    np.testing.assert_array_equal(followed[0].curr_px, followed[1].curr_px)


def test_tracking_leaves_the_state_as_it_was(frames: list[Frame]) -> None:
    """A tracker only proposes: whoever tracks a frame twice from one state gets the same twice."""
    tracker = ImageTracker(CAMERA, CONFIG)
    state = track_all(frames[:2])[-1].state
    arrays = (state.ids, state.pixels, state.age)
    copies = [array.copy() for array in arrays]
    first = tracker.track(state, frames[2], se3.exp(STEP))
    tracker.track(state, frames[3], np.eye(4))
    again = tracker.track(state, frames[2], se3.exp(STEP))
    for array, copy in zip(arrays, copies, strict=True):
        np.testing.assert_array_equal(array, copy)
    assert first.tracks.curr_px.tobytes() == again.tracks.curr_px.tobytes()
    assert first.state.pixels.tobytes() == again.state.pixels.tobytes()
    np.testing.assert_array_equal(first.state.ids, again.state.ids)


def test_the_first_frame_has_no_tracks(frames: list[Frame]) -> None:
    assert len(follow(frames[:1])) == 0


def test_points_that_leave_the_view_are_counted(frames: list[Frame]) -> None:
    """A motion of 4 m to the right takes the points of the left 200 px out of the image."""
    beyond = se3.exp(np.array([-4.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    tracker = ImageTracker(CAMERA, CONFIG)
    first = tracker.track(TrackingState.none(), frames[0], np.eye(4))
    assert tracker.track(first.state, frames[1], beyond).tracks.rejected["left the view"] > 60


def test_points_that_vanish_are_counted(frames: list[Frame]) -> None:
    """Lucas–Kanade claims to find them on an even image; the stereo match then has no texture to go
    by."""
    grey = np.full((HEIGHT_PX, WIDTH_PX), 128, np.uint8)
    tracks = follow([frames[0], replace(frames[1], left=grey)])
    assert len(tracks) == 0
    assert sum(tracks.rejected.values()) >= len(follow(frames[:2]))


def test_rows_that_differ_are_counted(frames: list[Frame]) -> None:
    shifted = [replace(frame, right=np.roll(frame.right, 6, axis=0)) for frame in frames[:2]]
    tracks = follow(shifted)
    assert len(tracks) < 5
    assert tracks.rejected["rows differ"] > 60


def test_windows_that_look_different_in_another_row_have_no_match(frames: list[Frame]) -> None:
    """Noise leads Lucas–Kanade anywhere, which says nothing of the rows."""
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT_PX, WIDTH_PX), np.uint8)
    tracks = follow([frames[0], replace(frames[1], right=noise)])
    assert tracks.rejected["rows differ"] < 5
    assert tracks.rejected["no stereo match"] > 60


def test_swapped_cameras_show_as_negative_disparity(frames: list[Frame]) -> None:
    swapped = [replace(frame, left=frame.right, right=frame.left) for frame in frames[:2]]
    tracks = follow(swapped)
    assert len(tracks) < 5
    assert tracks.rejected["negative disparity"] > 60


def near_wall(disparity_px: int, frames: int = 4) -> list[Frame]:
    """Frames of a wall at one disparity, which moves by one pixel a frame along both axes."""
    rng = np.random.default_rng(0)
    shape = (HEIGHT_PX + frames, WIDTH_PX + disparity_px + frames)
    grey = np.zeros(shape)
    for grain_px in (1, 2, 4, 8):
        coarse = rng.normal(size=(shape[0] // grain_px + 1, shape[1] // grain_px + 1))
        grey += cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)
    wall = np.clip(128.0 + 20.0 * grey, 0, 255).astype(np.uint8)
    # Left pixel u shows the column u of the wall, right pixel u the column u + d.
    return [
        Frame(
            k,
            100_000_000 * k,
            np.ascontiguousarray(wall[k:, k:][:HEIGHT_PX, :WIDTH_PX]),
            right=np.ascontiguousarray(wall[k:, k + disparity_px :][:HEIGHT_PX, :WIDTH_PX]),
        )
        for k in range(frames)
    ]


def test_a_near_wall_does_not_look_swapped() -> None:
    """Its matches are out of reach: Lucas–Kanade ends anywhere, also to the right."""
    for tracked in track_all(near_wall(disparity_px=120), np.eye(4)):
        assert tracked.tracks.rejected["negative disparity"] < 3


@pytest.mark.parametrize("disparity_px", [10, 40, 75])
def test_new_corners_are_found_at_any_disparity(disparity_px: int) -> None:
    """Up to a quarter of the width, in the first frame, without a feature to start from."""
    state = track_all(near_wall(disparity_px, frames=1))[0].state
    found_px = state.pixels[:, 0] - state.pixels[:, 2]
    assert len(state) > 50
    np.testing.assert_allclose(found_px, disparity_px, atol=0.1)


def test_new_corners_are_found_in_noisy_images() -> None:
    """Noise of 30 grey levels makes windows alike all along a row, but less so in images of half
    the size."""
    rng = np.random.default_rng(1)
    (wall,) = near_wall(disparity_px=10, frames=1)
    noisy = replace(wall, left=_noisy(wall.left, rng), right=_noisy(wall.right, rng))
    (tracked,) = track_all([noisy], np.eye(4))
    assert tracked.tracks.rejected["repeats along its row"] < 0.2 * len(tracked.state)


def _noisy(image: Image | None, rng: np.random.Generator) -> Image:
    assert image is not None
    return np.clip(image + 30.0 * rng.normal(size=image.shape), 0, 255).astype(np.uint8)


def test_a_near_wall_that_is_swapped_looks_so() -> None:
    swapped = [
        replace(frame, left=frame.right, right=frame.left) for frame in near_wall(disparity_px=70)
    ]
    for tracked in track_all(swapped, np.eye(4)):
        assert len(tracked.state) < 5
        assert tracked.tracks.rejected["negative disparity"] > 50


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
        ImageTracker(CAMERA, CONFIG).track(
            TrackingState.none(), Frame(2, 0, features=features), np.eye(4)
        )


def test_frames_with_images_get_this_tracker(frames: list[Frame]) -> None:
    assert isinstance(tracker_for(frames[0], CAMERA, CONFIG), ImageTracker)


def test_features_fixed_to_the_vehicle_are_searched_where_they_are(frames: list[Frame]) -> None:
    """The motion would take them out of reach; those of the scene are lost then."""
    tracker = ImageTracker(CAMERA, CONFIG)
    state = tracker.track(TrackingState.none(), frames[0], np.eye(4)).state
    fixed_ids = state.ids[::2]
    again = replace(frames[0], index=1)
    far = se3.exp(np.array([2.0, 0.0, 0.0, 0.0, 0.0, 0.0]))
    found = tracker.track(replace(state, fixed_ids=fixed_ids), again, far)
    assert len(found.tracks_of_vehicle) > 0.9 * len(fixed_ids)
    assert len(found.tracks_of_scene) < 0.1 * len(fixed_ids)
    np.testing.assert_array_equal(found.state.fixed_ids, found.tracks_of_vehicle.ids)
    # Of a scene that moves, none stays where it is.
    moved = tracker.track(replace(state, fixed_ids=fixed_ids), frames[1], se3.exp(STEP))
    assert len(moved.tracks_of_vehicle) < 0.1 * len(fixed_ids)
    assert np.isin(fixed_ids, moved.tracks_of_scene.ids).mean() > 0.5


@pytest.mark.parametrize("window_px", [11, 31])
def test_windows_that_a_pan_moves_over_the_border_have_left_the_view(
    window_px: int, frames: list[Frame]
) -> None:
    """Not their looks have changed. With a large window, more of them leave the image."""
    config = TrackingConfig(num_features=150, window_px=window_px)
    tracker = ImageTracker(CAMERA, config)
    first = tracker.track(TrackingState.none(), frames[0], np.eye(4))
    panned = replace(
        frames[1],
        left=np.roll(frames[0].left, 6, axis=1),
        right=np.roll(frames[0].right, 6, axis=1),
    )
    rejected = tracker.track(first.state, panned, np.eye(4)).tracks.rejected
    at_border = first.state.pixels[:, 0] > WIDTH_PX - (window_px // 2 + 6 + 2)
    assert rejected["left the view"] >= 0.8 * at_border.sum() > 0
    assert rejected["no longer looks as at first sight"] <= 0.2 * rejected["left the view"] + 2
