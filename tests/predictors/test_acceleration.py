"""The two accelerations of known forces: what of gravity, of horizontal acceleration and of
vibration is seen."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.geometry import so3
from probevo.predictors.acceleration import acceleration
from probevo.sequences.frame import ImuSamples
from probevo.sequences.imu_calibration import GRAVITY_M_S2

GRAVITY = np.array([0.0, 0.0, GRAVITY_M_S2])


def samples(force_m_s2: FloatArray) -> ImuSamples:
    count = len(force_m_s2)
    return ImuSamples(5_000_000 * np.arange(count), np.zeros((count, 3)), force_m_s2)


def test_standing_is_nothing_however_the_imu_is_turned() -> None:
    for C in so3.exp(np.random.default_rng(0).normal(size=(10, 3))):
        np.testing.assert_allclose(
            acceleration(samples(np.tile(C @ GRAVITY, (20, 1)))), 0.0, atol=1e-12
        )


@pytest.mark.parametrize("up_m_s2", [-3.0, 2.0])
def test_vertical_acceleration_shows_in_full(up_m_s2: float) -> None:
    force = np.tile(GRAVITY + np.array([0.0, 0.0, up_m_s2]), (20, 1))
    np.testing.assert_allclose(acceleration(samples(force)), [abs(up_m_s2), 0.0], atol=1e-12)


def test_horizontal_acceleration_hardly_shows() -> None:
    force = np.tile(GRAVITY + np.array([2.0, 0.0, 0.0]), (20, 1))
    expected = np.hypot(GRAVITY_M_S2, 2.0) - GRAVITY_M_S2
    assert expected < 0.21
    np.testing.assert_allclose(acceleration(samples(force)), [expected, 0.0], atol=1e-12)


def test_vibration_is_its_root_mean_square() -> None:
    """An amplitude of 3 m/s² along some axis, over whole periods."""
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    wave = 3.0 * np.sin(2.0 * np.pi * np.arange(20) / 5)
    np.testing.assert_allclose(
        acceleration(samples(GRAVITY + wave[:, None] * axis)), [0.0, 3.0 / 2**0.5], atol=1e-12
    )


def test_gravity_leaks_into_the_vibration_when_the_camera_turns() -> None:
    """By as much as the docstring says: 0.03 m/s² for 0.1 rad/s over 0.1 s."""
    turn_rad = np.linspace(0.0, 0.1 * 0.1, 200)
    force = so3.exp(turn_rad[:, None] * [1.0, 0.0, 0.0]) @ GRAVITY
    _, vibration = acceleration(samples(force))
    assert vibration == pytest.approx(0.03, abs=0.003)


def test_without_accelerometer_it_is_unknown() -> None:
    assert np.isnan(acceleration(samples(np.full((20, 3), np.nan)))).all()
    assert np.isnan(acceleration(samples(np.zeros((0, 3))))).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("axes", [[0], [1, 2], [0, 1, 2]])
def test_samples_that_are_not_finite_are_left_out(value: float, axes: list[int]) -> None:
    """One axis is enough: the values are those of the remaining samples, to the last bit."""
    force = GRAVITY + np.random.default_rng(1).normal(size=(20, 3))
    rows = [0, 7, 8, 19]
    broken = force.copy()
    broken[np.ix_(rows, axes)] = value
    rest = acceleration(samples(np.delete(force, rows, axis=0)))
    assert np.isfinite(rest).all()
    np.testing.assert_array_equal(acceleration(samples(broken)), rest)


def test_one_finite_sample_is_an_acceleration_without_vibration() -> None:
    force = np.full((20, 3), np.nan)
    force[3] = GRAVITY + np.array([0.0, 0.0, 2.0])
    np.testing.assert_allclose(acceleration(samples(force)), [2.0, 0.0], atol=1e-12)
