"""Entropy of the grey levels against numpy's histogram, and where it is known."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.predictors.entropy import HALF_SIZE_PX, entropy
from probevo.sequences import open_sequence

CENTER = np.array([[40.0, 30.0]])


def slow_entropy(left: Image, uv: FloatArray, half: int) -> list[float]:
    """PROBE eq. (16), patch by patch."""
    values = []
    for u, v in np.floor(uv + 0.5).astype(int):
        counts = np.histogram(
            left[v - half : v + half + 1, u - half : u + half + 1], bins=256, range=(0, 256)
        )[0]
        shares = counts[counts > 0] / counts.sum()
        values.append(-float(np.sum(shares * np.log2(shares))))
    return values


def textured(seed: int) -> Image:
    """Smooth noise, [60, 80]."""
    noise = cv2.GaussianBlur(np.random.default_rng(seed).normal(size=(60, 80)), (0, 0), 1.5)
    return np.clip(128 + 150 * noise, 0, 255).astype(np.uint8)


def test_it_is_the_slow_definition() -> None:
    """Patches everywhere in the image, up to its border."""
    image = textured(0)
    half = HALF_SIZE_PX
    uv = np.random.default_rng(1).uniform([half, half], [79 - half, 59 - half], size=(30, 2))
    uv = np.concatenate([uv, [[half, half], [79 - half, 59 - half]]])
    np.testing.assert_allclose(entropy(image, uv), slow_entropy(image, uv, half), atol=1e-12)


@pytest.mark.data
def test_it_is_the_slow_definition_on_the_road(data_root: Path) -> None:
    frame = next(iter(open_sequence(data_root / "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync")))
    assert frame.left is not None
    uv = np.random.default_rng(2).uniform(10, np.array(frame.left.shape[::-1]) - 11, size=(200, 2))
    np.testing.assert_allclose(
        entropy(frame.left, uv), slow_entropy(frame.left, uv, 10), atol=1e-12
    )


@pytest.mark.parametrize("level", [0, 90, 255])
def test_a_constant_patch_has_none(level: int) -> None:
    assert entropy(np.full((60, 80), level, np.uint8), CENTER)[0] == 0.0


@pytest.mark.parametrize("levels", [3, 9, 441 // 3])
def test_levels_that_are_alike_have_the_logarithm_of_their_number(levels: int) -> None:
    image = np.zeros((60, 80), np.uint8)
    grey = np.random.default_rng(3).permutation(256)[
        :levels
    ]  # where they stand makes no difference
    image[20:41, 30:51] = np.resize(grey, 441).reshape(21, 21)
    assert 441 % levels == 0
    assert entropy(image, CENTER)[0] == pytest.approx(np.log2(levels), abs=1e-12)


def test_patches_that_leave_the_image_are_unknown() -> None:
    """At every position, whole and half, around and in the image; the neighbours' values are not
    touched."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(-15, 95, 2.5), np.arange(-15, 75, 2.5)))
    inside = (np.floor(u + 0.5) >= 10) & (np.floor(u + 0.5) <= 69) & (np.floor(v + 0.5) >= 10)
    inside &= np.floor(v + 0.5) <= 49
    image = textured(4)
    uv = np.column_stack([u, v])
    values = entropy(image, uv)
    np.testing.assert_array_equal(np.isnan(values), ~inside)
    np.testing.assert_allclose(values[inside], slow_entropy(image, uv[inside], 10), atol=1e-12)


def test_features_that_are_nowhere_and_images_that_are_empty() -> None:
    nowhere = np.array(
        [[np.nan, 30.0], [40.0, np.nan], [np.inf, 30.0], [40.0, -np.inf], [1e300, -1e300]]
    )
    np.testing.assert_array_equal(entropy(textured(5), nowhere), np.full(5, np.nan))
    np.testing.assert_array_equal(entropy(np.zeros((0, 0), np.uint8), CENTER), [np.nan])
    assert entropy(textured(5), np.zeros((0, 2))).shape == (0,)
