"""Residual flow: none in a static world, whatever was predicted; all of it on moving objects."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.predictors.residual_flow import MIN_FEATURES, residual_flow
from worlds import CAMERA, FORWARD, random_pixels, seen_twice

# Errors of the predicted motion: a tenth of the speed; the rotation, without a gyro; all of it,
# where no speed is known.
BRAKING = np.array([0.02, -0.01, 0.1, 0.0, 0.0, 0.0])
TURNING = np.array([0.0, 0.0, 0.0, 0.005, -0.02, 0.01])
STANDING = -se3.log(FORWARD)


def test_the_true_motion_leaves_nothing() -> None:
    tracks = seen_twice(np.random.default_rng(0), 300)
    np.testing.assert_allclose(
        residual_flow(tracks.prev_px, tracks.curr_px, FORWARD, camera=CAMERA), 0.0, atol=1e-9
    )


@pytest.mark.parametrize("error", [BRAKING, TURNING, BRAKING + TURNING, STANDING])
def test_the_error_of_the_predicted_motion_drops_out(error: FloatArray) -> None:
    tracks = seen_twice(np.random.default_rng(1), 300)
    predicted = se3.exp(error) @ FORWARD
    values = residual_flow(tracks.prev_px, tracks.curr_px, predicted, camera=CAMERA)
    assert np.expm1(values).max() < 0.02


@pytest.mark.parametrize("error", [np.zeros(6), BRAKING + TURNING])
@pytest.mark.parametrize("width_px", [100.0, 400.0])
def test_what_moves_keeps_its_motion(width_px: float, error: FloatArray) -> None:
    """Up to a third of the image is a block that moves by (6, 2) px; the noise is 0.2 px."""
    tracks = seen_twice(np.random.default_rng(2), 400, sigma_px=0.2)
    moving = np.abs(tracks.prev_px[:, 0] - 500.0) < 0.5 * width_px
    curr_px = tracks.curr_px + np.where(moving[:, None], [6.0, 2.0, 6.0, 2.0], 0.0)
    values_px = np.expm1(
        residual_flow(tracks.prev_px, curr_px, se3.exp(error) @ FORWARD, camera=CAMERA)
    )
    assert abs(np.median(values_px[moving]) - np.hypot(6.0, 2.0)) < 1.0
    assert np.median(values_px[~moving]) < 0.8
    assert np.quantile(values_px[moving], 0.05) > np.quantile(values_px[~moving], 0.95)


def test_a_few_features_correct_nothing() -> None:
    """Their deviation is that from the predicted motion."""
    tracks = seen_twice(np.random.default_rng(3), MIN_FEATURES - 1)
    predicted = se3.exp(TURNING) @ FORWARD
    predicted_px = CAMERA.project(se3.transform(predicted, CAMERA.triangulate(tracks.prev_px)))
    length_px = np.linalg.norm((tracks.curr_px - predicted_px)[:, :2], axis=1)
    values = residual_flow(tracks.prev_px, tracks.curr_px, predicted, camera=CAMERA)
    np.testing.assert_allclose(values, np.log1p(length_px), rtol=1e-9)


def test_features_without_disparity_do_not_change_the_translation() -> None:
    """Far features do not observe it; the rotation is corrected all the same."""
    prev_px = random_pixels(np.random.default_rng(4), 100)
    prev_px[:, 2] = prev_px[:, 0]
    rays = np.column_stack(
        [(prev_px[:, 0] - 601.0) / 707.0, (prev_px[:, 1] - 183.0) / 709.0, np.ones(100)]
    )
    curr_px = CAMERA.project(1e9 * rays @ FORWARD[:3, :3].T)
    values = residual_flow(prev_px, curr_px, se3.exp(TURNING) @ FORWARD, camera=CAMERA)
    np.testing.assert_allclose(values, 0.0, atol=1e-3)


def test_what_would_come_behind_the_camera_is_far_off() -> None:
    """One feature with a wild disparity, 0.4 m ahead of a camera that drives on by 1.2 m."""
    tracks = seen_twice(np.random.default_rng(5), 100)
    prev_px = tracks.prev_px.copy()
    curr_px = tracks.curr_px.copy()
    prev_px[0] = [900.0, 100.0, -50.0, 100.0]
    curr_px[0] = [905.0, 99.0, -45.0, 99.0]
    values = residual_flow(prev_px, curr_px, FORWARD, camera=CAMERA)
    assert np.isfinite(values).all()
    assert values[0] > np.log(300.0)
    np.testing.assert_allclose(values[1:], 0.0, atol=1e-2)


def test_no_features_no_values() -> None:
    assert residual_flow(np.zeros((0, 4)), np.zeros((0, 4)), FORWARD, camera=CAMERA).shape == (0,)
