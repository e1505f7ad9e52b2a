"""Features that come with identities are joined by them, and age while they are seen in a row."""

import numpy as np
import pytest

from probevo.config import TrackingConfig
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking import IdentityTracker, TrackingState, Tracks, tracker_for
from worlds import CAMERA


def frame(index: int, *ids: int) -> Frame:
    """Return a frame in which each feature's first coordinate is its identity, its second the
    frame."""
    rows = np.full(len(ids), index)
    pixels = np.column_stack([ids, rows, ids, rows]).astype(float)
    features = StereoFeatures(np.array(ids, np.int64), pixels.reshape(-1, 4))
    return Frame(index, index, features=features)


def follow(*frames: Frame) -> Tracks:
    """Return the tracks of the last frame."""
    matcher = IdentityTracker()
    state = TrackingState.none()
    tracks = Tracks.none()
    for each in frames:
        tracked = matcher.track(state, each, np.eye(4))
        state = tracked.state
        tracks = tracked.tracks
    return tracks


def test_the_first_frame_has_no_tracks() -> None:
    assert len(follow(frame(0, 1, 2, 3))) == 0


def test_points_are_joined_by_identity_whatever_their_order() -> None:
    tracks = follow(frame(0, 7, 3, 9, 5), frame(1, 5, 8, 7, 3))
    assert set(tracks.ids) == {3, 5, 7}
    np.testing.assert_array_equal(tracks.prev_px[:, :2], np.column_stack([tracks.ids, np.zeros(3)]))
    np.testing.assert_array_equal(tracks.curr_px[:, :2], np.column_stack([tracks.ids, np.ones(3)]))


def test_age_counts_the_frames_in_a_row() -> None:
    tracks = follow(frame(0, 1), frame(1, 2, 1), frame(2, 1, 2, 3), frame(3, 3, 2, 1))
    assert dict(zip(tracks.ids, tracks.age, strict=True)) == {1: 4, 2: 3, 3: 2}


def test_a_point_that_comes_back_starts_anew() -> None:
    """It is not joined across the frame that missed it."""
    assert len(follow(frame(0, 1), frame(1, 2), frame(2, 1))) == 0
    again = follow(frame(0, 1), frame(1, 1), frame(2, 2), frame(3, 1), frame(4, 1))
    assert again.age.tolist() == [2]


@pytest.mark.parametrize("ids", [((), (1, 2)), ((1, 2), ()), ((), ())])
def test_empty_frames_give_no_tracks(ids: tuple[tuple[int, ...], tuple[int, ...]]) -> None:
    tracks = follow(frame(0, *ids[0]), frame(1, *ids[1]))
    assert tracks.prev_px.shape == tracks.curr_px.shape == (0, 4)
    assert tracks.ids.shape == tracks.age.shape == (0,)


def test_one_feature_is_one_track() -> None:
    tracks = follow(frame(0, 4), frame(1, 4))
    assert (tracks.ids.tolist(), tracks.age.tolist()) == ([4], [2])
    assert tracks.prev_px.shape == tracks.curr_px.shape == (1, 4)


def test_dropping_leaves_the_file_in_charge() -> None:
    matcher = IdentityTracker()
    first = matcher.track(TrackingState.none(), frame(0, 1, 2), np.eye(4))
    remaining = first.state.without(np.array([1]))
    assert matcher.track(remaining, frame(1, 1, 2), np.eye(4)).tracks.ids.tolist() == [1, 2]


def test_a_frame_of_images_is_refused() -> None:
    with pytest.raises(ValueError, match="frame 3 has no features"):
        IdentityTracker().track(TrackingState.none(), Frame(3, 0), np.eye(4))


def test_frames_with_features_get_this_tracker() -> None:
    assert isinstance(tracker_for(frame(0, 1), CAMERA, TrackingConfig()), IdentityTracker)
