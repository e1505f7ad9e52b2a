"""Splines of images: what they leave of a wave, and where they show it."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.tracking.anchor_patches_numba import _spline_weights
from probevo.tracking.spline import spline_through

FRACTIONS = np.linspace(0.0, 1.0, 21).astype(np.float32)


def response(wave_px: float, fraction: np.float32) -> complex:
    """What the spline of exp(2πi u / wave_px) is at a fraction of a pixel, over the wave there."""
    coefficients = np.arange(-1, 3)
    step = 2.0 * np.pi / wave_px
    # A wave is an eigenfunction of the filter that makes the coefficients: those of its real and
    # its imaginary part are measured in the middle of an image.
    u = np.arange(200)
    grey = [128.0 + 100.0 * np.cos(step * u), 128.0 + 100.0 * np.sin(step * u)]
    rows = [np.tile(np.round(row).astype(np.uint8), (9, 1)) for row in grey]
    real, imaginary = (spline_through(row).coefficients[4, 20:180] - 128.0 for row in rows)
    sharpened = np.mean((real + 1j * imaginary) * np.exp(-1j * step * u[20:180])) / 100.0
    weights = np.array(_spline_weights(fraction))
    return complex(sharpened * weights @ np.exp(1j * step * (coefficients - fraction)))


@pytest.mark.parametrize(
    ("wave_px", "moved_px", "kept"), [(4.0, 0.008, 0.85), (6.0, 0.002, 0.95), (12.0, 0.001, 0.98)]
)
def test_waves_stay_where_they_are(wave_px: float, moved_px: float, kept: float) -> None:
    """Bilinear interpolation moves them by up to 0.045, 0.019 and 0.004 px."""
    responses = np.array([response(wave_px, fraction) for fraction in FRACTIONS])
    assert np.abs(np.angle(responses)).max() * wave_px / (2.0 * np.pi) < moved_px
    assert kept < np.abs(responses).min()
    assert np.abs(responses).max() < 1.01


def test_the_spline_goes_through_all_pixels() -> None:
    """To what the taps beyond reach would add."""
    image = np.random.default_rng(0).integers(0, 256, (40, 60)).astype(np.uint8)
    coefficients = spline_through(image).coefficients
    mean = np.array([1.0, 4.0, 1.0]) / 6.0
    at_pixels = sum(
        mean[i] * mean[j] * coefficients[i : i + 38, j : j + 58] for i in range(3) for j in range(3)
    )
    np.testing.assert_allclose(at_pixels, image[1:-1, 1:-1], atol=3.0)


def test_weights_add_up_to_one_and_are_symmetric() -> None:
    weights: FloatArray = np.array([_spline_weights(fraction) for fraction in FRACTIONS])
    np.testing.assert_allclose(weights.sum(axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(weights, weights[::-1, ::-1], atol=1e-6)
    np.testing.assert_allclose(weights[0], np.array([1.0, 4.0, 1.0, 0.0]) / 6.0, atol=1e-6)
