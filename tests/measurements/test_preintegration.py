"""Preintegration of an IMU: closed forms, Jacobians, covariance, and samples that are missing."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.measurements.imu_reason import ImuFault
from probevo.measurements.preintegration import (
    NUM_ERRORS,
    NoPreintegration,
    Preintegration,
    preintegrate,
)
from probevo.sequences.frame import ImuSamples
from probevo.sequences.imu_calibration import ImuCalibration

START_NS = 1_700_000_000_013_000_000
END_NS = START_NS + 100_000_000
PERIOD_NS = 5_000_000
C_CAM_IMU = so3.exp(np.array([0.3, -1.7, 0.9]))
CALIBRATION = ImuCalibration(
    se3.from_parts(C_CAM_IMU, np.array([0.2, -0.1, 0.3])),
    gyro_noise_rad_s_sqrt_hz=2e-3,
    gyro_bias_sigma_rad_s=0.02,
    gyro_bias_walk_rad_s2_sqrt_hz=1e-3,
    accel_noise_m_s2_sqrt_hz=2e-2,
    accel_bias_walk_m_s3_sqrt_hz=2e-3,
)

ACCEL_WALK = 3e-3
"""As in EuRoC's sensor.yaml, m/s³/√Hz."""
WALKING = replace(
    CALIBRATION,
    gyro_noise_rad_s_sqrt_hz=2e-4,
    gyro_bias_walk_rad_s2_sqrt_hz=1e-4,
    accel_noise_m_s2_sqrt_hz=2e-3,
    accel_bias_walk_m_s3_sqrt_hz=ACCEL_WALK,
)
"""Of an IMU whose walks exceed its white noise within seconds."""


def samples(rates: FloatArray, forces: FloatArray, period_ns: int = PERIOD_NS) -> ImuSamples:
    """Samples of the interval, from rates and forces along the camera's axes, [J, 3] or [3]."""
    stamps_ns = np.arange(START_NS, END_NS + 1, period_ns)
    shape = (len(stamps_ns), 3)
    gyro = np.broadcast_to(rates, shape) @ C_CAM_IMU
    return ImuSamples(stamps_ns, gyro, np.broadcast_to(forces, shape) @ C_CAM_IMU)


def random_samples(seed: int) -> ImuSamples:
    rng = np.random.default_rng(seed)
    count = (END_NS - START_NS) // PERIOD_NS + 1
    return samples(rng.normal(0.0, 1.0, (count, 3)), rng.normal(0.0, 5.0, (count, 3)))


def integrated(imu: ImuSamples, bias: FloatArray | None = None) -> Preintegration:
    found = preintegrate(
        imu, START_NS, END_NS, CALIBRATION, bias=np.zeros(6) if bias is None else bias
    )
    assert isinstance(found, Preintegration)
    return found


def difference(to: Preintegration, start: Preintegration) -> FloatArray:
    """Return (δφ, δv, δp) that leads from one result to another, [9]."""
    return np.concatenate(
        [
            so3.log(start.rotation.T @ to.rotation),
            to.velocity - start.velocity,
            to.position - start.position,
        ]
    )


def test_constant_force_without_turn_has_the_closed_form() -> None:
    force = np.array([0.5, -9.0, 2.0])
    found = integrated(samples(np.zeros(3), force))
    np.testing.assert_allclose(found.rotation, np.eye(3), atol=1e-15)
    np.testing.assert_allclose(found.velocity, 0.1 * force, rtol=1e-12)
    np.testing.assert_allclose(found.position, 0.005 * force, rtol=1e-12)
    assert found.duration_s == pytest.approx(0.1, rel=1e-12)
    np.testing.assert_array_equal(found.lever_m, [0.2, -0.1, 0.3])


def test_a_circle_has_the_closed_form_to_second_order_of_the_period() -> None:
    """Constant rate ω and force f: Δv = ∫ Exp(ωt) dt f; four times the samples, 1/16 the error."""
    rate = np.array([0.5, -2.0, 8.0])
    force = np.array([3.0, -1.0, 0.5])
    expected = 0.1 * so3.left_jacobian(0.1 * rate) @ force
    errors = []
    for period_ns in (20_000_000, 5_000_000):
        found = integrated(samples(rate, force, period_ns))
        np.testing.assert_allclose(found.rotation, so3.exp(0.1 * rate), atol=1e-13)
        errors.append(np.linalg.norm(found.velocity - expected))
    assert errors[0] / errors[1] == pytest.approx(16.0, rel=0.05)


