"""Lucas–Kanade level by level ends where OpenCV's pyramidal one does."""

import cv2
import numpy as np
import pytest

from probevo.arrays import Image
from probevo.config import TrackingConfig
from probevo.tracking.lucas_kanade import (
    MAX_ITERATIONS,
    MAX_STEP_PX,
    MIN_EIGENVALUE,
    build_pyramid,
    track_points,
)


def pair(height: int, width: int) -> tuple[Image, Image]:
    """A blurred noise, and the same 3.4 px to the right and 1.7 px down with noise of its own."""
    rng = np.random.default_rng(0)
    noise = cv2.GaussianBlur(rng.integers(0, 256, (height, width)).astype(np.float32), (0, 0), 2.0)
    one = cv2.normalize(noise, None, 0, 255, cv2.NORM_MINMAX)
    other = cv2.warpAffine(one, np.array([[1.0, 0.0, 3.4], [0.0, 1.0, 1.7]]), (width, height))
    return one.astype(np.uint8), np.clip(other + rng.normal(0, 2, one.shape), 0, 255).astype(
        np.uint8
    )


@pytest.mark.parametrize(
    ("height", "width", "levels"), [(240, 320, 4), (61, 90, 3), (23, 25, 2), (22, 40, 1)]
)
def test_every_point_ends_at_the_same_bits(height: int, width: int, levels: int) -> None:
    """Also beyond the border and from far starts; small images have fewer levels, as in OpenCV."""
    one, other = pair(height, width)
    config = TrackingConfig()
    rng = np.random.default_rng(1)
    points = rng.uniform(-5.0, np.array([width, height]) + 5.0, (500, 2))
    starts = points + rng.normal(0.0, 5.0, points.shape)
    template = build_pyramid(one, config)
    image = build_pyramid(other, config)
    assert len(template) == levels
    found, difference = track_points(template, image, points, start_px=starts, config=config)
    expected, status, expected_difference = cv2.calcOpticalFlowPyrLK(
        one,
        other,
        points.astype(np.float32),
        starts.astype(np.float32),
        winSize=(config.window_px, config.window_px),
        maxLevel=config.pyramid_levels,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, MAX_ITERATIONS, MAX_STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=MIN_EIGENVALUE,
    )
    alive = status[:, 0] > 0
    assert alive.sum() > 100
    np.testing.assert_array_equal(np.isfinite(difference), alive)
    np.testing.assert_array_equal(found[alive], expected[alive])
    np.testing.assert_array_equal(difference[alive], expected_difference[alive, 0])


def test_without_points_there_is_nothing_to_find() -> None:
    pyramid = build_pyramid(pair(61, 90)[0], TrackingConfig())
    found, difference = track_points(
        pyramid, pyramid, np.zeros((0, 2)), start_px=np.zeros((0, 2)), config=TrackingConfig()
    )
    assert found.shape == (0, 2)
    assert difference.shape == (0,)
