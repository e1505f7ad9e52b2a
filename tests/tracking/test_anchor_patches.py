"""Windows fitted by affine maps, on a texture that is known everywhere."""

import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.tracking.anchor_patches import MAX_GROWTH, Windows

HEIGHT_PX = 160
WIDTH_PX = 240
SIDE = 11
GRID = np.stack(
    np.meshgrid(np.arange(30.0, 210.0, 20.0), np.arange(30.0, 130.0, 20.0)), axis=-1
).reshape(-1, 2)
"""Features, in the middle of the image."""
MIDDLE = np.array([120.0, 80.0])


def texture(points: FloatArray) -> FloatArray:
    """Smooth and random brightness at points [..., 2]: 50 waves of 6 to 60 px."""
    rng = np.random.default_rng(1)
    wave, direction, phase = (
        2 * np.pi / np.geomspace(6, 60, 50),
        *rng.uniform(0, 2 * np.pi, (2, 50)),
    )
    along = points @ np.stack([wave * np.cos(direction), wave * np.sin(direction)])
    return 128.0 + 8.0 * np.sin(along + phase).sum(axis=-1)


def shown(A: FloatArray, shift: FloatArray) -> Image:
    """The image of which the texture's point x is at A (x − MIDDLE) + MIDDLE + shift."""
    v, u = np.mgrid[:HEIGHT_PX, :WIDTH_PX].astype(float)
    pixels = np.stack([u, v], axis=-1)
    points = (pixels - MIDDLE - shift) @ np.linalg.inv(A).T + MIDDLE
    return np.clip(np.round(texture(points)), 0, 255).astype(np.uint8)


def moved(pixels: FloatArray, A: FloatArray, shift: FloatArray) -> FloatArray:
    return (pixels - MIDDLE) @ A.T + MIDDLE + shift


FIRST = shown(np.eye(2), np.zeros(2))


@pytest.fixture
def windows() -> Windows:
    return Windows.cut(FIRST, GRID, SIDE)


@pytest.mark.parametrize(
    ("A", "growth"),
    [
        (np.eye(2), 1.0),
        (1.2 * np.eye(2), 1.2),
        (np.array([[1.0, 0.03], [0.0, 1.03]]), 1.0),
        (0.9 * np.array([[np.cos(0.05), -np.sin(0.05)], [np.sin(0.05), np.cos(0.05)]]), 0.9),
    ],
    ids=["shift", "approach", "shear", "turn"],
)
def test_a_window_is_found_under_an_affine_map(
    windows: Windows, A: FloatArray, growth: float
) -> None:
    """From half a pixel off, and with the scale alone expected: to a few hundredths of a pixel, as
    is the map."""
    shift = np.array([0.4, -0.3])
    true = moved(GRID, A, shift)
    found, difference, now = windows.found_in_left(
        shown(A, shift), true + 0.5, np.full(len(GRID), growth)
    )
    assert np.median(np.abs(found - true)) < 0.03
    assert np.median(np.abs(now.affine - A)) < 0.02
    assert np.median(difference) < 2.0


def test_a_part_of_a_pixel_stays_with_its_window() -> None:
    """A feature between pixels is that point of its window, whatever the window becomes."""
    features = GRID + np.array([0.37, -0.21])
    A = 1.15 * np.eye(2)
    windows = Windows.cut(FIRST, features, SIDE)
    true = moved(features, A, np.zeros(2))
    found, _, _ = windows.found_in_left(shown(A, np.zeros(2)), true + 0.3, np.full(len(GRID), 1.1))
    assert np.median(np.abs(found - true)) < 0.03


def test_errors_do_not_add_up_over_many_frames(windows: Windows) -> None:
    """Fifteen steps of 2 %, each started where the last one ended: no further off than after one."""
    pixels = GRID
    before = np.eye(2)
    for k in range(1, 16):
        A = 1.02**k * np.eye(2)
        pixels, _, windows = windows.found_in_left(
            shown(A, np.zeros(2)),
            moved(pixels, A @ np.linalg.inv(before), np.zeros(2)),
            np.full(len(GRID), 1.02),
        )
        before = A
    inside = ((pixels > 12) & (pixels < np.array([WIDTH_PX, HEIGHT_PX]) - 12)).all(axis=1)
    assert inside.sum() > 20
    assert np.median(np.abs(pixels - moved(GRID, before, np.zeros(2)))[inside]) < 0.03