def test_bias_jacobians_are_central_differences() -> None:
    imu = random_samples(0)
    bias = np.array([0.1, -0.2, 0.05, 0.3, -0.1, 0.2])
    here = integrated(imu, bias)
    for column, step in enumerate(1e-6 * np.eye(6)):
        ahead = difference(integrated(imu, bias + step), here)
        behind = difference(integrated(imu, bias - step), here)
        numeric = (ahead - behind) / 2e-6
        np.testing.assert_allclose(here.bias_jacobian[:, column], numeric, atol=1e-8)


def test_jacobians_of_calibration_errors_are_central_differences() -> None:
    """Of mounting, delay and both scales, in the order of the columns; samples are given 1/1000 s
    apart, so that those next to the ends are those at the ends."""
    stamps_ns = np.arange(START_NS - PERIOD_NS, END_NS + PERIOD_NS + 1, 1_000_000)

    def wrong(errors: FloatArray) -> Preintegration:
        """Preintegrate what an IMU with these errors would have to be corrected to."""
        t_s = 1e-9 * (stamps_ns - START_NS).astype(np.float64) + errors[3]
        phase = t_s[:, None] * np.array([7.0, 11.0, 5.0]) + np.array([0.3, 1.0, 2.0])
        C = so3.exp(errors[:3])
        rates = (1.0 + errors[4]) * (1.5 * np.sin(phase)) @ C.T
        forces = (1.0 + errors[5]) * (4.0 * np.cos(phase) + np.array([0.5, -9.0, 2.0])) @ C.T
        return integrated(ImuSamples(stamps_ns, rates @ C_CAM_IMU, forces @ C_CAM_IMU))

    here = wrong(np.zeros(NUM_ERRORS))
    for column, step in enumerate(1e-4 * np.eye(NUM_ERRORS)):
        numeric = difference(wrong(step), wrong(-step)) / 2e-4
        np.testing.assert_allclose(here.error_jacobian[:, column], numeric, rtol=0.02, atol=0.01)


def test_covariance_is_that_of_noisy_samples() -> None:
    """The average of δᵀ Σ⁻¹ δ over noisy samples lies in the 99.9 % interval of χ²(9).

    Each sub-interval has a mean of its own, as a sample that integrates over it.
    """
    rng = np.random.default_rng(1)
    count = 600
    rate = np.array([0.5, -1.0, 2.0])
    force = np.array([1.0, -9.0, 2.0])
    clean = integrated(samples(rate, force, PERIOD_NS))
    squared = []
    for _ in range(count):
        gyro_sigma = CALIBRATION.gyro_noise_rad_s_sqrt_hz / np.sqrt(1e-9 * PERIOD_NS)
        accel_sigma = CALIBRATION.accel_noise_m_s2_sqrt_hz / np.sqrt(1e-9 * PERIOD_NS)
        steps = (END_NS - START_NS) // PERIOD_NS
        noisy = _held(
            rate + gyro_sigma * rng.normal(size=(steps, 3)),
            force + accel_sigma * rng.normal(size=(steps, 3)),
        )
        error = difference(integrated(noisy), clean)
        squared.append(error @ np.linalg.solve(clean.cov, error))
    low, high = chi2_interval(dof=9, count=count)
    assert low < np.mean(squared) < high


def _held(rates: FloatArray, forces: FloatArray) -> ImuSamples:
    """Samples whose linear interpolation has these means in successive sub-intervals."""
    edges_ns = np.arange(START_NS, END_NS + 1, PERIOD_NS)
    stamps_ns = np.stack([edges_ns[:-1] + 1, edges_ns[1:]], axis=1).ravel()
    gyro = np.repeat(rates, 2, axis=0) @ C_CAM_IMU
    return ImuSamples(stamps_ns, gyro, np.repeat(forces, 2, axis=0) @ C_CAM_IMU)


