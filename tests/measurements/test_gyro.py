"""The gyro's rotation: convention, closed forms, convergence, noise; its estimated bias."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import chi2

from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.measurements.gyro import (
    GyroBias,
    GyroRotation,
    covers,
    integrate_gyro,
    period_after,
)
from probevo.sequences.frame import ImuSamples
from probevo.sequences.imu import hold_over_interval
from probevo.sequences.imu_calibration import ImuCalibration

C_CAM_IMU = so3.exp(np.array([0.3, -1.7, 0.9]))
T_CAM_IMU = se3.from_parts(C_CAM_IMU, np.array([0.2, -0.1, 0.3]))
CALIBRATION = ImuCalibration(T_CAM_IMU, 2e-3, 0.02, gyro_bias_walk_rad_s2_sqrt_hz=1e-3)
START_NS = 1_700_000_000_013_000_000
END_NS = 1_700_000_000_113_000_000


def samples(rate: Callable[[FloatArray], FloatArray], period_ns: int = 10_000_000) -> ImuSamples:
    """``rate`` of time since START_NS, [J] s to [J, 3] rad/s, sampled across the interval but not
    at its ends."""
    stamps_ns = np.arange(START_NS - period_ns // 3, END_NS + period_ns, period_ns)
    rates = rate(1e-9 * (stamps_ns - START_NS))
    return ImuSamples(stamps_ns, rates, np.full_like(rates, np.nan))


def rotation_error_rad(C_1: FloatArray, C_2: FloatArray) -> float:
    return float(np.linalg.norm(so3.log(C_1 @ C_2.T)))


def steady(rate_rad_s: FloatArray) -> Callable[[FloatArray], FloatArray]:
    return lambda time_s: np.broadcast_to(rate_rad_s, (len(time_s), 3)).copy()


def test_constant_rate_has_the_closed_form() -> None:
    """C_curr_prev = Exp(−C_cam_imu ω T), whatever the phase of the samples."""
    rate = np.array([0.5, -2.0, 8.0])
    gyro = integrate_gyro(samples(steady(rate)), START_NS, END_NS, calibration=CALIBRATION)
    np.testing.assert_allclose(gyro.C_curr_prev, so3.exp(-C_CAM_IMU @ rate * 0.1), atol=1e-14)
    assert gyro.duration_s == pytest.approx(0.1, rel=1e-12)


def test_points_move_against_the_turn() -> None:
    """A camera that yaws to its right (about +y, down) sees a point ahead move to its left."""
    calibration = ImuCalibration(np.eye(4), 0.0, 0.0)
    gyro = integrate_gyro(
        samples(steady(np.array([0.0, 1.0, 0.0]))), START_NS, END_NS, calibration=calibration
    )
    np.testing.assert_allclose(
        gyro.C_curr_prev @ [0.0, 0.0, 1.0], [-np.sin(0.1), 0.0, np.cos(0.1)], atol=1e-14
    )


def test_rate_is_interpolated_linearly_to_the_ends() -> None:
    """∫ of a ramp about one axis is exact, though no sample lies at either end."""
    axis = np.array([0.6, 0.0, 0.8])
    gyro = integrate_gyro(
        samples(lambda t: (1.0 + 30.0 * t)[:, None] * axis),
        START_NS,
        END_NS,
        calibration=CALIBRATION,
    )
    np.testing.assert_allclose(
        gyro.C_curr_prev, so3.exp(-C_CAM_IMU @ axis * (0.1 + 15.0 * 0.01)), atol=1e-13
    )


def test_held_packets_turn_by_their_own_rate_over_their_own_interval() -> None:
    """Pairs of samples 1 ns apart make a step: packets of 10 ms, the first cut to 4 ms and the last
    to 7 ms."""
    packet_ends_ns = START_NS + 1_000_000 * np.array([-6, 4, 14, 24])
    rates = np.random.default_rng(0).normal(size=(4, 3))
    stamps_ns, held = hold_over_interval(packet_ends_ns, rates)
    imu = ImuSamples(stamps_ns, held, np.full_like(held, np.nan))
    gyro = integrate_gyro(imu, START_NS, START_NS + 21_000_000, calibration=CALIBRATION)
    first, second, third = so3.exp(-rates[1:] @ C_CAM_IMU.T * np.array([[4e-3], [10e-3], [7e-3]]))
    np.testing.assert_allclose(gyro.C_curr_prev, third @ second @ first, atol=1e-8)


def coning(
    time_s: FloatArray, angle_rad: float = 0.3, frequency_rad_s: float = 40.0
) -> tuple[FloatArray, FloatArray]:
    """A cone: C_world_imu = Exp(θ (cos Ωt, sin Ωt, 0)), [J, 3, 3], and its exact body rate, [J, 3]
    rad/s."""
    phase = frequency_rad_s * time_s
    zero = np.zeros_like(phase)
    phi = angle_rad * np.stack([np.cos(phase), np.sin(phase), zero], axis=1)
    phi_dot = angle_rad * frequency_rad_s * np.stack([-np.sin(phase), np.cos(phase), zero], axis=1)
    return so3.exp(phi), (so3.left_jacobian(-phi) @ phi_dot[..., None])[..., 0]


def test_coning_converges_with_the_square_of_the_period() -> None:
    """Simulated attitude fixes the sign: C_curr_prev = C_cam_imu C_world_currᵀ C_world_prev
    C_cam_imuᵀ."""
    C_prev, C_curr = coning(np.array([0.0, 1e-9 * (END_NS - START_NS)]))[0]
    truth = C_CAM_IMU @ C_curr.T @ C_prev @ C_CAM_IMU.T
    errors = []
    for period_ns in (4_000_000, 2_000_000, 1_000_000):
        imu = samples(lambda t: coning(t)[1], period_ns)
        errors.append(
            rotation_error_rad(
                integrate_gyro(imu, START_NS, END_NS, calibration=CALIBRATION).C_curr_prev, truth
            )
        )
    assert errors[-1] < 2e-4
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 4.0, rtol=0.15)


def test_interval_of_no_length_is_no_rotation() -> None:
    gyro = integrate_gyro(samples(steady(np.ones(3))), START_NS, START_NS, calibration=CALIBRATION)
    np.testing.assert_array_equal(gyro.C_curr_prev, np.eye(3))
    bias = GyroBias.initial(CALIBRATION)
    updated = bias.updated_by_joint_solve(gyro, gyro.C_curr_prev, np.zeros((3, 3)))
    np.testing.assert_array_equal(updated.mean, bias.mean)
    np.testing.assert_array_equal(updated.cov, bias.cov)


def test_bias_is_taken_off_every_rate() -> None:
    bias = np.array([0.1, 0.2, -0.3])
    shifted = integrate_gyro(
        samples(lambda t: coning(t)[1] + bias),
        START_NS,
        END_NS,
        calibration=CALIBRATION,
        bias_rad_s=bias,
    )
    plain = integrate_gyro(
        samples(lambda t: coning(t)[1]), START_NS, END_NS, calibration=CALIBRATION
    )
    np.testing.assert_allclose(shifted.C_curr_prev, plain.C_curr_prev, atol=1e-14)


def test_bias_jacobian_against_central_differences() -> None:
    imu = samples(lambda t: coning(t)[1])
    at = np.array([0.1, -0.2, 0.05])
    step = 1e-4
    gyro = integrate_gyro(imu, START_NS, END_NS, calibration=CALIBRATION, bias_rad_s=at)
    columns = []
    for axis in np.eye(3):
        plus, minus = (
            integrate_gyro(
                imu, START_NS, END_NS, calibration=CALIBRATION, bias_rad_s=at + s * step * axis
            )
            for s in (1, -1)
        )
        columns.append(so3.log(plus.C_curr_prev @ minus.C_curr_prev.T) / (2 * step))
    numeric = np.stack(columns, axis=1)
    assert np.linalg.norm(gyro.bias_jacobian - numeric) < 1e-6 * np.linalg.norm(numeric)


def test_covariance_is_that_of_white_noise() -> None:
    """Noise of density σ on fast samples turns the rotation by σ √T about every axis: 2,000 draws,
    5 % of scatter."""
    rng = np.random.default_rng(0)
    density = 0.05
    period_ns = 1_000_000
    calibration = ImuCalibration(T_CAM_IMU, density, 0.0)
    clean = samples(lambda t: coning(t)[1], period_ns)
    gyro = integrate_gyro(clean, START_NS, END_NS, calibration=calibration)
    draws = []
    for noise in rng.normal(
        scale=density / np.sqrt(1e-9 * period_ns), size=(2000, *clean.gyro_rad_s.shape)
    ):
        noisy = ImuSamples(clean.stamps_ns, clean.gyro_rad_s + noise, clean.accel_m_s2)
        draws.append(integrate_gyro(noisy, START_NS, END_NS, calibration=calibration).C_curr_prev)
    cov = np.cov(so3.log(np.array(draws) @ gyro.C_curr_prev.T), rowvar=False)
    np.testing.assert_allclose(cov, gyro.cov, atol=0.12 * gyro.cov[0, 0])
    np.testing.assert_allclose(np.trace(cov), np.trace(gyro.cov), rtol=0.06)
    np.testing.assert_allclose(np.diag(gyro.cov), density**2 * 0.1, rtol=0.01)


def test_sensitivity_to_the_bias_is_a_root_of_its_part_of_the_prior() -> None:
    """Also where one axis of the bias is known exactly."""
    gyro = integrate_gyro(
        samples(lambda t: coning(t)[1]), START_NS, END_NS, calibration=CALIBRATION
    )
    for cov in (random_covariance(np.random.default_rng(0), 0.1), np.diag([1e-4, 0.0, 4e-4])):
        bias = GyroBias(np.zeros(3), cov)
        root = bias.sensitivity(gyro)
        np.testing.assert_allclose(root @ root.T, bias.rotation_cov(gyro) - gyro.cov, atol=1e-12)


def random_covariance(rng: np.random.Generator, sigma: float) -> FloatArray:
    factor = rng.normal(size=(3, 3))
    return sigma**2 * (factor @ factor.T + 0.1 * np.eye(3))


def test_updated_bias_is_that_of_joint_least_squares() -> None:
    """Rotation r and bias b at once from prior, gyro and vision: the same marginals, for 100 random
    problems."""
    rng = np.random.default_rng(0)
    for _ in range(100):
        J = 0.1 * rng.normal(size=(3, 3))
        z = 1e-8 * rng.normal(size=3)
        P = random_covariance(rng, 1e-2)
        Q = random_covariance(rng, 1e-3)
        V = random_covariance(rng, 1e-3)
        # Unknowns [b; r]: b ~ N(0, P), r − J b ~ N(0, Q), r ~ N(z, V).
        rows = np.block(
            [[np.eye(3), np.zeros((3, 3))], [-J, np.eye(3)], [np.zeros((3, 3)), np.eye(3)]]
        )
        weights = np.zeros((9, 9))
        for block, cov in enumerate((P, Q, V)):
            weights[3 * block : 3 * block + 3, 3 * block : 3 * block + 3] = np.linalg.inv(cov)
        joint_cov = np.linalg.inv(rows.T @ weights @ rows)
        joint = joint_cov @ rows.T @ weights @ np.concatenate([np.zeros(6), z])

        gyro = GyroRotation(C_CAM_IMU, Q, J, duration_s=0.1)
        solved = so3.exp(joint[3:]) @ C_CAM_IMU
        bias = GyroBias(np.full(3, 0.01), P).updated_by_joint_solve(gyro, solved, joint_cov[3:, 3:])
        np.testing.assert_allclose(bias.mean - 0.01, joint[:3], atol=1e-12)
        np.testing.assert_allclose(bias.cov, joint_cov[:3, :3], rtol=1e-8, atol=1e-12)


def test_solve_without_new_information_leaves_the_bias() -> None:
    bias = GyroBias.initial(CALIBRATION)
    gyro = integrate_gyro(
        samples(lambda t: coning(t)[1]), START_NS, END_NS, calibration=CALIBRATION
    )
    same = bias.updated_by_joint_solve(gyro, gyro.C_curr_prev, bias.rotation_cov(gyro))
    np.testing.assert_array_equal(same.mean, bias.mean)
    np.testing.assert_allclose(same.cov, bias.cov, atol=1e-18)


def filtered_bias_nees(rng: np.random.Generator, num_steps: int) -> float:
    """Squared error of the bias in units of its covariance, after a run with a drifting bias and
    noisy vision."""
    bias = GyroBias.initial(CALIBRATION)
    true_bias = rng.normal(scale=CALIBRATION.gyro_bias_sigma_rad_s, size=3)
    cov_vision = np.diag([1e-4, 2e-4, 3e-4]) ** 2
    clean = samples(lambda t: coning(t)[1])
    true_rotation = integrate_gyro(clean, START_NS, END_NS, calibration=CALIBRATION).C_curr_prev
    for _ in range(num_steps):
        true_bias = true_bias + rng.normal(
            scale=CALIBRATION.gyro_bias_walk_rad_s2_sqrt_hz * np.sqrt(0.1), size=3
        )
        bias = bias.predicted(0.1, CALIBRATION)
        noise = rng.normal(
            scale=CALIBRATION.gyro_noise_rad_s_sqrt_hz / 0.1, size=clean.gyro_rad_s.shape
        )
        measured = clean.gyro_rad_s + true_bias + noise
        gyro = integrate_gyro(
            ImuSamples(clean.stamps_ns, measured, clean.accel_m_s2),
            START_NS,
            END_NS,
            calibration=CALIBRATION,
            bias_rad_s=bias.mean,
        )
        vision = so3.exp(rng.multivariate_normal(np.zeros(3), cov_vision)) @ true_rotation
        # The product of two Gaussians on the rotation stands in for the reprojection solve.
        cov_solved = np.linalg.inv(
            np.linalg.inv(bias.rotation_cov(gyro)) + np.linalg.inv(cov_vision)
        )
        pull = cov_solved @ np.linalg.solve(cov_vision, so3.log(vision @ gyro.C_curr_prev.T))
        bias = bias.updated_by_joint_solve(gyro, so3.exp(pull) @ gyro.C_curr_prev, cov_solved)
    error = true_bias - bias.mean
    return float(error @ np.linalg.solve(bias.cov, error))


def test_filtered_bias_is_consistent() -> None:
    """ANEES of 150 runs of 20 frames lies in the 99 % interval of χ²(3)."""
    rng = np.random.default_rng(0)
    nees = [filtered_bias_nees(rng, 20) for _ in range(150)]
    low, high = np.asarray(chi2.ppf([0.005, 0.995], df=3 * 150)) / 150
    assert low < np.mean(nees) < high


@pytest.mark.parametrize(
    ("first_ns", "last_ns", "enough"),
    [
        (0, 100, True),
        (-5, 104, True),
        (20, 100, True),
        (10, 90, True),
        (40, 100, False),
        (0, 60, False),
    ],
)
def test_samples_cover_an_interval_but_for_a_little_at_its_ends(
    first_ns: int, last_ns: int, enough: bool
) -> None:
    stamps_ns = np.linspace(first_ns, last_ns, 5).astype(np.int64)
    imu = ImuSamples(stamps_ns, np.zeros((5, 3)), np.full((5, 3), np.nan))
    assert covers(imu, 0, 100) is enough


def test_samples_with_a_hole_do_not_cover_an_interval() -> None:
    """As of a frame that was left out with its samples; those that are held over their intervals
    lie apart, too."""
    for stamps_ns, enough in (
        ([0, 10, 90, 100], False),
        ([0, 10, 20, 45, 55, 75, 100], True),
        ([0, 99, 100], True),
    ):
        zero = np.zeros((len(stamps_ns), 3))
        assert covers(ImuSamples(np.array(stamps_ns), zero, zero), 0, 100) is enough


def test_the_samples_that_a_dropout_has_left_do_not_cover_it() -> None:
    """At their usual distance of 5 ns, no more than three of 20 are missing; the two around a
    dropout would be as far apart as usual if nothing else were known."""
    for stamps_ns in ([-1000, 2000], [0, 5, 100], [0, 50, 100]):
        zero = np.zeros((len(stamps_ns), 3))
        samples = ImuSamples(np.array(stamps_ns), zero, zero)
        assert not covers(samples, 0, 100, usual_period_ns=5.0)
    zero = np.zeros((19, 3))
    dense = ImuSamples(np.r_[np.arange(0, 80, 5), 90, 95, 100], zero, zero)
    assert covers(dense, 0, 100, usual_period_ns=5.0)


def test_the_usual_period_outlasts_a_dropout_and_follows_another_rate() -> None:
    """From 200 to 20 Hz; the samples at 20 Hz cover their intervals again after ten frames."""
    zero = np.zeros((3, 3))
    usual_ns = 5e6
    dropout = ImuSamples(np.array([0, 500, 1000]) * 10**6, zero, zero)
    for _ in range(5):
        assert not covers(dropout, 0, 10**9, usual_ns)
        usual_ns = period_after(dropout, usual_ns) or 0.0
    slower = ImuSamples(np.array([0, 50, 100]) * 10**6, zero, zero)
    usual_ns = 5e6
    for _ in range(10):
        usual_ns = period_after(slower, usual_ns) or 0.0
    assert covers(slower, 0, 10**8, usual_ns)
    assert period_after(None, usual_ns) == usual_ns
    assert period_after(slower, None) == 50e6


def test_no_samples_cover_nothing() -> None:
    assert not covers(ImuSamples(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 3))), 0, 100)
