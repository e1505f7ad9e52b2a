"""The simulated IMU against the true motion, and the size of its noise and bias."""

from functools import cache

import numpy as np
import pytest
from scipy.stats import chi2

from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.geometry import se3, so3
from probevo.measurements.gyro import integrate_gyro
from probevo.sequences.frame import ImuSamples
from probevo.sequences.imu_calibration import ImuCalibration
from probevo_sim.scene.config import RigConfig
from probevo_sim.scene.drive import DrivePlan, Trajectory
from probevo_sim.scene.imu import C_CAM_IMU, simulate_imu
from probevo_sim.scene.route import Route

START_NS = 1_700_000_000_000_000_000
ROAD = Route.from_turns([(30.0, 0.0), (25.0, 1.5), (30.0, -0.9), (100.0, 0.0)])
DRIVE = Trajectory.along(ROAD, DrivePlan(0.0, 150.0, 8.0, from_rest=True), np.random.default_rng(0))
STAMPS_NS = START_NS + 100_000_000 * np.arange(int(DRIVE.duration_s / 0.1))
QUIET = {
    "gyro_noise_rad_s_sqrt_hz": 1e-12,
    "gyro_bias_sigma_rad_s": 0.0,
    "gyro_bias_walk_rad_s2_sqrt_hz": 0.0,
    "accel_noise_m_s2_sqrt_hz": 1e-12,
    "accel_bias_sigma_m_s2": 0.0,
    "accel_bias_walk_m_s3_sqrt_hz": 0.0,
}


def simulated(seed: int = 0, **rig: float) -> ImuSamples:
    """Simulate an IMU without any noise except what is given."""
    return simulate_imu(
        DRIVE, STAMPS_NS, RigConfig(**{**QUIET, **rig}), rng=np.random.default_rng(seed)
    )