def test_covariance_of_a_single_sub_interval_is_that_of_white_noise() -> None:
    """The mean force does not tell where the position ends: with samples at both ends only, the
    variances of δv and δp are σ² t and σ² t³/3, and the covariance is regular."""
    ends = [0, -1]
    whole = samples(np.zeros(3), np.array([0.5, -9.0, 2.0]))
    found = preintegrate(
        ImuSamples(
            START_NS + np.array([0, 5_000_000]), whole.gyro_rad_s[ends], whole.accel_m_s2[ends]
        ),
        START_NS,
        START_NS + 5_000_000,
        CALIBRATION,
        bias=np.zeros(6),
    )
    assert isinstance(found, Preintegration)
    density = CALIBRATION.accel_noise_m_s2_sqrt_hz
    # The gyro's noise moves them by 1e-6 of that.
    np.testing.assert_allclose(np.diag(found.cov)[3:6], density**2 * 0.005, rtol=1e-2)
    np.testing.assert_allclose(np.diag(found.cov)[6:9], density**2 * 0.005**3 / 3.0, rtol=1e-2)
    sigma = np.sqrt(np.diag(found.cov))
    assert np.linalg.eigvalsh(found.cov / np.outer(sigma, sigma)).min() > 0.01


@pytest.mark.parametrize("duration_s", [1, 3, 10])
def test_covariance_is_that_of_biases_that_walk(duration_s: int) -> None:
    """The average of δᵀ Σ⁻¹ δ over 200 walks lies in the 99.9 % interval of χ²(9): with the biases
    at both ends known, and with that at the end free to walk. Across gaps of seconds the walk is
    most of it."""
    rng = np.random.default_rng(2)
    period_s = 0.02
    stamps_ns = START_NS + np.arange(round(duration_s / period_s) + 1) * 20_000_000
    angle = np.arange(len(stamps_ns))[:, None] * period_s + np.arange(3.0)
    still = ImuSamples(stamps_ns, 0.3 * np.cos(angle), np.array([0.0, -9.8, 0.0]) + np.sin(angle))

    def over_gap(imu: ImuSamples) -> Preintegration:
        found = preintegrate(imu, int(stamps_ns[0]), int(stamps_ns[-1]), WALKING)
        assert isinstance(found, Preintegration)
        return found

    def drawn(white: float, walk: float) -> tuple[FloatArray, FloatArray]:
        """Errors of the samples, [J, 3], and how far their bias walks, [3]."""
        steps = walk * np.sqrt(period_s) * rng.normal(size=(len(stamps_ns), 3))
        steps[0] = 0.0
        bias = np.cumsum(steps, axis=0)
        noise = white / np.sqrt(period_s) * rng.normal(size=bias.shape)
        return bias + noise, C_CAM_IMU @ bias[-1]

    clean = over_gap(still)
    by_change = clean.bias_change_jacobian
    walks = np.repeat([WALKING.gyro_bias_walk_rad_s2_sqrt_hz, ACCEL_WALK], 3)
    free = clean.cov + (by_change * walks**2 * duration_s) @ by_change.T
    squared = []
    for _ in range(200):
        gyro, gyro_walked = drawn(
            WALKING.gyro_noise_rad_s_sqrt_hz, WALKING.gyro_bias_walk_rad_s2_sqrt_hz
        )
        accel, accel_walked = drawn(WALKING.accel_noise_m_s2_sqrt_hz, ACCEL_WALK)
        noisy = over_gap(ImuSamples(stamps_ns, still.gyro_rad_s + gyro, still.accel_m_s2 + accel))
        error = difference(clean, noisy)
        rest = error - by_change @ np.concatenate([gyro_walked, accel_walked])
        squared.append(
            [rest @ np.linalg.solve(clean.cov, rest), error @ np.linalg.solve(free, error)]
        )
    low, high = chi2_interval(dof=9, count=200)
    assert (np.mean(squared, axis=0) > low).all()
    assert (np.mean(squared, axis=0) < high).all()


