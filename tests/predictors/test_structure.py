"""The structure tensor's eigenvalues against numpy's, and windows whose tensor is known."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.predictors.structure import HALF_SIZE_PX, structure
from probevo.sequences import open_sequence

CENTER = np.array([[40.0, 30.0]])


def slow_structure(left: Image, uv: FloatArray, half: int) -> FloatArray:
    """Gradients of the whole image, then the tensor window by window."""
    along_v, along_u = np.gradient(left.astype(float))
    values = []
    for u, v in np.floor(uv + 0.5).astype(int):
        window = (slice(v - half, v + half + 1), slice(u - half, u + half + 1))
        gradient = np.stack([along_u[window].ravel(), along_v[window].ravel()])
        values.append(np.log1p(np.linalg.eigvalsh(gradient @ gradient.T / gradient.shape[1])))
    return np.array(values)


def textured(seed: int) -> Image:
    """Smooth noise, [60, 80]."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(60, 80)), (0, 0), 1.5)
    return np.clip(128 + 150 * noise, 0, 255).astype(np.uint8)


def test_it_is_the_slow_definition() -> None:
    """Windows everywhere in the image, up to one pixel from its border."""
    image = textured(0)
    half = HALF_SIZE_PX
    uv = np.random.default_rng(1).uniform(
        [half + 1, half + 1], [78 - half, 58 - half], size=(30, 2)
    )
    uv = np.concatenate([uv, [[half + 1, half + 1], [78 - half, 58 - half]]])
    values = structure(image, uv)
    np.testing.assert_allclose(values, slow_structure(image, uv, half), atol=1e-9)


@pytest.mark.data
def test_it_is_the_slow_definition_on_the_road(data_root: Path) -> None:
    frame = next(iter(open_sequence(data_root / "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync")))
    assert frame.left is not None
    uv = np.random.default_rng(2).uniform(6, np.array(frame.left.shape[::-1]) - 7, size=(200, 2))
    np.testing.assert_allclose(
        structure(frame.left, uv), slow_structure(frame.left, uv, 5), atol=1e-9
    )


@pytest.mark.parametrize("turned", [False, True])
def test_an_edge_has_one_direction(turned: bool) -> None:
    """A step of 200: 2 of 11 columns have the gradient 100."""
    image = np.zeros((60, 80), np.uint8)
    image[:, 40:] = 200
    image = np.ascontiguousarray(image.T) if turned else image
    uv = CENTER[:, ::-1] if turned else CENTER
    np.testing.assert_allclose(structure(image, uv), [[0.0, np.log1p(2 / 11 * 100**2)]], rtol=1e-12)


def test_a_slanted_edge_has_one_direction_too() -> None:
    """Of a ramp along the diagonal, where rounding would leave something of a difference of two
    large numbers."""
    v, u = np.indices((60, 80))
    values = structure((u + v).astype(np.uint8), CENTER)
    np.testing.assert_allclose(values, [[0.0, np.log1p(2.0)]], atol=1e-12)


def test_a_plane_has_the_square_of_its_slope() -> None:
    v, u = np.indices((60, 80))
    np.testing.assert_allclose(
        structure((3 * u).astype(np.uint8), CENTER), [[0.0, np.log(10.0)]], rtol=1e-12
    )
    np.testing.assert_allclose(
        structure((2 * v).astype(np.uint8), CENTER), [[0.0, np.log(5.0)]], rtol=1e-12
    )


def test_no_texture_no_structure() -> None:
    np.testing.assert_array_equal(structure(np.full((60, 80), 90, np.uint8), CENTER), [[0.0, 0.0]])


def test_turning_the_image_changes_nothing() -> None:
    image = textured(3)
    turned = np.ascontiguousarray(image.T)
    np.testing.assert_allclose(
        structure(turned, CENTER[:, ::-1]), structure(image, CENTER), rtol=1e-12
    )


def test_the_smaller_stands_first() -> None:
    uv = np.random.default_rng(4).uniform([6, 6], [73, 53], size=(50, 2))
    values = structure(textured(4), uv)
    assert np.all((values[:, 0] >= 0.0) & (values[:, 0] <= values[:, 1]))


def test_windows_that_leave_the_image_are_unknown() -> None:
    """At every position, whole and half, around and in the image; the gradients need a pixel around
    the window."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(-15, 95, 2.5), np.arange(-15, 75, 2.5)))
    inside = (np.floor(u + 0.5) >= 6) & (np.floor(u + 0.5) <= 73) & (np.floor(v + 0.5) >= 6)
    inside &= np.floor(v + 0.5) <= 53
    image = textured(5)
    uv = np.column_stack([u, v])
    values = structure(image, uv)
    np.testing.assert_array_equal(np.isnan(values), np.column_stack([~inside, ~inside]))
    np.testing.assert_allclose(values[inside], slow_structure(image, uv[inside], 5), atol=1e-9)


def test_features_that_are_nowhere_and_images_that_are_empty() -> None:
    nowhere = np.array(
        [[np.nan, 30.0], [40.0, np.nan], [np.inf, 30.0], [40.0, -np.inf], [1e300, -1e300]]
    )
    np.testing.assert_array_equal(structure(textured(6), nowhere), np.full((5, 2), np.nan))
    np.testing.assert_array_equal(structure(np.zeros((0, 0), np.uint8), CENTER), [[np.nan, np.nan]])
    assert structure(textured(6), np.zeros((0, 2))).shape == (0, 2)
