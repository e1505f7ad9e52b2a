"""Spikes of a gyro are found, and rotations are not taken for spikes."""

import numpy as np
import pytest

from probevo.sequences.gyro_spikes import find_spikes


@pytest.mark.parametrize("size_rad_s", [1.0, 5.0, 1000.0])
@pytest.mark.parametrize("at", range(11))
def test_a_spike_is_found_wherever_it_is(size_rad_s: float, at: int) -> None:
    rng = np.random.default_rng(0)
    rates = np.array([0.3, -0.2, 1.0]) + 0.01 * rng.normal(size=(11, 3))
    rates[at] += size_rad_s * np.array([0.6, 0.0, -0.8])
    np.testing.assert_array_equal(np.flatnonzero(find_spikes(rates)), [at])


def test_a_steep_turn_is_none() -> None:
    """Rates that change by 1 rad/s from sample to sample, or swing through, 100 times a second."""
    steep = np.outer(np.arange(10.0), [1.0, 0.5, 0.0])
    swinging = np.outer(2.0 * np.sin(np.arange(10.0)), [1.0, 0.0, 0.0])
    assert not find_spikes(steep).any()
    assert not find_spikes(swinging).any()


def test_noise_of_any_size_is_none() -> None:
    rng = np.random.default_rng(1)
    for sigma in (0.01, 1.0, 10.0):
        assert not any(find_spikes(sigma * rng.normal(size=(11, 3))).any() for _ in range(20))


def test_few_samples_tell_nothing() -> None:
    rates = np.zeros((4, 3))
    rates[2] = 1000.0
    assert not find_spikes(rates).any()
