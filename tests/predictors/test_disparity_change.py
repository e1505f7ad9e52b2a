"""The change of disparity against the triangulated point."""

import numpy as np

from probevo.geometry import se3
from probevo.predictors.disparity_change import disparity_change
from worlds import CAMERA, FORWARD, seen_twice


def test_it_is_how_far_the_disparity_is_off() -> None:
    tracks = seen_twice(np.random.default_rng(0), 100, sigma_px=0.5)
    predicted = CAMERA.project(se3.transform(FORWARD, CAMERA.triangulate(tracks.prev_px)))
    prev_px = tracks.prev_px.copy()
    # The triangulated point lies between its two rows; the predictor looks along the left one.
    prev_px[:, 1] = prev_px[:, 3] = 0.5 * (prev_px[:, 1] + prev_px[:, 3])
    off_px = (tracks.curr_px - predicted) @ [1.0, 0.0, -1.0, 0.0]
    values = disparity_change(prev_px, tracks.curr_px, FORWARD, camera=CAMERA)
    np.testing.assert_allclose(values, np.log1p(np.abs(off_px)), rtol=1e-9)


def test_the_true_motion_leaves_nothing() -> None:
    tracks = seen_twice(np.random.default_rng(1), 100)
    np.testing.assert_allclose(
        disparity_change(tracks.prev_px, tracks.curr_px, FORWARD, camera=CAMERA), 0.0, atol=1e-9
    )


def test_turning_about_the_optical_axis_changes_nothing() -> None:
    tracks = seen_twice(np.random.default_rng(2), 100)
    rolled = se3.exp(np.array([0.1, 0.2, 0.0, 0.0, 0.0, 0.3])) @ FORWARD
    np.testing.assert_allclose(
        disparity_change(tracks.prev_px, tracks.curr_px, rolled, camera=CAMERA), 0.0, atol=1e-9
    )


def test_points_behind_the_camera_or_at_infinity_are_defined() -> None:
    prev_px = np.array([[900.0, 100.0, -50.0, 100.0], [600.0, 100.0, 601.0, 100.0]])
    curr_px = np.array([[900.0, 100.0, -50.0, 100.0], [600.0, 100.0, 598.0, 100.0]])
    values = disparity_change(prev_px, curr_px, FORWARD, camera=CAMERA)
    assert values[0] > np.log(300.0)
    np.testing.assert_allclose(values[1], np.log(3.0))


def test_no_features_no_values() -> None:
    assert disparity_change(np.zeros((0, 4)), np.zeros((0, 4)), FORWARD, camera=CAMERA).shape == (
        0,
    )