@pytest.mark.parametrize("duration_s", [0.1, 5.0])
def test_what_walks_of_the_force_add_has_a_closed_form(duration_s: float) -> None:
    """Without a turn, a walk of density σ adds σ² T³/12 to δv and σ² T⁵/45 to δp, with the biases
    at both ends known, and their change counts for ½ T and T²/6."""
    stamps_ns = START_NS + np.arange(round(duration_s / 0.01) + 1) * 10_000_000
    still = np.zeros((len(stamps_ns), 3))
    found = []
    for walk in (ACCEL_WALK, 0.0):
        calibration = replace(WALKING, accel_bias_walk_m_s3_sqrt_hz=walk)
        imu = ImuSamples(stamps_ns, still, still)
        part = preintegrate(imu, int(stamps_ns[0]), int(stamps_ns[-1]), calibration)
        assert isinstance(part, Preintegration)
        found.append(part)
    added = np.diagonal(found[0].cov - found[1].cov)
    np.testing.assert_allclose(added[3:6], ACCEL_WALK**2 * duration_s**3 / 12.0, rtol=1e-3)
    np.testing.assert_allclose(added[6:], ACCEL_WALK**2 * duration_s**5 / 45.0, rtol=2e-2)
    by_force = -found[0].bias_change_jacobian[:, 3:]
    np.testing.assert_allclose(by_force[3:6], 0.5 * duration_s * np.eye(3), atol=1e-12)
    np.testing.assert_allclose(by_force[6:], duration_s**2 / 6.0 * np.eye(3), rtol=1e-2)


def test_covariance_grows_as_the_samples_average() -> None:
    """White noise of the rate turns by σ √T, whatever the sample period."""
    imu = samples(np.zeros(3), np.zeros(3))
    steady = replace(CALIBRATION, gyro_bias_walk_rad_s2_sqrt_hz=0.0)
    found = preintegrate(imu, START_NS, END_NS, steady)
    assert isinstance(found, Preintegration)
    expected = CALIBRATION.gyro_noise_rad_s_sqrt_hz * np.sqrt(0.1)
    np.testing.assert_allclose(np.sqrt(np.diag(found.cov)[:3]), expected, rtol=1e-12)


def test_samples_without_a_plausible_number_are_left_out() -> None:
    """What is left of a steady turn gives the same, but for the longer sub-interval."""
    imu = samples(np.array([0.1, 0.2, 0.3]), np.array([0.0, -9.8, 0.0]))
    whole = integrated(imu)
    for value in (np.nan, np.inf, 1e308):
        gyro = imu.gyro_rad_s.copy()
        gyro[7] = value
        force = imu.accel_m_s2.copy()
        force[12] = value
        found = integrated(replace(imu, gyro_rad_s=gyro, accel_m_s2=force))
        np.testing.assert_allclose(difference(found, whole), 0.0, atol=1e-6)


@pytest.mark.parametrize(
    ("rows", "fault", "text"),
    [
        (slice(0, 0), ImuFault.NO_SAMPLES, "no samples"),
        (slice(0, 1), ImuFault.SINGLE_SAMPLE, "a single usable sample"),
        (
            slice(0, 4),
            ImuFault.FEW_SAMPLES,
            "4 usable samples between two frames, and none for 85 ms",
        ),
        (slice(0, 12), ImuFault.HOLE, "no samples for 45 ms"),
        (np.r_[0:6, 12:21], ImuFault.HOLE, "no samples for 35 ms"),
    ],
)
def test_samples_that_do_not_cover_the_interval_give_a_reason(
    rows: slice | FloatArray, fault: ImuFault, text: str
) -> None:
    imu = samples(np.zeros(3), np.zeros(3))
    part = ImuSamples(imu.stamps_ns[rows], imu.gyro_rad_s[rows], imu.accel_m_s2[rows])
    found = preintegrate(part, START_NS, END_NS, CALIBRATION)
    assert isinstance(found, NoPreintegration)
    assert found.reason.fault is fault
    assert text in found.reason.text


@pytest.mark.parametrize(
    ("offset_s", "text"),
    [
        (-3.2, "has samples that end 3.1 s before the previous frame (are its stamps ns, on"),
        (5.25, "has samples that begin 5.15 s after the current frame (are its stamps ns, on"),
    ],
)
def test_samples_of_another_clock_are_said_to_be_so(offset_s: float, text: str) -> None:
    imu = samples(np.zeros(3), np.zeros(3))
    shifted = replace(imu, stamps_ns=imu.stamps_ns + round(1e9 * offset_s))
    found = preintegrate(shifted, START_NS, END_NS, CALIBRATION)
    assert isinstance(found, NoPreintegration)
    assert found.reason.fault is ImuFault.OUTSIDE_INTERVAL
    assert found.reason.text.startswith(text)


