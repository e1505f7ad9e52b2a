"""Grey values from radiance: quantisation, gain and noise."""

import numpy as np
import pytest

from probevo_sim.scene.sensor import FULL_EXPOSURE, FULL_NOISE_GREY, WHITE_GREY, expose, exposures


def flat(grey: float) -> np.ndarray:
    return np.full((200, 300), grey / WHITE_GREY, dtype=np.float32)


def test_without_noise_the_grey_value_is_the_gain_times_the_light() -> None:
    image = expose(flat(64.0), gain=1.5, noise=0.0, rng=np.random.default_rng(0))
    assert (image == 96).all()


def test_the_sensor_saturates() -> None:
    assert (expose(flat(300.0), gain=1.0, noise=0.0, rng=np.random.default_rng(0)) == 255).all()


@pytest.mark.parametrize(("grey", "share"), [(40.0, 0.3 + 0.7 * 40 / 128), (128.0, 1.0)])
def test_noise_has_its_variance_and_zero_mean(grey: float, share: float) -> None:
    """Shot noise over read noise, and 1/12 from rounding; 4σ bounds over 60,000 pixels."""
    image = expose(flat(grey), gain=1.0, noise=0.5, rng=np.random.default_rng(0)).astype(float)
    variance = (0.5 * FULL_NOISE_GREY) ** 2 * share + 1.0 / 12.0
    assert image.var() == pytest.approx(variance, rel=4 * np.sqrt(2 / image.size))
    assert image.mean() == pytest.approx(grey, abs=4 * np.sqrt(variance / image.size))


def test_exposure_stays_within_its_factor_and_off_is_off() -> None:
    """Over 5,000 frames both bounds are nearly reached, and the mean logarithm is 0 within 3σ."""
    rng = np.random.default_rng(0)
    gains = exposures(5000, 1.0, rng)
    assert 1.0 / FULL_EXPOSURE < gains.min() < 1.5 / FULL_EXPOSURE
    assert FULL_EXPOSURE / 1.5 < gains.max() < FULL_EXPOSURE
    assert abs(np.log(gains).mean()) < 3.0 * np.log(gains).std() * np.sqrt(4.0 / 5000)
    np.testing.assert_array_equal(exposures(50, 0.0, rng), 1.0)


def test_same_seed_same_noise() -> None:
    first, second = (
        expose(flat(100.0), 1.0, 1.0, rng=np.random.default_rng([3, 4])) for _ in range(2)
    )
    np.testing.assert_array_equal(first, second)
