"""Where tracking starts while the rotation is not known: about where the images say."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.search_starts import (
    REACH_PX,
    rotated_starts,
    track_from_best_start,
)
from probevo.geometry import se3, so3
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking import IdentityTracker, ImageTracker, Tracked, TrackingState, Tracks
from probevo.tracking.anchor_patches import AnchorPatches
from probevo.tracking.image_rotation import coarse_rotation
from probevo.tracking.image_tracker import LEFT_THE_VIEW, Followed
from probevo.tracking.preparation import prepare_images

WIDTH_PX = 640
HEIGHT_PX = 240
CAMERA = StereoCamera(
    500.0, 490.0, 320.0, cv_px=120.0, baseline_m=0.5, size_px=(WIDTH_PX, HEIGHT_PX)
)


def scene() -> Image:
    """Blobs of all sizes, twice as large as the image."""
    rng = np.random.default_rng(0)
    levels = [
        cv2.resize(
            rng.normal(size=(2 * HEIGHT_PX // s, 2 * WIDTH_PX // s)),
            (2 * WIDTH_PX, 2 * HEIGHT_PX),
            None,
            0,
            0,
        )
        for s in (4, 16, 64)
    ]
    return cv2.normalize(sum(levels), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def view(left: int, top: int) -> Image:
    """What is seen from there, with sensor noise."""
    cut = scene()[top : top + HEIGHT_PX, left : left + WIDTH_PX].astype(float)
    return np.clip(cut + np.random.default_rng(left).normal(0.0, 4.0, cut.shape), 0, 255).astype(
        np.uint8
    )


def frame(index: int, image: Image | None) -> Frame:
    return Frame(index, index, image, right=image)


def prediction(sigma_rad: float) -> MotionPrediction:
    T = se3.from_parts(np.eye(3), np.array([0.0, 0.0, -1.0]))
    sigma = np.diag([0.1, 0.1, 0.1, sigma_rad, sigma_rad, sigma_rad])
    return MotionPrediction(T, sigma**2, velocity_sensitivity=sigma)


@pytest.mark.parametrize("moved", [(0, 0), (90, 0), (-60, 0), (0, 25), (40, -20)])
def test_the_rotation_takes_the_middle_of_the_image_where_it_went(moved: tuple[int, int]) -> None:
    """To a fifth of what the tracker bridges; the content moves against the view."""
    du, dv = moved
    C = coarse_rotation(view(300, 120), view(300 - du, 120 - dv), CAMERA)
    ray = C @ [0.0, 0.0, 1.0]
    went = np.array([CAMERA.fu_px, CAMERA.fv_px]) * ray[:2] / ray[2]
    np.testing.assert_allclose(went, moved, atol=0.2 * REACH_PX)


def test_an_uncertain_rotation_gives_one_more_start_with_the_predicted_translation() -> None:
    prev = frame(0, view(300, 120))
    curr = frame(1, view(250, 120))
    (start,) = rotated_starts(prediction(0.3), prev, curr, CAMERA)
    np.testing.assert_array_equal(start[:3, 3], [0.0, 0.0, -1.0])
    assert start[0, 2] == pytest.approx(50.0 / CAMERA.fu_px, abs=0.01)


def test_no_more_starts_where_the_images_show_the_predicted_rotation() -> None:
    """Within 15 px: no second search, however uncertain the rotation was."""
    prev = frame(0, view(300, 120))
    near = frame(1, view(292, 120))
    far = frame(1, view(276, 120))
    assert rotated_starts(prediction(0.3), prev, near, CAMERA) == []
    assert len(rotated_starts(prediction(0.3), prev, far, CAMERA)) == 1


def test_no_more_starts_where_the_rotation_is_known_or_there_is_no_image() -> None:
    prev = frame(0, view(300, 120))
    curr = frame(1, view(250, 120))
    known = prediction(0.9 * REACH_PX / CAMERA.fu_px)
    assert rotated_starts(known, prev, curr, CAMERA) == []
    assert rotated_starts(prediction(0.3), frame(0, None), curr, CAMERA) == []


def test_the_prediction_of_a_gyro_is_a_start_if_it_is_far_enough() -> None:
    """Also if it turns about the optical axis; the last velocity is none beside a gyro."""
    prev = frame(0, view(300, 120))
    curr = frame(1, view(300, 120))
    likely = prediction(0.001)
    for yaw_rad, roll_rad, num_starts in ((0.01, 0.05, 0), (0.1, 0.0, 1), (0.0, 0.2, 1)):
        T = se3.from_parts(so3.exp(np.array([0.0, yaw_rad, roll_rad])), np.zeros(3))
        other = replace(likely, T_curr_prev=T)
        assert rotated_starts(replace(likely, alternative=other), prev, curr, CAMERA) == []
        either = replace(likely, alternative=replace(other, is_of_gyro=True))
        starts = rotated_starts(either, prev, curr, CAMERA)
        assert len(starts) == num_starts
        for start in starts:
            np.testing.assert_array_equal(start[:3, :3], T[:3, :3])
            np.testing.assert_array_equal(start[:3, 3], [0.0, 0.0, -1.0])


class Counting(ImageTracker):
    """Finds points at infinity, at rest, from one start; from others nothing."""

    def __init__(self, right: FloatArray, num_left: int = 0) -> None:
        super().__init__(CAMERA, pv.OdometryConfig().tracking)
        self.right = right
        self.rejected = {LEFT_THE_VIEW: num_left}
        self.starts = list[FloatArray]()
        self.completed = list[int]()
        """Which of the starts new features were added to."""

    def follow(self, state: TrackingState, frame: Frame, T_curr_prev: FloatArray) -> Followed:
        self.starts.append(T_curr_prev)
        count = 60 if np.array_equal(T_curr_prev, self.right) else 0
        px = np.random.default_rng(0).uniform(20.0, 220.0, (count, 4))[:, [0, 1, 0, 1]]
        age = np.full(count, 2)
        tracks = Tracks(px, px, np.arange(count), age=age, rejected=self.rejected)
        images = prepare_images(frame, self._config)
        alive = TrackingState.none(next_id=len(self.starts))
        patches = AnchorPatches.cut(images.left[0], np.zeros((0, 2)), self._config.window_px)
        return Followed(images, tracks, alive, patches, px[:, :2], np.zeros(count))

    def with_new_features(self, followed: Followed) -> Tracked:
        self.completed.append(followed.alive.next_id - 1)
        return Tracked(followed.tracks, followed.alive)


@pytest.mark.parametrize("best", [0, 1, 2])
def test_each_start_is_tracked_from_once_and_the_best_is_proposed(best: int) -> None:
    """Tracks and state come from one and the same search."""
    starts = [se3.exp(0.02 * np.eye(6)[k]) for k in range(3)]
    tracker = Counting(starts[best])
    tracked = track_from_best_start(
        tracker,
        TrackingState.none(),
        (frame(0, view(300, 120)), frame(1, view(300, 120))),
        starts=starts,
        camera=CAMERA,
        config=pv.OdometryConfig(),
    )
    assert len(tracked.tracks) == 60
    assert tracked.state.next_id == best + 1
    assert tracker.completed == [best]
    np.testing.assert_array_equal(tracker.starts, starts)


def test_a_single_start_is_tracked_once() -> None:
    starts = [se3.exp(0.02 * np.eye(6)[0])]
    tracker = Counting(starts[0])
    track_from_best_start(
        tracker,
        TrackingState.none(),
        (frame(0, view(300, 120)), frame(1, view(300, 120))),
        starts=starts,
        camera=CAMERA,
        config=pv.OdometryConfig(),
    )
    np.testing.assert_array_equal(tracker.starts, starts)
    assert tracker.completed == [0]


def test_given_features_are_matched_once(monkeypatch: pytest.MonkeyPatch) -> None:
    called = []
    matched = IdentityTracker.track

    def counted(
        matcher: IdentityTracker, state: TrackingState, frame: Frame, T: FloatArray
    ) -> Tracked:
        called.append(frame.index)
        return matched(matcher, state, frame, T)

    monkeypatch.setattr(IdentityTracker, "track", counted)
    given = StereoFeatures(np.arange(3), np.full((3, 4), 50.0))
    tracked = track_from_best_start(
        IdentityTracker(),
        TrackingState.none(),
        (Frame(0, 0, features=given), Frame(1, 1, features=given)),
        starts=[np.eye(4), se3.exp(0.02 * np.eye(6)[1])],
        camera=CAMERA,
        config=pv.OdometryConfig(),
    )
    assert called == [1]
    assert len(tracked.state) == 3


@pytest.mark.parametrize(
    ("num_alive", "num_left", "is_lost"),
    [(119, 0, False), (121, 0, True), (200, 81, False), (200, 79, True), (0, 0, False)],
)
def test_the_turn_that_images_show_is_a_start_once_most_features_in_view_are_lost(
    num_alive: int, num_left: int, is_lost: bool
) -> None:
    """Of so many features alive, so many leave the view, and 60 are found."""
    start = se3.from_parts(np.eye(3), np.array([0.0, 0.0, -1.0]))
    tracker = Counting(start, num_left)
    alive = replace(
        TrackingState.none(),
        ids=np.arange(num_alive),
        pixels=np.zeros((num_alive, 4)),
        age=np.ones(num_alive, np.int64),
    )
    tracked = track_from_best_start(
        tracker,
        alive,
        (frame(0, view(300, 120)), frame(1, view(250, 120))),
        starts=[start],
        camera=CAMERA,
        config=pv.OdometryConfig(),
    )
    assert len(tracker.starts) == 1 + is_lost
    assert len(tracked.tracks) == 60
    if is_lost:
        assert tracker.starts[1][0, 2] == pytest.approx(50.0 / CAMERA.fu_px, abs=0.01)


class BesideLorry(ImageTracker):
    """Of 200 features, finds those of a lorry from rest, and those of the street from its speed."""

    def __init__(
        self,
        starts: list[FloatArray],
        *,
        found: tuple[int, int],
        left_the_view: tuple[int, int],
        farthest_m: tuple[float, float],
    ) -> None:
        super().__init__(CAMERA, pv.OdometryConfig().tracking)
        self.starts = starts
        self.found = found
        self.left_the_view = left_the_view
        self.farthest_m = farthest_m

    def follow(self, state: TrackingState, frame: Frame, T_curr_prev: FloatArray) -> Followed:
        number = next(
            k for k, start in enumerate(self.starts) if np.array_equal(T_curr_prev, start)
        )
        count = self.found[number]
        rng = np.random.default_rng(0)
        depth_m = rng.uniform(8.0, self.farthest_m[number], count)
        points = rng.uniform(-0.2, 0.2, (count, 3)) * depth_m[:, None]
        points[:, 2] = depth_m
        tracks = Tracks(
            CAMERA.project(points),
            CAMERA.project(se3.transform(T_curr_prev, points)),
            np.arange(count),
            age=np.full(count, 2),
            rejected={LEFT_THE_VIEW: self.left_the_view[number]},
        )
        images = prepare_images(frame, self._config)
        patches = AnchorPatches.cut(images.left[0], np.zeros((0, 2)), self._config.window_px)
        alive = TrackingState.none(next_id=number)
        return Followed(images, tracks, alive, patches, tracks.curr_px[:, :2], np.zeros(count))

    def with_new_features(self, followed: Followed) -> Tracked:
        return Tracked(followed.tracks, followed.alive)


AT_REST = np.eye(4)
DRIVING = se3.from_parts(np.eye(3), np.array([0.0, 0.0, -4.0]))


def best_start(tracker: BesideLorry, *, speed_is_unknown: bool) -> int:
    """Which start 200 features are tracked from."""
    alive = replace(
        TrackingState.none(),
        ids=np.arange(200),
        pixels=np.zeros((200, 4)),
        age=np.ones(200, np.int64),
    )
    tracked = track_from_best_start(
        tracker,
        alive,
        (frame(0, view(300, 120)), frame(1, view(300, 120))),
        starts=tracker.starts,
        speed_is_unknown=speed_is_unknown,
        camera=CAMERA,
        config=pv.OdometryConfig(),
    )
    return tracked.state.next_id


def test_a_lorry_ahead_is_no_street_at_rest() -> None:
    """More features agree on rest, 60 of the 195 that would be in view, but more than half of the
    80 on the speed that takes the others out of the view."""
    tracker = BesideLorry(
        [AT_REST, DRIVING], found=(60, 45), left_the_view=(5, 120), farthest_m=(20.0, 20.0)
    )
    assert best_start(tracker, speed_is_unknown=False) == 1


@pytest.mark.parametrize(
    ("lorry_m", "street_m", "num_of_street", "speed_is_unknown", "best"),
    [
        pytest.param(12.0, 60.0, 40, True, 1, id="the street is longer"),
        pytest.param(12.0, 60.0, 40, False, 0, id="the speed is known"),
        pytest.param(60.0, 12.0, 40, True, 0, id="oncoming lorry seen from rest"),
        pytest.param(12.0, 60.0, 8, True, 0, id="few agree"),
    ],
)
def test_of_lorries_all_around_and_a_street_the_larger_stands_still(
    lorry_m: float, street_m: float, num_of_street: int, speed_is_unknown: bool, best: int
) -> None:
    """100 features agree on rest, and fewer on a speed that takes none out of the view."""
    tracker = BesideLorry(
        [AT_REST, DRIVING],
        found=(100, num_of_street),
        left_the_view=(0, 0),
        farthest_m=(lorry_m, street_m),
    )
    assert best_start(tracker, speed_is_unknown=speed_is_unknown) == best
