"""Where tracking starts while the turn is not known: about where the images say."""

import cv2
import numpy as np
import pytest

import probevo as pv
from probevo.arrays import FloatArray, Image, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.estimation.motion_model import ExpectedMotion
from probevo.estimation.search_starts import REACH_PX, seen_turn, track_from_best, turned_starts
from probevo.geometry import se3
from probevo.sequences.frame import Frame
from probevo.tracking.tracks import Tracks

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


def expected(sigma_rad: float) -> ExpectedMotion:
    T = se3.from_parts(np.eye(3), np.array([0.0, 0.0, -1.0]))
    sigma = np.diag([0.1, 0.1, 0.1, sigma_rad, sigma_rad, sigma_rad])
    return ExpectedMotion(T, sigma**2, sigma)


@pytest.mark.parametrize("moved", [(0, 0), (90, 0), (-60, 0), (0, 25), (40, -20)])
def test_the_turn_takes_the_middle_of_the_image_where_it_went(moved: tuple[int, int]) -> None:
    """To a fifth of what the tracker bridges; the content moves against the view."""
    du, dv = moved
    C = seen_turn(view(300, 120), view(300 - du, 120 - dv), CAMERA)
    ray = C @ [0.0, 0.0, 1.0]
    went = np.array([CAMERA.fu_px, CAMERA.fv_px]) * ray[:2] / ray[2]
    np.testing.assert_allclose(went, moved, atol=0.2 * REACH_PX)


def test_one_start_more_where_the_turn_is_unsure_with_the_translation_expected() -> None:
    before = frame(0, view(300, 120))
    now = frame(1, view(250, 120))
    (start,) = turned_starts(expected(0.3), before, now, camera=CAMERA)
    np.testing.assert_array_equal(start[:3, 3], [0.0, 0.0, -1.0])
    assert start[0, 2] == pytest.approx(50.0 / CAMERA.fu_px, abs=0.01)


def test_none_where_the_turn_that_is_seen_is_the_one_expected() -> None:
    """Within 15 px: no second search, however unsure the turn was."""
    before = frame(0, view(300, 120))
    near = frame(1, view(292, 120))
    far = frame(1, view(276, 120))
    assert turned_starts(expected(0.3), before, near, camera=CAMERA) == []
    assert len(turned_starts(expected(0.3), before, far, camera=CAMERA)) == 1


class Counting:
    """Finds points at infinity, at rest, from one start; from others nothing."""

    def __init__(self, right: FloatArray) -> None:
        self.right = right
        self.tracked = list[FloatArray]()

    def track(self, frame: Frame, expected: FloatArray) -> Tracks:
        self.tracked.append(expected)
        count = 60 if np.array_equal(expected, self.right) else 0
        px = np.random.default_rng(0).uniform(20.0, 220.0, (count, 4))[:, [0, 1, 0, 1]]
        return Tracks(px, px, np.arange(count), age=np.full(count, 2))

    def drop(self, ids: IntArray) -> None: ...


def test_the_start_that_is_expected_is_tracked_from_once_if_it_is_the_best() -> None:
    starts = [se3.exp(0.02 * np.eye(6)[k]) for k in range(3)]
    now = frame(1, view(300, 120))
    config = pv.OdometryConfig()
    for right, calls in ((starts[0], 3), (starts[2], 4)):
        tracker = Counting(right)
        assert len(track_from_best(tracker, now, starts, camera=CAMERA, config=config)) == 60
        assert len(tracker.tracked) == calls
        np.testing.assert_array_equal(tracker.tracked[-1], right)


def test_none_where_the_turn_is_known_or_there_is_no_image() -> None:
    before = frame(0, view(300, 120))
    now = frame(1, view(250, 120))
    assert turned_starts(expected(0.9 * REACH_PX / CAMERA.fu_px), before, now, camera=CAMERA) == []
    assert turned_starts(expected(0.3), frame(0, None), now, camera=CAMERA) == []
