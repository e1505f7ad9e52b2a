"""A step leaves the reprojection residual of each of its tracks, which is found by identity."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.tracking.last_residuals import LastResiduals
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, FORWARD, at_infinity, moved, seen_twice, tracks_of

COUNT = 50
NOISY = seen_twice(np.random.default_rng(0), COUNT, sigma_px=0.7)


def sizes(tracks: Tracks, T_curr_prev: FloatArray = FORWARD) -> FloatArray:
    return LastResiduals.after_step(tracks, T_curr_prev, CAMERA).size_px


@pytest.mark.parametrize(
    "T_curr_prev", [FORWARD, se3.inverse(FORWARD), np.eye(4)], ids=["forward", "back", "at rest"]
)
def test_sizes_by_the_definition(T_curr_prev: FloatArray) -> None:
    """Feature by feature, ‖y' − f(T g(y))‖, with rows that do not agree."""
    assert np.abs(NOISY.prev_px[:, 1] - NOISY.prev_px[:, 3]).max() > 1.0
    expected = []
    for prev, curr in zip(NOISY.prev_px, NOISY.curr_px, strict=True):
        point = T_curr_prev @ np.append(CAMERA.triangulate(prev), 1.0)
        expected.append(np.linalg.norm(curr - CAMERA.project(point[:3])))
    np.testing.assert_allclose(sizes(NOISY, T_curr_prev), expected, rtol=1e-9)


def test_without_noise_the_true_motion_leaves_nothing() -> None:
    for tracks in (
        seen_twice(np.random.default_rng(1), COUNT),
        at_infinity(np.random.default_rng(2), COUNT),
    ):
        np.testing.assert_allclose(sizes(tracks), 0.0, atol=1e-9)


def test_a_little_beyond_infinity_is_like_a_little_before() -> None:
    """A disparity of zero, or below it by noise, is as good as any."""
    tracks = at_infinity(np.random.default_rng(3), COUNT)
    change_px = 1e-6
    for sign in (-1.0, 1.0):
        prev_px = tracks.prev_px - [0.0, 0.0, sign * change_px, 0.0]
        np.testing.assert_allclose(
            sizes(replace(tracks, prev_px=prev_px)), 0.0, atol=10.0 * change_px
        )
        np.testing.assert_allclose(
            sizes(tracks_of(prev_px, moved(prev_px, FORWARD))), 0.0, atol=1e-6
        )


def test_behind_the_camera_there_is_none() -> None:
    """Ten metres ahead, after eleven metres and after nine."""
    prev_px = CAMERA.project(np.array([[1.0, 0.5, 10.0], [1.0, 0.5, 30.0]]))
    for length_m, is_nan in ((11.0, [True, False]), (10.0, [True, False]), (9.0, [False, False])):
        forward = se3.exp(np.array([0.0, 0.0, -length_m, 0.0, 0.0, 0.0]))
        np.testing.assert_array_equal(np.isnan(sizes(tracks_of(prev_px, prev_px), forward)), is_nan)


def test_features_are_found_by_identity() -> None:
    """In any order, however large the numbers; those that were not there have none."""
    rng = np.random.default_rng(4)
    ids = rng.permutation(10**12 + 3 * np.arange(COUNT))
    left = LastResiduals.after_step(replace(NOISY, ids=ids), FORWARD, CAMERA)
    by_id = dict(zip(ids.tolist(), sizes(NOISY).tolist(), strict=True))
    asked = rng.permutation(10**12 + np.arange(-100, 3 * COUNT + 100))
    np.testing.assert_array_equal(
        left.size_px_of(asked), [by_id.get(k, np.nan) for k in asked.tolist()]
    )
    np.testing.assert_array_equal(left.size_px_of(ids), sizes(NOISY))


def test_nothing_left_and_nothing_asked() -> None:
    for nothing in (LastResiduals.none(), LastResiduals.after_step(Tracks.none(), FORWARD, CAMERA)):
        np.testing.assert_array_equal(nothing.size_px_of(NOISY.ids), np.full(COUNT, np.nan))
        assert nothing.size_px_of(Tracks.none().ids).shape == (0,)
    assert LastResiduals.after_step(NOISY, FORWARD, CAMERA).size_px_of(Tracks.none().ids).shape == (
        0,
    )