def gyro_errors(rig: RigConfig, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Return the error of the integrated gyro over each frame interval, [K, 3], rad, and its
    covariance, [K, 3, 3]."""
    imu = simulate_imu(DRIVE, STAMPS_NS, rig, rng=np.random.default_rng(seed))
    T_cam_imu = se3.from_parts(C_CAM_IMU, np.zeros(3))
    calibration = ImuCalibration(T_cam_imu, rig.gyro_noise_rad_s_sqrt_hz, 0.0)
    C_world_cam = DRIVE.T_world_cam(1e-9 * (STAMPS_NS - STAMPS_NS[0]))[:, :3, :3]
    errors = []
    covs = []
    for k in range(1, len(STAMPS_NS)):
        gyro = integrate_gyro(
            imu, int(STAMPS_NS[k - 1]), int(STAMPS_NS[k]), calibration=calibration
        )
        errors.append(so3.log(gyro.C_curr_prev @ C_world_cam[k - 1].T @ C_world_cam[k]))
        covs.append(gyro.cov)
    return np.array(errors), np.array(covs)


def test_dense_gyro_reproduces_the_rotation() -> None:
    errors, _ = gyro_errors(RigConfig(**{**QUIET, "imu_rate_hz": 5000.0}))
    assert np.abs(errors).max() < 1e-8


def test_gyro_at_its_rate_is_off_by_its_noise() -> None:
    """ANEES of the rotations of all frame intervals lies in the 99.9 % interval of χ²(3)."""
    rig = RigConfig(gyro_bias_sigma_rad_s=0.0, gyro_bias_walk_rad_s2_sqrt_hz=0.0)
    errors, covs = gyro_errors(rig)
    nees = np.einsum("ka,ka->k", errors, np.linalg.solve(covs, errors[..., None])[..., 0])
    low, high = chi2_interval(3, len(nees))
    assert low < np.mean(nees) < high


def test_specific_force_at_rest_points_upwards() -> None:
    """The drive starts with half a second at rest."""
    imu = simulated()
    at_rest = imu.stamps_ns < START_NS + 500_000_000
    gravity = np.broadcast_to([0.0, 0.0, 9.81], (at_rest.sum(), 3))
    np.testing.assert_allclose(imu.accel_m_s2[at_rest], gravity, atol=1e-5)
    np.testing.assert_allclose(imu.gyro_rad_s[at_rest], 0.0, atol=1e-5)


def test_speeding_up_is_forward_and_a_left_turn_pushes_left() -> None:
    imu = simulated()
    t_s = 1e-9 * (imu.stamps_ns - START_NS)
    assert imu.accel_m_s2[(t_s > 1.5) & (t_s < 3.0), 0].mean() > 1.0
    left = imu.gyro_rad_s[:, 2] > 0.15
    assert imu.accel_m_s2[left, 1].min() > 0.5


@pytest.mark.parametrize("rate_hz", [10.0, 100.0, 200.0, 333.0])
def test_samples_cover_the_frames_with_one_to_spare(rate_hz: float) -> None:
    imu = simulated(imu_rate_hz=rate_hz)
    assert imu.stamps_ns.dtype == np.int64
    assert imu.gyro_rad_s.shape == imu.accel_m_s2.shape == (len(imu.stamps_ns), 3)
    assert np.unique(np.diff(imu.stamps_ns)) == [round(1e9 / rate_hz)]
    assert np.sum(imu.stamps_ns <= STAMPS_NS[0]) == 2
    assert np.sum(imu.stamps_ns >= STAMPS_NS[-1]) == 2


@pytest.mark.parametrize(
    ("sensor", "density"),
    [
        ("gyro_rad_s", {"gyro_noise_rad_s_sqrt_hz": 0.02}),
        ("accel_m_s2", {"accel_noise_m_s2_sqrt_hz": 0.3}),
    ],
)
def test_white_noise_has_its_density(sensor: str, density: dict[str, float]) -> None:
    noise = getattr(simulated(**density), sensor) - getattr(simulated(), sensor)
    sigma = next(iter(density.values())) * np.sqrt(200.0)
    low, high = chi2.ppf([0.0005, 0.9995], df=noise.size) / noise.size
    assert low < np.mean((noise / sigma) ** 2) < high


@cache
def biased() -> list[ImuSamples]:
    """Simulate 200 times gyro and accelerometer with a bias of σ = 0.05 that walks by 0.01."""
    sigmas = {"gyro_bias_sigma_rad_s": 0.05, "accel_bias_sigma_m_s2": 0.05}
    walks = {"gyro_bias_walk_rad_s2_sqrt_hz": 0.01, "accel_bias_walk_m_s3_sqrt_hz": 0.01}
    return [simulated(seed, **sigmas, **walks) for seed in range(200)]


@pytest.mark.parametrize("sensor", ["gyro_rad_s", "accel_m_s2"])
def test_bias_has_its_initial_variance_and_random_walk(sensor: str) -> None:
    """Variance of the first bias and of the way from the first to the last one, over 200 drives."""
    truth = getattr(simulated(), sensor)
    bias = np.array([getattr(imu, sensor) - truth for imu in biased()])
    walked = (bias[:, -1] - bias[:, 0]) / (0.01 * np.sqrt((len(truth) - 1) / 200.0))
    low, high = chi2_interval(1, 600)
    assert low < np.mean((bias[:, 0] / 0.05) ** 2) < high
    assert low < np.mean(walked**2) < high


def test_same_seed_gives_the_same_bytes() -> None:
    rig = RigConfig()
    first, second = (
        simulate_imu(DRIVE, STAMPS_NS, rig, rng=np.random.default_rng(5)) for _ in range(2)
    )
    assert first.stamps_ns.tobytes() == second.stamps_ns.tobytes()
    assert first.gyro_rad_s.tobytes() == second.gyro_rad_s.tobytes()
    assert first.accel_m_s2.tobytes() == second.accel_m_s2.tobytes()