def test_the_right_image_shows_the_left_one_slanted(windows: Windows) -> None:
    """A disparity that grows by 0.1 px a row is found with its slope, and is expected in the next
    frame."""
    A = np.array([[1.0, -0.1], [0.0, 1.0]])
    shift = np.array([-9.0, 0.0])
    true = moved(GRID, A, shift)
    found, _, now = windows.found_in_right(shown(A, shift), true + np.array([0.6, 0.0]))
    assert np.median(np.abs(found - true)) < 0.03
    assert np.median(np.abs(now.slant - A)) < 0.02
    again, _, _ = now.found_in_right(shown(A, shift), true + np.array([0.6, 0.0]))
    assert np.median(np.abs(again - true)) <= np.median(np.abs(found - true)) + 1e-3


def test_what_does_not_fit_stays_and_is_cut_anew(windows: Windows) -> None:
    """Another texture: nothing converges nearby, and the window of the new image is the one to
    follow."""
    other = np.random.default_rng(0).integers(0, 256, (HEIGHT_PX, WIDTH_PX)).astype(np.uint8)
    found, difference, now = windows.found_in_left(other, GRID, np.ones(len(GRID)))
    stayed = (found == GRID).all(axis=1)
    assert stayed.mean() > 0.8
    np.testing.assert_array_equal(np.isinf(difference), stayed)
    np.testing.assert_array_equal(
        now.affine[stayed], np.broadcast_to(np.eye(2), (int(stayed.sum()), 2, 2))
    )
    np.testing.assert_array_equal(
        now.first_sight[stayed], Windows.cut(other, GRID[stayed], SIDE).first_sight
    )
    right, _, same = windows.found_in_right(other, GRID)
    there = (right == GRID).all(axis=1)
    np.testing.assert_array_equal(same.slant[there], windows.slant[there])


def test_a_window_that_has_grown_much_is_cut_anew(windows: Windows) -> None:
    A = 1.2 * MAX_GROWTH * np.eye(2)
    true = moved(GRID, A, np.zeros(2))
    inside = ((true > 12) & (true < np.array([WIDTH_PX, HEIGHT_PX]) - 12)).all(axis=1)
    windows = Windows.cut(FIRST, GRID[inside], SIDE)
    windows = Windows(
        windows.first_sight, windows.offset, 1.2 * windows.affine, slant=windows.slant
    )
    _, _, now = windows.found_in_left(
        shown(A, np.zeros(2)), true[inside], np.full(int(inside.sum()), MAX_GROWTH)
    )
    np.testing.assert_array_equal(now.affine, np.broadcast_to(np.eye(2), now.affine.shape))


def test_features_at_the_border_and_without_texture_stay() -> None:
    at_border = np.array([[1.0, 80.0], [238.5, 3.0], [120.0, 159.0]])
    found, _, _ = Windows.cut(FIRST, at_border, SIDE).found_in_left(FIRST, at_border, np.ones(3))
    np.testing.assert_array_equal(found, at_border)
    grey = np.full((HEIGHT_PX, WIDTH_PX), 128, np.uint8)
    found, _, now = Windows.cut(grey, GRID, SIDE).found_in_left(grey, GRID, np.ones(len(GRID)))
    np.testing.assert_array_equal(found, GRID)
    assert np.isfinite(now.affine).all()


def test_windows_are_kept_and_joined(windows: Windows) -> None:
    few = windows.kept(np.arange(len(GRID)) < 7)
    both = few.joined(windows.kept(np.array([8, 9])))
    assert len(few) == 7
    assert len(both) == 9
    np.testing.assert_array_equal(both.first_sight[7:], windows.first_sight[8:10])


def test_no_features_are_no_problem() -> None:
    nobody = Windows.cut(FIRST, np.zeros((0, 2)), SIDE)
    found, _, now = nobody.found_in_left(FIRST, np.zeros((0, 2)), np.zeros(0))
    assert found.shape == (0, 2)
    assert len(now.found_in_right(FIRST, found)[2]) == 0
