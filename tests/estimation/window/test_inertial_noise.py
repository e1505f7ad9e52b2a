"""How much noisier an IMU is than its data sheet says."""

from dataclasses import replace

import numpy as np
import pytest

from inertial_worlds import CALIBRATION, SmoothPath, inertial_drive
from probevo.arrays import FloatArray
from probevo.estimation.window.inertial import MAX_EXCESS, NUM_TESTED, Inertial
from probevo.estimation.window.inertial_noise import (
    MEDIAN_SQUARED,
    InertialInnovation,
    estimated_noise_factor,
    innovation_of,
    median_excess,
)
from probevo.noise import StudentT
from probevo.odometry import StereoOdometry
from worlds import CAMERA


def covariance(rng: np.random.Generator) -> FloatArray:
    root = rng.normal(size=(6, 9))
    return np.asarray(root @ root.T)


def test_distance_is_that_of_the_sum_of_both_covariances() -> None:
    """νᵀ (A + k B)⁻¹ ν, at any k."""
    rng = np.random.default_rng(3)
    others = covariance(rng)
    samples = covariance(rng)
    difference = rng.normal(size=6)
    innovation = innovation_of(difference, others, samples)
    for noise_factor in (1.0, 4.0, 16.0):
        expected = difference @ np.linalg.solve(others + noise_factor * samples, difference)
        assert innovation.squared_distance(noise_factor) == pytest.approx(expected, rel=1e-9)


def test_noise_factor_is_found_from_many_innovations() -> None:
    """Of 400 drawn with k = 5, where the samples contribute as much as all others."""
    rng = np.random.default_rng(4)
    innovations = []
    for _ in range(400):
        others = covariance(rng)
        samples = covariance(rng)
        difference = rng.multivariate_normal(np.zeros(6), others + 5.0 * samples)
        innovations.append(innovation_of(difference, others, samples))
    assert estimated_noise_factor(innovations, largest=16.0) == pytest.approx(5.0, rel=0.15)
    assert estimated_noise_factor(innovations, largest=3.0) == 3.0
    assert median_excess(innovations, 5.0) == pytest.approx(1.0, rel=0.1)


def test_noise_factor_is_at_least_that_of_the_data_sheet() -> None:
    small = InertialInnovation(whitened_sq=np.full(6, 0.1 * MEDIAN_SQUARED / 6.0), noise=np.ones(6))
    assert estimated_noise_factor([small], largest=16.0) == 1.0


@pytest.mark.parametrize(("factor", "is_left_out"), [(6.0, False), (36.0, False), (144.0, True)])
def test_an_imu_that_is_not_left_out_claims_the_noise_that_it_shows(
    factor: float, is_left_out: bool
) -> None:
    """Where the noise of its samples is nearly all that it differs by from the images."""
    noise = 100.0
    whitened_sq = np.full(6, (1.0 + factor * noise) * MEDIAN_SQUARED / 6.0)
    inertial = Inertial(CALIBRATION)
    for _ in range(NUM_TESTED):
        innovation = InertialInnovation(whitened_sq, noise=np.full(6, noise))
        inertial = inertial.tested(innovation, is_gated=False)
    assert (inertial.excess > MAX_EXCESS) == is_left_out
    if not is_left_out:
        assert inertial.noise_factor == pytest.approx(factor, rel=0.01)


@pytest.mark.parametrize("damage", ["difference", "others", "indefinite"])
def test_innovation_that_cannot_be_computed_is_infinite(damage: str) -> None:
    """It is beyond any gate, and does not hide the others in the median."""
    rng = np.random.default_rng(5)
    difference = rng.normal(size=6)
    others = covariance(rng)
    samples = covariance(rng)
    if damage == "difference":
        difference[2] = np.nan
    elif damage == "others":
        others[0, 0] = np.nan
    else:
        others = others - 2.0 * np.trace(others) * np.eye(6)
    unknown = innovation_of(difference, others, samples)
    assert unknown.squared_distance(1.0) == np.inf
    known = InertialInnovation(whitened_sq=np.full(6, MEDIAN_SQUARED / 6.0), noise=np.zeros(6))
    assert median_excess([unknown, known, known], 1.0) == pytest.approx(1.0)


def test_window_finds_that_the_samples_are_noisier_than_their_data_sheet() -> None:
    """Three times the standard deviation: the median factor of 8 drives is 9 within factor 1.6."""
    told = replace(
        CALIBRATION,
        gyro_noise_rad_s_sqrt_hz=CALIBRATION.gyro_noise_rad_s_sqrt_hz / 3.0,
        accel_noise_m_s2_sqrt_hz=CALIBRATION.accel_noise_m_s2_sqrt_hz / 3.0,
    )
    factors = []
    for seed in range(8):
        rng = np.random.default_rng([71, seed])
        path = SmoothPath.drawn(rng)
        frames, _ = inertial_drive(rng, 36, path, points=60)
        config = {
            "estimator": "window",
            "self_calibration": False,
            "window": {"correlation": 0.0, "frames": 8},
        }
        noise = StudentT(dof=np.inf, scale=0.3**2 * np.eye(4))
        odometry = StereoOdometry(CAMERA, noise, told, config)
        for frame in frames:
            odometry.step(frame)
        factor = Inertial.of(odometry.window).noise_factor_in_use
        assert factor is not None
        factors.append(factor)
    assert 9.0 / 1.6 < np.median(factors) < 9.0 * 1.6
