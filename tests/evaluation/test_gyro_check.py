"""The gyro against the images: mistakes come back within their covariance, large ones, too."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import chi2

from probevo.arrays import FloatArray, IntArray
from probevo.evaluation.gyro_check import (
    LAG,
    MOUNTING,
    SCALE,
    check_gyro,
    integrated_rotations,
)
from probevo.geometry import se3, so3
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration

CALIBRATION = ImuCalibration(se3.exp(np.array([0.1, 0.2, -0.3, 0.3, -1.2, 0.5])), 1e-3, 0.05)
BIAS_RAD_S = np.array([0.02, -0.03, 0.01])
NOISE_RAD = 3e-4


@cache
def drive(seed: int = 0) -> tuple[IntArray, FloatArray, ImuStream]:
    """Six seconds of a camera that is swung about two axes, and its gyro at 100 Hz."""
    rng = np.random.default_rng(seed)
    stamps_ns = np.arange(0, 6_400_000_000, 10_000_000)
    time_s = 1e-9 * stamps_ns
    rates = np.column_stack(
        [0.3 * np.sin(4.0 * time_s), 0.5 * np.cos(3.0 * time_s), 0.1 * np.sin(7.0 * time_s)]
    )
    gyro = rates @ CALIBRATION.C_cam_imu
    frames_ns = np.arange(300_000_000, 6_100_000_000, 100_000_000)
    between_ns = np.column_stack([frames_ns[:-1], frames_ns[1:]])
    exact = ImuStream.checked(
        stamps_ns, gyro, np.full_like(gyro, np.nan), frames_ns=frames_ns, where="imu.csv"
    )
    image_rad = integrated_rotations(between_ns, exact, CALIBRATION)
    image_rad += NOISE_RAD * rng.normal(size=image_rad.shape)
    return between_ns, image_rad, replace(exact, gyro_rad_s=exact.gyro_rad_s + BIAS_RAD_S)


def test_a_good_calibration_agrees_with_itself() -> None:
    """Mean square of mounting, scale and lag over eight drives, as the normal variables that are as
    improbable, χ²."""
    kept = [*range(*MOUNTING.indices(8)), SCALE, LAG]
    z = []
    for seed in range(8):
        found = check_gyro(*drive(seed), CALIBRATION)
        assert found is not None
        regression = found.regression
        for k in kept:
            p_value = regression.p_value(regression.values[k], regression.sigma[k])
            z.append(ndtri(0.5 * p_value))
    low, high = np.asarray(chi2.ppf([0.005, 0.995], len(z))) / len(z)
    assert low < np.mean(np.square(z)) < 1.3 * high


@pytest.mark.parametrize("turn_rad", [0.02, np.pi])
def test_a_wrong_mounting_comes_back(turn_rad: float) -> None:
    between_ns, image_rad, stream = drive()
    wrong = CALIBRATION.T_cam_imu.copy()
    wrong[:3, :3] = so3.exp(turn_rad * np.array([0.6, 0.0, 0.8])) @ wrong[:3, :3]
    found = check_gyro(between_ns, image_rad, stream, replace(CALIBRATION, T_cam_imu=wrong))
    assert found is not None
    error_rad = so3.log(found.C_cam_imu @ CALIBRATION.C_cam_imu.T)
    # A weak prior draws a turn of half a circle back by a thousandth of its length.
    np.testing.assert_allclose(error_rad, 0.0, atol=0.005)
    assert np.linalg.norm(found.regression.values[MOUNTING]) == pytest.approx(turn_rad, abs=0.006)


@pytest.mark.parametrize("factor", [np.rad2deg(1.0), 1.05, -1.0])
def test_a_wrong_unit_or_sign_comes_back(factor: float) -> None:
    between_ns, image_rad, stream = drive()
    found = check_gyro(
        between_ns, image_rad, replace(stream, gyro_rad_s=factor * stream.gyro_rad_s), CALIBRATION
    )
    assert found is not None
    assert 1.0 / (1.0 + found.regression.values[SCALE]) == pytest.approx(factor, rel=0.01)
    # Degrees are integrated as radians at first, so that the turns of a step do not commute.
    assert np.linalg.norm(found.regression.values[MOUNTING]) < 0.02


@pytest.mark.parametrize("late_s", [-0.1, 0.004, 0.15])
def test_a_late_clock_comes_back(late_s: float) -> None:
    between_ns, image_rad, stream = drive()
    late = replace(stream, stamps_ns=stream.stamps_ns + round(1e9 * late_s))
    found = check_gyro(between_ns, image_rad, late, CALIBRATION)
    assert found is not None
    assert found.regression.values[LAG] == pytest.approx(-late_s, abs=0.002)
    assert found.regression.sigma[LAG] < 0.002


def test_too_few_steps_say_nothing() -> None:
    between_ns, image_rad, stream = drive()
    assert check_gyro(between_ns[:5], image_rad[:5], stream, CALIBRATION) is None


@pytest.mark.parametrize(("swing", "most"), [(1.0, 0.01), (0.0, 1.2)])
def test_a_gyro_that_is_shaken_is_as_noisy_as_it_shows(swing: float, most: float) -> None:
    """Twenty times as noisy as its data sheet: at rest, its unit cannot be told from that."""
    between_ns, image_rad, stream = drive()
    rng = np.random.default_rng(2)
    noise = 20.0 * 1e-3 / np.sqrt(0.01) * rng.normal(size=stream.gyro_rad_s.shape)
    shaken = replace(stream, gyro_rad_s=swing * stream.gyro_rad_s + 0.1 * noise)
    found = check_gyro(between_ns, swing * image_rad, shaken, CALIBRATION)
    assert found is not None
    assert (0.5 if swing == 0.0 else 0.0) < found.attenuation < most
