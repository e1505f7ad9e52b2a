"""The way back: nothing if the track is right, its error if it is wrong."""

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.predictors.forward_backward import FLOOR_PX, forward_backward

UV = np.array([[60.0, 40.0], [100.0, 80.0], [131.3, 61.7]])
SHIFT = np.array([3.0, -2.0])


def texture(seed: int) -> FloatArray:
    noise = np.random.default_rng(seed).normal(size=(120, 200))
    return np.clip(128.0 + 250.0 * cv2.GaussianBlur(noise, (0, 0), 2.5), 0.0, 255.0)


def shifted(seed: int) -> tuple[Image, Image]:
    """An image and the same moved by ``SHIFT``."""
    image = texture(seed)
    moved = np.roll(image, SHIFT.astype(int)[::-1], axis=(0, 1))
    return image.astype(np.uint8), moved.astype(np.uint8)


def test_a_right_track_comes_back() -> None:
    previous_left, left = shifted(0)
    values = forward_backward(previous_left, left, UV, uv=UV + SHIFT)
    np.testing.assert_allclose(np.exp(values) - FLOOR_PX, 0.0, atol=5e-3)


def test_a_wrong_track_comes_back_as_far_off_as_it_is() -> None:
    previous_left, left = shifted(1)
    error = np.array([[0.6, 0.0], [0.0, -0.8], [0.3, 0.4]])
    values = forward_backward(previous_left, left, UV, uv=UV + SHIFT + error)
    np.testing.assert_allclose(np.exp(values) - FLOOR_PX, np.linalg.norm(error, axis=1), atol=0.05)


def test_without_texture_or_outside_the_image_it_is_unknown() -> None:
    previous_left, left = shifted(2)
    previous_left[:, :50] = left[:, :50] = 90
    uv = np.array([[25.0, 40.0], [-60.0, 40.0], [100.0, 500.0], [100.0, 80.0]])
    values = forward_backward(previous_left, left, uv, uv=uv + SHIFT)
    np.testing.assert_array_equal(np.isnan(values), [True, True, True, False])


def test_no_features_no_values() -> None:
    previous_left, left = shifted(3)
    assert forward_backward(previous_left, left, np.zeros((0, 2)), uv=np.zeros((0, 2))).shape == (
        0,
    )
