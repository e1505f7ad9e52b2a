"""Rows at times of their own: moved to that of the frame exactly, where the camera moves evenly."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.camera.rolling_shutter import (
    MIN_RATIO,
    NOTICEABLE_S,
    ReadoutTime,
    without_readout,
)
from probevo.geometry import se3
from worlds import CAMERA, random_pixels

TWIST_S = np.array([0.5, -0.3, -12.0, 0.4, -0.8, 0.6])
"""12 m/s ahead, and turns of 20 to 50 degrees a second."""
ACCELERATION = np.array([2.0, 1.0, -3.0, 8.0, -20.0, 5.0])
"""Of a rig in a hand, that changes its rates by up to 20 rad/s in a second."""


def rolling(
    points: FloatArray, readout_s: float, acceleration: FloatArray | None = None
) -> FloatArray:
    """Return what a rolling shutter shows of points at rest, given at the time of the frame,
    [N, 3], m: each where it is when its row is exposed, which is found by iteration."""
    rate = np.zeros(6) if acceleration is None else acceleration
    pixels = CAMERA.project(points)
    for _ in range(50):
        row_time_s = readout_s * (pixels[:, 1] / (CAMERA.extent_px[1] - 1.0) - 0.5)
        moved = [
            se3.transform(se3.exp(time_s * TWIST_S + 0.5 * time_s**2 * rate), point[None])[0]
            for time_s, point in zip(row_time_s, points, strict=True)
        ]
        pixels = CAMERA.project(np.array(moved))
    return pixels


@pytest.mark.parametrize("readout_s", [0.03, -0.03])
def test_points_seen_by_rows_are_moved_to_where_they_are_at_the_time_of_the_frame(
    readout_s: float,
) -> None:
    expected = random_pixels(np.random.default_rng(0), 200)
    seen = rolling(CAMERA.triangulate(expected), readout_s)
    assert np.abs(seen - expected).max() > 5.0
    found = without_readout(seen, readout_s, TWIST_S, CAMERA)
    np.testing.assert_allclose(found, expected, atol=1e-8)


def test_so_they_are_where_the_velocity_changes_meanwhile() -> None:
    expected = random_pixels(np.random.default_rng(3), 200)
    seen = rolling(CAMERA.triangulate(expected), 0.03, ACCELERATION)
    found = without_readout(seen, 0.03, TWIST_S, CAMERA, acceleration=ACCELERATION)
    np.testing.assert_allclose(found, expected, atol=1e-8)
    assert np.abs(without_readout(seen, 0.03, TWIST_S, CAMERA) - expected).max() > 0.5


def test_the_offset_between_the_rows_of_both_images_is_left() -> None:
    pixels = random_pixels(np.random.default_rng(1), 50)
    offset_px = np.array([0.0, 0.0, 0.0, 1.5])
    found = without_readout(pixels + offset_px, 0.02, TWIST_S, CAMERA)
    expected = without_readout(pixels, 0.02, TWIST_S, CAMERA) + offset_px
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_global_shutter_and_a_camera_at_rest_leave_everything_as_it_is() -> None:
    pixels = random_pixels(np.random.default_rng(2), 50)
    np.testing.assert_array_equal(without_readout(pixels, 0.0, TWIST_S, CAMERA), pixels)
    at_rest = without_readout(pixels, 0.02, np.zeros(6), CAMERA)
    np.testing.assert_allclose(at_rest, pixels, atol=1e-9)


def test_a_point_that_would_be_behind_the_camera_stays() -> None:
    """5 cm in front of the camera, in the last row, exposed 15 ms late: 18 cm driven."""
    near = CAMERA.project(np.array([[0.0, 0.0, 0.05]]))
    near[:, [1, 3]] = CAMERA.extent_px[1] - 1.0
    backwards = -TWIST_S
    found = without_readout(near, 0.03, backwards, CAMERA)
    np.testing.assert_array_equal(found, near)


def test_without_a_size_the_principal_point_is_in_the_middle() -> None:
    assert replace(CAMERA, size_px=None).extent_px[1] == 2.0 * CAMERA.cv_px + 1.0
    sized = replace(CAMERA, size_px=(640, 480))
    assert sized.extent_px[1] == 480.0
    from_principal_point = replace(CAMERA, size_px=None, cu_px=0.0, cv_px=0.0)
    assert from_principal_point.extent_px == (2.0, 2.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_readout_counts_where_it_exceeds_noise_and_other_errors(sign: float) -> None:
    sure_s = 0.1 * NOTICEABLE_S
    assert (
        ReadoutTime(sign * 1.01 * NOTICEABLE_S, sure_s).noticeable_s == sign * 1.01 * NOTICEABLE_S
    )
    assert ReadoutTime(sign * 0.99 * NOTICEABLE_S, sure_s).noticeable_s == 0.0
    unsure_s = NOTICEABLE_S
    assert ReadoutTime(sign * 1.01 * MIN_RATIO * unsure_s, unsure_s).noticeable_s != 0.0
    assert ReadoutTime(sign * 0.99 * MIN_RATIO * unsure_s, unsure_s).noticeable_s == 0.0
