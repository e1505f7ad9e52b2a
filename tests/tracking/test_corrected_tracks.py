"""Tracks are corrected by the rows that they show, and by a delay once the velocity is known."""

from dataclasses import replace

import numpy as np

from probevo.camera.exposure_delay import without_delay
from probevo.camera.rig_calibration import RigCalibration
from probevo.camera.rolling_shutter import Twists, without_readout
from probevo.geometry import se3
from probevo.tracking.corrected_tracks import CorrectedTracks
from worlds import CAMERA, FORWARD, misrectified, random_pixels, seen_twice

TWIST_S = 10.0 * se3.log(FORWARD)


def test_without_a_calibration_the_tracks_stay_as_they_are() -> None:
    tracks = seen_twice(np.random.default_rng(0), 50)
    found = CorrectedTracks.of(tracks, None, CAMERA, twists=Twists(TWIST_S, TWIST_S))
    assert found.tracks is tracks
    assert found.rig is None


def test_rows_are_those_of_this_frame_too() -> None:
    """Of 300 exact matches, one frame takes the median error of the rows below a tenth."""
    clean = seen_twice(np.random.default_rng(0), 300)
    seen = replace(clean, prev_px=misrectified(clean.prev_px), curr_px=misrectified(clean.curr_px))
    rig = RigCalibration.initial()
    found = CorrectedTracks.of(seen, rig, CAMERA, twists=None)
    before = np.abs(seen.curr_px[:, 3] - seen.curr_px[:, 1])
    after = np.abs(found.tracks.curr_px[:, 3] - found.tracks.curr_px[:, 1])
    assert np.median(after) < 0.1 * np.median(before)
    assert found.prior_rig is rig
    assert found.raw is seen


def test_a_delay_is_taken_off_at_each_frame_by_its_own_velocity() -> None:
    rng = np.random.default_rng(1)
    rig = RigCalibration.initial()
    for _ in range(5):
        pixels = random_pixels(rng, 300)
        rig = rig.with_delay(without_delay(pixels, -0.005, TWIST_S, CAMERA), TWIST_S, CAMERA)
    assert abs(rig.delay.delay_s - 0.005) < 3e-4
    tracks = seen_twice(rng, 50)
    unknown = CorrectedTracks.of(tracks, rig, CAMERA, twists=None)
    assert unknown.delay_s == 0.0
    assert unknown.simultaneous is tracks
    found = unknown.at_twists(Twists(0.5 * TWIST_S, TWIST_S), CAMERA)
    assert found.delay_s == rig.delay.delay_s
    expected = without_delay(tracks.prev_px, found.delay_s, 0.5 * TWIST_S, CAMERA)
    np.testing.assert_array_equal(found.simultaneous.prev_px, expected)
    expected = without_delay(tracks.curr_px, found.delay_s, TWIST_S, CAMERA)
    np.testing.assert_array_equal(found.simultaneous.curr_px, expected)
    # What the velocity changes in the step is what the correction may be wrong by.
    change_px = expected - without_delay(tracks.curr_px, found.delay_s, 0.5 * TWIST_S, CAMERA)
    np.testing.assert_array_equal(found.tracks.velocity_error_px, change_px)
    some = found.tracks.subset(np.array([3, 7]))
    np.testing.assert_array_equal(some.velocity_error_px, change_px[[3, 7]])
    steady = unknown.at_twists(Twists(TWIST_S, TWIST_S), CAMERA)
    np.testing.assert_array_equal(steady.tracks.velocity_error_px, np.zeros((50, 4)))


def test_the_rows_of_a_rolling_shutter_are_moved_to_the_times_of_their_frames() -> None:
    """Behind the delay of the right camera; each frame by its own velocity."""
    tracks = seen_twice(np.random.default_rng(2), 50)
    rig = RigCalibration.initial()
    rig = replace(rig, image=replace(rig.image, readout_s=0.02))
    unknown = CorrectedTracks.of(tracks, rig, CAMERA, twists=None)
    assert unknown.simultaneous is tracks
    assert not unknown.knows_velocity
    found = unknown.at_twists(Twists(0.5 * TWIST_S, TWIST_S), CAMERA)
    assert found.knows_velocity
    expected = without_readout(tracks.prev_px, 0.02, 0.5 * TWIST_S, CAMERA)
    np.testing.assert_array_equal(found.simultaneous.prev_px, expected)
    expected = without_readout(tracks.curr_px, 0.02, TWIST_S, CAMERA)
    np.testing.assert_array_equal(found.simultaneous.curr_px, expected)
    change_px = expected - without_readout(tracks.curr_px, 0.02, 0.5 * TWIST_S, CAMERA)
    np.testing.assert_array_equal(found.tracks.velocity_error_px, change_px)
