"""Corners are spread over the grid: each cell gets the strongest of its own, up to its share."""

import numpy as np
import pytest

from probevo.arrays import FloatArray, Image, IntArray
from probevo.config import TrackingConfig
from probevo.tracking.detection import (
    AROUND_WINDOW_PX,
    corners_in_free_cells,
    non_overlapping,
    strongest_corners,
)

HEIGHT_PX = 120
WIDTH_PX = 160
CELL_PX = 40
COLUMNS = 4
ROWS = 3
NO_FEATURES = np.zeros((0, 2))
TWO_A_CELL = TrackingConfig(num_features=2 * COLUMNS * ROWS)
"""As many features as make the cells CELL_PX wide: 2 · 160 · 120 / 24 = 40²."""
BORDER_PX = TWO_A_CELL.window_px // 2 + AROUND_WINDOW_PX


def detect_corners(image: Image, occupied_px: FloatArray, config: TrackingConfig) -> FloatArray:
    return corners_in_free_cells(
        strongest_corners(image, config), occupied_px, image.shape, config=config
    )


def many_dots(height: int = HEIGHT_PX, width: int = WIDTH_PX) -> Image:
    """A dot of some contrast every 10 px: more corners in each cell than any share used here, and
    all of them apart."""
    image = np.full((height, width), 100, np.uint8)
    spots = image[5::10, 5::10]
    spots += np.random.default_rng(0).integers(30, 150, spots.shape, dtype=np.uint8)
    return image


def dots(*centers_and_contrast: tuple[int, int, int]) -> Image:
    """Bright dots of one pixel at (u, v) on grey: each is one FAST corner, and its strength grows
    with its contrast."""
    image = np.full((HEIGHT_PX, WIDTH_PX), 100, np.uint8)
    for u, v, contrast in centers_and_contrast:
        image[v, u] += contrast
    return image


