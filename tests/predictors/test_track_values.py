"""The predictors that are one formula on the tracks: place, disparity, flow, age, row offset,
window difference, alignment."""

import math
from dataclasses import replace

import numpy as np

from probevo.camera.stereo import StereoCamera
from probevo.predictors.age import age
from probevo.predictors.alignment import FLOOR_PX as ALIGNMENT_FLOOR_PX
from probevo.predictors.alignment import MAX_PX, alignment
from probevo.predictors.disparity import FLOOR_PX, disparity
from probevo.predictors.flow import flow
from probevo.predictors.place import place
from probevo.predictors.row_offset import row_offset
from probevo.predictors.window_difference import window_difference
from probevo.tracking.tracks import Tracks
from worlds import CAMERA, seen_twice

TRACKS = seen_twice(np.random.default_rng(0), 50, sigma_px=0.5)


def test_place_is_the_same_for_a_camera_of_twice_the_resolution() -> None:
    twice = StereoCamera(
        fu_px=2 * CAMERA.fu_px,
        fv_px=2 * CAMERA.fv_px,
        cu_px=2 * CAMERA.cu_px,
        cv_px=2 * CAMERA.cv_px,
        baseline_m=CAMERA.baseline_m,
    )
    uv = TRACKS.curr_px[:, :2]
    np.testing.assert_allclose(place(2 * uv, twice), place(uv, CAMERA), rtol=1e-12, atol=1e-12)
    points = CAMERA.triangulate(CAMERA.project(np.array([[1.0, -2.0, 10.0]])))
    np.testing.assert_allclose(
        place(CAMERA.project(points)[:, :2], CAMERA), [[0.1, -0.2]], atol=1e-12
    )


def test_disparity_is_the_logarithm_down_to_its_floor() -> None:
    expected = [math.log(u_l - u_r) for u_l, _, u_r, _ in TRACKS.curr_px.tolist()]
    np.testing.assert_allclose(disparity(TRACKS.curr_px), expected, rtol=1e-12)
    far = np.array([[10.0, 0.0, 10.0, 0.0], [10.0, 0.0, 12.0, 0.0], [10.0, 0.0, 9.9, 0.0]])
    np.testing.assert_array_equal(disparity(far), math.log(FLOOR_PX))


def test_flow_is_that_of_the_left_image() -> None:
    before = TRACKS.prev_px.tolist()
    after = TRACKS.curr_px.tolist()
    expected = [math.log(1.0 + math.dist(a[:2], b[:2])) for a, b in zip(before, after, strict=True)]
    np.testing.assert_allclose(flow(TRACKS.prev_px, TRACKS.curr_px), expected, rtol=1e-12)
    np.testing.assert_array_equal(flow(TRACKS.prev_px, TRACKS.prev_px), 0.0)


def test_age_is_a_logarithm() -> None:
    np.testing.assert_allclose(
        age(np.array([1, 2, 40])), [0.0, math.log(2), math.log(40)], rtol=1e-12
    )


def test_row_offset_has_no_sign() -> None:
    px = np.array([[10.0, 5.0, 8.0, 5.0], [10.0, 5.0, 8.0, 5.5], [10.0, 5.0, 8.0, 4.5]])
    np.testing.assert_allclose(row_offset(px), [0.0, 0.5, 0.5])


def test_window_difference_is_unknown_if_others_have_tracked() -> None:
    difference = np.array([[0.0, 3.0], [1.0, 7.0]])
    known = replace(TRACKS.subset(np.arange(50) < 2), difference=difference)
    np.testing.assert_allclose(window_difference(known), np.log(1.0 + difference), rtol=1e-12)
    values = window_difference(TRACKS)
    assert values.shape == (50, 2)
    assert np.isnan(values).all()


def test_alignment_is_sigma_and_correlation_of_the_place() -> None:
    left = np.array([[4.0, 1.2], [1.2, 1.0]])
    right = np.diag([0.25, 100.0])
    known = replace(TRACKS.subset(np.arange(50) < 1), alignment_cov_px2=np.array([[left, right]]))
    expected = [
        math.log(ALIGNMENT_FLOOR_PX + 2.0),
        math.log(ALIGNMENT_FLOOR_PX + 1.0),
        0.6,
        math.log(ALIGNMENT_FLOOR_PX + 0.5),
    ]
    np.testing.assert_allclose(alignment(known), [expected], rtol=1e-12)


def test_alignment_is_finite_for_perfect_matches_and_for_none() -> None:
    cov_px2 = np.zeros((2, 2, 2, 2))
    cov_px2[1] = np.inf
    known = replace(TRACKS.subset(np.arange(50) < 2), alignment_cov_px2=cov_px2)
    least = math.log(ALIGNMENT_FLOOR_PX)
    most = math.log(ALIGNMENT_FLOOR_PX + MAX_PX)
    np.testing.assert_allclose(
        alignment(known), [[least, least, 0.0, least], [most, most, 0.0, most]], rtol=1e-12
    )


def test_alignment_is_unknown_if_others_have_tracked() -> None:
    values = alignment(TRACKS)
    assert values.shape == (50, 4)
    assert np.isnan(values).all()


def test_no_features_no_values() -> None:
    none = Tracks.none()
    for values in (
        disparity(none.curr_px),
        flow(none.prev_px, none.curr_px),
        age(none.age),
        row_offset(none.curr_px),
    ):
        assert values.shape == (0,)
    assert place(none.curr_px[:, :2], CAMERA).shape == (0, 2)
    assert window_difference(none).shape == (0, 2)
    assert alignment(none).shape == (0, 4)
