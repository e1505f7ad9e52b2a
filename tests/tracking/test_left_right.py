"""Swapped left and right images are recognized by their negative disparities."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from probevo import StereoOdometry, estimate_motion
from probevo.sequences.frame import Frame
from probevo.tracking.left_right import (
    MIN_MATCHES,
    IdenticalImagesError,
    LeftRightCheck,
    SwappedImagesError,
    check_left_right,
    count_matches,
    looks_swapped,
)
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, drive, seen_twice


def test_matches_are_counted_with_those_that_the_tracker_rejected() -> None:
    curr_px = np.array([[9.0, 0.0, 5.0, 0.0], [9.0, 0.0, 9.0, 0.0], [9.0, 0.0, 12.0, 0.0]])
    rejected = {"negative disparity": 4, "rows differ": 7}
    tracks = Tracks(
        prev_px=curr_px,
        curr_px=curr_px,
        ids=np.arange(3),
        age=np.full(3, 2),
        rejected=rejected,
    )
    assert count_matches(tracks) == (2, 5)


@pytest.mark.parametrize(
    ("num_positive", "num_negative", "swapped"),
    [
        (0, MIN_MATCHES, True),
        (0, MIN_MATCHES - 1, False),
        (19, 81, True),
        (20, 80, False),
        (100, 3, False),
    ],
)
def test_images_are_swapped_where_nearly_all_disparities_are_negative(
    num_positive: int, num_negative: int, swapped: bool
) -> None:
    assert looks_swapped(num_positive, num_negative) == swapped


def test_a_swapped_recording_is_refused_with_the_cure(tmp_path: Path) -> None:
    """Which differs between images, features, videos and bags."""
    check_left_right(100, 1, tmp_path)
    with pytest.raises(SwappedImagesError) as caught:
        check_left_right(3, 97, tmp_path)
    assert caught.value.what == "97 of the first 100 stereo matches have negative disparity."
    assert caught.value.cure.endswith("Exchange the two image folders, or the two videos.")
    for name, cure in (
        ("tracks.npz", "Exchange columns 0 and 2"),
        ("drive.BAG", "Exchange --topics"),
        ("drive.mcap", "Exchange --topics"),
        ("drive.mp4", "Exchange the two halves"),
    ):
        file = tmp_path / name
        file.touch()
        with pytest.raises(SwappedImagesError, match=cure):
            check_left_right(3, 97, file)
    (tmp_path / "metadata.yaml").touch()  # a folder of ROS 2
    with pytest.raises(SwappedImagesError, match="Exchange --topics"):
        check_left_right(3, 97, tmp_path)


def matches(num_positive: int, num_negative: int) -> Tracks:
    """Return the matches of a step, of those disparities."""
    disparity_px = np.repeat([2.0, -2.0], [num_positive, num_negative])
    count = len(disparity_px)
    pixels = np.column_stack([disparity_px, np.zeros((count, 3))])
    return Tracks(prev_px=pixels, curr_px=pixels, ids=np.arange(count), age=np.full(count, 2))


def see(left_right: LeftRightCheck, tracks: Tracks, *, num_differing: int) -> None:
    """See four frames, of which the last ones have a right image of their own."""
    image = np.random.default_rng(0).integers(0, 256, (30, 40), np.uint8)
    for k in range(4):
        right = 255 - image if k >= 4 - num_differing else image.copy()
        left_right.see(Frame(k, k, image, right), tracks)


@pytest.mark.parametrize("num_negative", [5, 40])
def test_images_that_are_the_same_are_not_called_swapped(num_negative: int) -> None:
    """Whatever the signs of their disparities, which are noise: to exchange them cures nothing."""
    tracks = matches(5, num_negative)
    with pytest.raises(IdenticalImagesError, match=r"^wall: left and .* first 4 frames\.\n.*twice"):
        see(LeftRightCheck("wall", 9), tracks, num_differing=0)


def test_images_that_come_to_differ_are_not_the_same() -> None:
    see(LeftRightCheck("wall", 9), matches(40, 5), num_differing=1)
    with pytest.raises(SwappedImagesError):
        see(LeftRightCheck("wall", 9), matches(5, 40), num_differing=1)


def test_of_images_without_matches_nothing_is_said() -> None:
    """As of two covered lenses, at the start."""
    see(LeftRightCheck("wall", 9), matches(0, 0), num_differing=0)


SWAPPED = [2, 3, 0, 1]
"""Columns of (u_l, v_l, u_r, v_r) with left and right exchanged."""


def test_matches_from_python_whose_sides_are_swapped_are_refused() -> None:
    """Their points would lie behind the camera, and agree on a motion backwards."""
    tracks = seen_twice(np.random.default_rng(0), 80, sigma_px=0.2)
    noise = 0.2**2 * np.eye(4)
    assert estimate_motion(tracks.prev_px, tracks.curr_px, noise, CAMERA).num_inliers > 60
    with pytest.raises(SwappedImagesError, match="Exchange columns"):
        estimate_motion(tracks.prev_px[:, SWAPPED], tracks.curr_px[:, SWAPPED], noise, CAMERA)


@pytest.mark.parametrize("every", [1, 5])
def test_features_from_python_whose_sides_are_swapped_are_refused(every: int) -> None:
    """However frames are numbered, as where only each fifth image is used."""

    def swapped(frame: Frame) -> Frame:
        assert frame.features is not None
        pixels = frame.features.pixels[:, SWAPPED]
        features = replace(frame.features, pixels=pixels)
        return replace(frame, index=every * frame.index, features=features)

    odometry = StereoOdometry(CAMERA)
    *first, last = [swapped(frame) for frame in drive(np.random.default_rng(0), 5)]
    for frame in first:
        odometry.step(frame)
    with pytest.raises(SwappedImagesError, match=f"features of frame {4 * every}"):
        odometry.step(last)