def count_per_cell(corners: FloatArray) -> IntArray:
    column, row = (corners // CELL_PX).astype(int).T
    return np.bincount(row * COLUMNS + column, minlength=COLUMNS * ROWS)


def as_set(corners: FloatArray) -> set[tuple[float, float]]:
    return {(float(u), float(v)) for u, v in corners}


def test_every_cell_gets_its_share_and_no_more() -> None:
    np.testing.assert_array_equal(
        count_per_cell(detect_corners(many_dots(), NO_FEATURES, TWO_A_CELL)), 2
    )


@pytest.mark.parametrize("wanted", [100, 300, 777, 1500])
def test_about_as_many_are_found_as_are_wanted(wanted: int) -> None:
    found = detect_corners(many_dots(375, 1242), NO_FEATURES, TrackingConfig(num_features=wanted))
    assert 0.99 * wanted <= len(found) <= 1.25 * wanted


def test_a_cell_gets_only_what_its_features_leave() -> None:
    """Shares of 2, with 0, 1, 2 and 5 features already in the four cells of the middle row."""
    already = np.array([0, 1, 2, 5])
    occupied = np.vstack(
        [np.tile([40.0 * column + 20.0, 60.0], (n, 1)) for column, n in enumerate(already)]
    )
    found = count_per_cell(detect_corners(many_dots(), occupied, TWO_A_CELL))
    np.testing.assert_array_equal(found, [2, 2, 2, 2, 2, 1, 0, 0, 2, 2, 2, 2])


def test_features_outside_the_image_count_for_the_nearest_cell() -> None:
    """A tracked feature may lie a fraction of a pixel beyond the border: no index error, no other
    cell robbed."""
    occupied = np.array([[-0.5, -3.0], [WIDTH_PX + 0.5, HEIGHT_PX + 2.0]])
    found = count_per_cell(detect_corners(many_dots(), occupied, TWO_A_CELL))
    np.testing.assert_array_equal(found, [1, *[2] * 10, 1])


def test_the_strongest_are_chosen() -> None:
    image = dots((52, 50, 30), (60, 50, 120), (68, 50, 60), (52, 65, 90), (60, 65, 40))
    assert as_set(detect_corners(image, NO_FEATURES, TWO_A_CELL)) == {(60, 50), (52, 65)}


def test_strength_is_compared_within_a_cell_only() -> None:
    image = dots((52, 60, 150), (60, 60, 140), (68, 60, 130), (100, 60, 20))
    assert as_set(detect_corners(image, NO_FEATURES, TWO_A_CELL)) == {(52, 60), (60, 60), (100, 60)}


def test_corners_less_than_half_a_window_from_another_are_dropped() -> None:
    """Neither the weaker one of two dots, nor one beside a feature already tracked."""
    image = dots((60, 60, 90), (66, 54, 80), (100, 60, 90), (107, 60, 80))
    assert as_set(detect_corners(image, NO_FEATURES, TWO_A_CELL)) == {
        (60, 60),
        (100, 60),
        (107, 60),
    }
    assert as_set(detect_corners(image, np.array([[62.4, 58.2]]), TWO_A_CELL)) == {
        (100, 60),
        (107, 60),
    }
    wide = TWO_A_CELL.model_copy(update={"window_px": 13})
    assert as_set(detect_corners(image, NO_FEATURES, wide)) == {(60, 60), (100, 60)}


def test_of_overlapping_features_the_first_is_kept() -> None:
    """A chain: the third overlaps only the second, which is dropped."""
    pixels = np.array([[50.0, 50.0], [55.0, 50.0], [60.0, 50.0], [50.2, 50.0], [50.0, 80.0]])
    shape = (HEIGHT_PX, WIDTH_PX)
    np.testing.assert_array_equal(
        non_overlapping(pixels, shape, TWO_A_CELL), [True, False, True, False, True]
    )
    assert len(non_overlapping(NO_FEATURES, shape, TWO_A_CELL)) == 0


def test_contrast_below_the_threshold_is_no_corner() -> None:
    image = dots((60, 60, 15), (100, 60, 25))
    found = detect_corners(image, NO_FEATURES, TrackingConfig(fast_threshold=20))
    assert as_set(found) == {(100, 60)}


def test_nothing_is_found_where_a_window_would_leave_the_image() -> None:
    last_u = WIDTH_PX - BORDER_PX - 1
    last_v = HEIGHT_PX - BORDER_PX - 1
    inside = [(BORDER_PX, 60), (last_u, 60), (80, BORDER_PX), (80, last_v)]
    outside = [(BORDER_PX - 1, 20), (last_u + 1, 20), (20, BORDER_PX - 1), (20, last_v + 1)]
    image = dots(*[(u, v, 100) for u, v in inside + outside])
    assert as_set(detect_corners(image, NO_FEATURES, TWO_A_CELL)) == set(inside)


def test_an_even_image_has_no_corners() -> None:
    found = detect_corners(np.full((HEIGHT_PX, WIDTH_PX), 128, np.uint8), NO_FEATURES, TWO_A_CELL)
    assert found.shape == (0, 2)


def test_a_size_that_is_no_multiple_of_the_cell_is_covered_to_its_edges() -> None:
    """170×130 px in cells of 40 px: five columns, four rows, the last ones 10 px wide, 8 of them
    border."""
    image = np.random.default_rng(1).integers(0, 256, (130, 170), dtype=np.uint8)
    found = detect_corners(image, NO_FEATURES, TrackingConfig(num_features=2 * 170 * 130 // 40**2))
    assert found[:, 0].max() >= 160
    assert found[:, 1].max() >= 120
    assert (found < [170 - BORDER_PX, 130 - BORDER_PX]).all()


def test_the_same_image_gives_the_same_corners() -> None:
    first, second = (detect_corners(many_dots(), NO_FEATURES, TWO_A_CELL) for _ in range(2))
    np.testing.assert_array_equal(first, second)
