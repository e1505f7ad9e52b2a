"""Accelerations of the rig itself, in those of the settings."""

import numpy as np
import pytest

from probevo.estimation.acceleration_scale import MAX_FACTOR, MEMORY_S, AccelerationScale

STEP_S = 0.05
CONFIGURED = np.repeat([5.0, 2.0], 3)
"""m/s² and rad/s²."""
NO_NOISE = np.zeros(6)


def after_steps(
    scale: AccelerationScale,
    num_steps: int,
    *,
    times: tuple[float, float],
    noise: float = 0.0,
    seed: int = 0,
) -> AccelerationScale:
    """Accelerate at random, with so many times the settings' standard deviations.

    Args:
        scale: at the start.
        num_steps: of 0.05 s.
        times: of the acceleration along an axis, and of the angular one.
        noise: standard deviation of each twist, in changes that the settings expect of a step.
        seed: of the accelerations.
    """
    rng = np.random.default_rng(seed)
    expected = CONFIGURED * STEP_S
    sigma = np.hypot(np.repeat(times, 3), np.sqrt(2.0) * noise)
    for _ in range(num_steps):
        change = sigma * expected * rng.normal(size=6)
        scale = scale.after(
            change,
            2.0 * (noise * expected) ** 2,
            accelerations=CONFIGURED,
            duration_s=STEP_S,
        )
    return scale


def test_a_rig_that_turns_suddenly_is_known_as_such_within_seconds() -> None:
    factors = after_steps(AccelerationScale(), 100, times=(1.0, 5.0)).factors
    np.testing.assert_allclose(factors, np.repeat([1.0, 5.0], 3), rtol=0.25)


def test_a_car_that_drives_evenly_may_still_brake() -> None:
    """What it usually does is known nevertheless, and the settings nearly forgotten."""
    scale = after_steps(AccelerationScale(), 1000, times=(0.2, 0.1))
    np.testing.assert_array_equal(scale.factors, np.ones(6))
    np.testing.assert_allclose(scale.usual_factors, np.repeat([0.2, 0.1], 3), rtol=0.25)


@pytest.mark.parametrize("noise", [0.5, 3.0])
def test_noise_of_the_twists_is_no_acceleration(noise: float) -> None:
    """It is subtracted; what is left scatters about the truth, over many rigs."""
    found = [
        after_steps(AccelerationScale(), 200, times=(2.0, 2.0), noise=noise, seed=seed).mean_square
        for seed in range(40)
    ]
    error = np.array(found) - 4.0
    # Squares below zero are taken for zero, so that much noise enlarges it, a little.
    assert abs(error.mean()) < (0.4 if noise < 1.0 else 4.0 * noise)


def test_at_rest_noise_is_no_acceleration_at_a_high_frame_rate() -> None:
    """Steps of 1 mm and 0.3 mrad at 200 Hz are changes of eight times what the settings expect."""
    rng = np.random.default_rng(0)
    duration_s = 0.005
    sigma_s = np.repeat([1e-3, 3e-4], 3) / duration_s
    twists_s = sigma_s * rng.normal(size=(2000, 6))
    scale = AccelerationScale()
    largest = []
    for change in np.diff(twists_s, axis=0):
        scale = scale.after(
            change, 2.0 * sigma_s**2, accelerations=CONFIGURED, duration_s=duration_s
        )
        largest.append(scale.factors.max())
    assert np.median(largest) < 2.0


def test_what_a_rig_did_long_ago_is_forgotten() -> None:
    shaken = after_steps(AccelerationScale(), 40, times=(4.0, 4.0))
    assert (shaken.factors > 3.0).all()
    at_rest = after_steps(shaken, round(4.0 * MEMORY_S / STEP_S), times=(0.0, 0.0))
    np.testing.assert_array_equal(at_rest.factors, np.ones(6))


def test_the_change_of_a_longer_step_counts_by_its_time() -> None:
    """The same acceleration shows the same, in steps of any length."""
    shown = [
        AccelerationScale().after(
            3.0 * CONFIGURED * duration_s,
            NO_NOISE,
            accelerations=CONFIGURED,
            duration_s=duration_s,
        )
        for duration_s in (0.1, 1.0)
    ]
    # 9 against the 1 of the settings, which count for a second that fades.
    for scale, duration_s in zip(shown, (0.1, 1.0), strict=True):
        kept_s = np.exp(-duration_s / MEMORY_S)
        expected = (kept_s + 9.0 * duration_s) / (kept_s + duration_s)
        np.testing.assert_allclose(scale.mean_square, expected, rtol=1e-12)


def test_a_wrong_stamp_pretends_no_more_than_the_largest_acceleration() -> None:
    """Two frames a nanosecond apart, by their stamps."""
    scale = AccelerationScale().after(
        np.full(6, 1e7), NO_NOISE, accelerations=CONFIGURED, duration_s=1e-9
    )
    np.testing.assert_allclose(scale.factors, 1.0, atol=1e-6)
    for _ in range(1000):
        scale = scale.after(np.full(6, 1e7), NO_NOISE, accelerations=CONFIGURED, duration_s=STEP_S)
    np.testing.assert_allclose(scale.factors, MAX_FACTOR, rtol=0.01)
