"""The two bands against numpy's FFT, and pure waves that lie in one of them."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from probevo.arrays import FloatArray, Image
from probevo.predictors.frequency import SIZE_PX, frequency
from probevo.sequences import open_sequence

CENTER = np.array([[40.0, 30.0]])


def slow_frequency(left: Image, uv: FloatArray, size: int) -> FloatArray:
    """The whole spectrum, patch by patch."""
    values = []
    high = slice(size // 2 - 2, size // 2 + 2)
    for u, v in np.floor(uv + 0.5).astype(int) - size // 2:
        magnitude = np.log1p(
            np.abs(np.fft.fft2(left[v : v + size, u : u + size].astype(float), norm="ortho"))
        )
        values.append([np.mean(magnitude[:4, :4].ravel()[1:]), np.mean(magnitude[high, high])])
    return np.array(values)


def textured(seed: int) -> Image:
    """Noise over smooth noise, [60, 80]."""
    rng = np.random.default_rng(seed)
    noise = (
        cv2.GaussianBlur(rng.normal(size=(60, 80)), (0, 0), 2.0) * 200
        + rng.normal(size=(60, 80)) * 10
    )
    return np.clip(128 + noise, 0, 255).astype(np.uint8)


def wave(k_u: int, k_v: int, size: int = 20, amplitude: float = 100.0) -> Image:
    """A wave with so many periods in ``size`` pixels along each axis, [60, 80], its crest at the
    origin of a patch."""
    v, u = np.indices((60, 80)) - CENTER[0, ::-1, None, None].astype(int) + size // 2
    return np.rint(128 + amplitude * np.cos(2 * np.pi * (k_u * u + k_v * v) / size)).astype(
        np.uint8
    )


def test_it_is_the_slow_definition() -> None:
    """Patches everywhere in the image, up to its border."""
    image = textured(0)
    size = SIZE_PX
    last = np.array([80, 60]) - size + size // 2  # centre of the patch in the bottom right corner
    uv = np.random.default_rng(1).uniform(size // 2, last, size=(30, 2))
    uv = np.concatenate([uv, [[size // 2, size // 2], last]])
    np.testing.assert_allclose(frequency(image, uv), slow_frequency(image, uv, size), rtol=1e-10)


@pytest.mark.data
def test_it_is_the_slow_definition_on_the_road(data_root: Path) -> None:
    frame = next(iter(open_sequence(data_root / "kitti_raw/2011_09_26/2011_09_26_drive_0005_sync")))
    assert frame.left is not None
    uv = np.random.default_rng(2).uniform(10, np.array(frame.left.shape[::-1]) - 11, size=(200, 2))
    np.testing.assert_allclose(
        frequency(frame.left, uv), slow_frequency(frame.left, uv, 20), rtol=1e-10
    )


@pytest.mark.parametrize(
    ("k_u", "k_v", "band"), [(2, 1, 0), (0, 3, 0), (1, 0, 0), (8, 9, 1), (10, 8, 1), (9, 9, 1)]
)
def test_a_wave_lights_up_its_band(k_u: int, k_v: int, band: int) -> None:
    """The other band gets no more than the rounding to grey levels."""
    values = frequency(wave(k_u, k_v), CENTER)[0]
    assert values[band] > 0.4  # ln(1 + 50 · 20) ≈ 6.9 over 15 or 16 coefficients
    assert values[1 - band] < 0.25
    assert values[band] > 2.0 * values[1 - band]


def test_a_wave_between_the_bands_lies_in_neither() -> None:
    assert np.all(frequency(wave(5, 6), CENTER)[0] < 0.25)


def test_the_finest_checkerboard_is_one_coefficient() -> None:
    """±a in turn is F = 20 a at Nyquist along both axes, and nothing elsewhere."""
    rows, columns = np.indices((60, 80))
    board = (100 + 30 * (-1) ** (rows + columns)).astype(np.uint8)
    np.testing.assert_allclose(
        frequency(board, CENTER), [[0.0, np.log(1 + 20 * 30) / 16]], atol=1e-10
    )


def test_brightness_is_no_texture() -> None:
    np.testing.assert_allclose(
        frequency(np.full((60, 80), 200, np.uint8), CENTER), [[0.0, 0.0]], atol=1e-10
    )
    image = textured(3) // 2
    np.testing.assert_allclose(frequency(image + 50, CENTER), frequency(image, CENTER), atol=1e-10)


def test_blur_takes_the_high_frequencies_first() -> None:
    """Which a mirrored low band, as in PROBE's experiments, would not tell."""
    image = textured(4)
    sharp = frequency(image, CENTER)[0]
    blurred = frequency(cv2.GaussianBlur(image, (0, 0), 1.5), CENTER)[0]
    assert blurred[1] < 0.3 * sharp[1]
    assert blurred[0] > 0.9 * sharp[0]


def test_patches_that_leave_the_image_are_unknown() -> None:
    """At every position, whole and half, around and in the image; ten pixels before the centre and
    nine after."""
    u, v = (axis.ravel() for axis in np.meshgrid(np.arange(-15, 95, 2.5), np.arange(-15, 75, 2.5)))
    inside = (np.floor(u + 0.5) >= 10) & (np.floor(u + 0.5) <= 70) & (np.floor(v + 0.5) >= 10)
    inside &= np.floor(v + 0.5) <= 50
    image = textured(5)
    uv = np.column_stack([u, v])
    values = frequency(image, uv)
    np.testing.assert_array_equal(np.isnan(values), np.column_stack([~inside, ~inside]))
    np.testing.assert_allclose(values[inside], slow_frequency(image, uv[inside], 20), rtol=1e-10)


def test_features_that_are_nowhere_and_images_that_are_empty() -> None:
    nowhere = np.array(
        [[np.nan, 30.0], [40.0, np.nan], [np.inf, 30.0], [40.0, -np.inf], [1e300, -1e300]]
    )
    np.testing.assert_array_equal(frequency(textured(6), nowhere), np.full((5, 2), np.nan))
    np.testing.assert_array_equal(frequency(np.zeros((0, 0), np.uint8), CENTER), [[np.nan, np.nan]])
    assert frequency(textured(6), np.zeros((0, 2))).shape == (0, 2)