@pytest.mark.parametrize(
    ("frame_hz", "sample_hz", "covers"),
    [
        (75, 200, True),
        (100, 200, True),
        (200, 200, True),
        (200, 100, True),
        (60, 60, True),
        (60, 50, False),
        (30, 60, True),
        (20, 60, True),
        (20, 40, False),
        (10, 31, True),
        (10, 19, False),
        (10, 10, False),
    ],
)
def test_of_any_camera_close_samples_cover_all_intervals(
    frame_hz: int, sample_hz: int, covers: bool
) -> None:
    """Samples 1/60 s apart do, wherever in the interval they begin, be they two. Samples farther
    apart cover those intervals that have five of them."""
    found = []
    for offset in np.linspace(0.01, 1.0, 7):
        times_s = (np.arange(500.0) - offset) / sample_hz
        found += intervals_covered(times_s, frame_hz)
    assert all(found) if covers else not all(found)


@pytest.mark.parametrize(("frame_hz", "sample_hz"), [(30, 62.5), (60, 62.5), (20, 60), (30, 60)])
def test_stamps_that_jitter_cover_as_those_that_do_not(frame_hz: int, sample_hz: float) -> None:
    """By half a millisecond, as of an IMU that is read by a busy computer."""
    times_s = (np.arange(500) - 0.3) / sample_hz
    jitter_s = 5e-4 * np.random.default_rng(0).normal(size=len(times_s))
    assert all(intervals_covered(times_s + jitter_s, frame_hz))


def intervals_covered(times_s: FloatArray, frame_hz: int) -> list[bool]:
    """Return for two seconds of frames whether samples at these times, [J], cover each interval.

    Stamps are rounded to nanoseconds.
    """
    stamps_ns = np.round(1e9 * times_s).astype(np.int64)
    frames_ns = np.round(1e9 * np.arange(2 * frame_hz) / frame_hz).astype(np.int64)
    found = []
    for start_ns, end_ns in pairwise(frames_ns):
        first = np.searchsorted(stamps_ns, start_ns, side="right") - 1
        last = np.searchsorted(stamps_ns, end_ns, side="left")
        covering_ns = stamps_ns[max(first, 0) : last + 1]
        still = np.zeros((len(covering_ns), 3))
        imu = ImuSamples(START_NS + covering_ns, still, still)
        part = preintegrate(imu, START_NS + start_ns, START_NS + end_ns, CALIBRATION)
        found.append(isinstance(part, Preintegration))
    return found


def test_packets_that_are_held_over_intervals_count_once() -> None:
    """Three packets at the rate of the frames are six samples, but too few."""
    ends_ns = START_NS + np.array([-20_000_000, 50_000_000, 120_000_000])
    stamps_ns = np.stack([ends_ns - 70_000_000 + 1, ends_ns], axis=1).ravel()
    packets = ImuSamples(stamps_ns, np.zeros((6, 3)), np.zeros((6, 3)))
    found = preintegrate(packets, START_NS, END_NS, CALIBRATION)
    assert isinstance(found, NoPreintegration)
    assert found.reason.fault is ImuFault.FEW_SAMPLES


def test_no_accelerometer_is_a_reason() -> None:
    imu = samples(np.zeros(3), np.full(3, np.nan))
    found = preintegrate(imu, START_NS, END_NS, CALIBRATION)
    assert isinstance(found, NoPreintegration)
    assert found.reason.fault is ImuFault.NO_ACCELEROMETER


def test_an_imu_without_noise_has_a_covariance_with_an_inverse() -> None:
    """A simulated one may have densities of 0; a window that could not invert would leave it
    out."""
    perfect = replace(
        CALIBRATION,
        gyro_noise_rad_s_sqrt_hz=0.0,
        gyro_bias_walk_rad_s2_sqrt_hz=0.0,
        accel_noise_m_s2_sqrt_hz=0.0,
        accel_bias_walk_m_s3_sqrt_hz=0.0,
    )
    found = preintegrate(random_samples(5), START_NS, END_NS, perfect)
    assert isinstance(found, Preintegration)
    np.testing.assert_allclose(np.linalg.inv(found.cov) @ found.cov, np.eye(9), atol=1e-6)
    assert np.sqrt(np.diagonal(found.cov)).max() < 1e-6
