"""Stereo matches that repeat along their row are recognised."""

import numpy as np
import pytest

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.tracking.uniqueness_numba import REACH_PX, find_along_row, find_unique

WINDOW_PX = 11
DISPARITY_PX = 20.0


def texture(rng: np.random.Generator, *, period_px: int = 0) -> Image:
    """White noise, repeated along the rows with a period if there is one, [100, 300]."""
    image = rng.integers(40, 216, size=(100, 300))
    if period_px:
        image = np.tile(image[:, :period_px], 300 // period_px + 1)[:, :300]
    return image.astype(np.uint8)


def unique(left: Image, places: FloatArray, *, sigma: float = 4.0) -> BoolArray:
    """Which places are unique in a right image that is shifted, and noisy by some grey levels."""
    rng = np.random.default_rng(1)
    right = np.roll(left, -int(DISPARITY_PX), axis=1) + sigma * rng.normal(size=left.shape)
    right_px = places - [DISPARITY_PX, 0.0]
    return compared(left, np.clip(right, 0, 255).astype(np.uint8), places, right_px)


def compared(
    left: Image,
    right: Image,
    left_px: FloatArray,
    right_px: FloatArray,
    *,
    outside: bool = True,
) -> BoolArray:
    return find_unique(left, right, left_px, right_px, window_px=WINDOW_PX, outside=outside)


def places_inside(rng: np.random.Generator) -> FloatArray:
    return np.column_stack([rng.uniform(80.0, 220.0, 50), rng.uniform(20.0, 80.0, 50)])


def test_a_texture_that_does_not_repeat_is_unique() -> None:
    rng = np.random.default_rng(0)
    assert unique(texture(rng), places_inside(rng)).all()


@pytest.mark.parametrize("period_px", [8, 15, REACH_PX - 1])
def test_a_texture_that_repeats_within_reach_is_not(period_px: int) -> None:
    """But for the few where noise makes the second place look different."""
    rng = np.random.default_rng(0)
    assert unique(texture(rng, period_px=period_px), places_inside(rng)).mean() < 0.1


def test_a_texture_that_repeats_exactly_is_not() -> None:
    """Without noise, both places differ by nothing."""
    rng = np.random.default_rng(0)
    assert not unique(texture(rng, period_px=16), places_inside(rng), sigma=0.0).any()


def test_an_exact_match_without_a_second_place_is_unique() -> None:
    """As in an image that is hardly wider than its window."""
    left = texture(np.random.default_rng(0))[:, : WINDOW_PX + 4]
    places = np.array([[7.0, 50.0]])
    assert compared(left, left, places, places).all()


def test_a_period_beyond_reach_does_not_matter() -> None:
    """Lucas–Kanade does not get there."""
    rng = np.random.default_rng(0)
    assert unique(texture(rng, period_px=REACH_PX + 10), places_inside(rng)).all()


def test_a_wrong_match_is_not_unique() -> None:
    """The true place is in the same row, and fits better."""
    rng = np.random.default_rng(0)
    left = texture(rng)
    places = places_inside(rng)
    assert not compared(left, left, places, places - [7.0, 0.0]).any()


@pytest.mark.parametrize("outside", [True, False])
def test_windows_across_the_border_are_what_is_asked_for(outside: bool) -> None:
    left = texture(np.random.default_rng(0), period_px=8)
    places = np.array([[2.0, 50.0], [150.0, 1.0], [298.0, 50.0], [150.0, 98.0]])
    assert (compared(left, left, places, places, outside=outside) == outside).all()
    assert compared(left, left, places[:0], places[:0]).shape == (0,)


@pytest.mark.parametrize("disparity_px", [-45, 0, 7, 58])
def test_the_place_in_the_row_is_found_in_both_directions(disparity_px: int) -> None:
    rng = np.random.default_rng(0)
    left = texture(rng)
    right = np.roll(left, -disparity_px, axis=1)
    found_px = find_along_row(left, right, places_inside(rng), reach_px=60, window_px=WINDOW_PX)
    np.testing.assert_array_equal(found_px, disparity_px)


def test_no_place_is_found_beyond_reach() -> None:
    rng = np.random.default_rng(0)
    left = texture(rng)
    right = np.roll(left, -70, axis=1)
    found_px = find_along_row(left, right, places_inside(rng), reach_px=60, window_px=WINDOW_PX)
    assert np.isnan(found_px).mean() > 0.9


def test_no_place_is_found_where_a_texture_repeats() -> None:
    rng = np.random.default_rng(0)
    left = texture(rng, period_px=24)
    found_px = find_along_row(left, left, places_inside(rng), reach_px=60, window_px=WINDOW_PX)
    assert np.isnan(found_px).all()


def test_no_place_is_found_for_windows_across_the_border() -> None:
    left = texture(np.random.default_rng(0))
    places = np.array([[2.0, 50.0], [150.0, 1.0], [298.0, 50.0], [150.0, 98.0]])
    assert np.isnan(find_along_row(left, left, places, reach_px=60, window_px=WINDOW_PX)).all()
    assert find_along_row(left, left, places[:0], reach_px=60, window_px=WINDOW_PX).shape == (0,)
