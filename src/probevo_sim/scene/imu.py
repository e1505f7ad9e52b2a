"""What an IMU at the left camera measures on a simulated drive."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo_sim.scene.config import RigConfig
from probevo_sim.scene.drive import C_BODY_CAM, Trajectory

C_CAM_IMU: FloatArray = C_BODY_CAM.T
"""Takes the IMU's axes (x forward, y left, z up) to the camera's (x right, y down, z forward)."""


def simulate_imu(
    trajectory: Trajectory, stamps_ns: IntArray, rig: RigConfig, rng: np.random.Generator
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Samples at the IMU's rate: the true rate and specific force, plus white noise, plus a bias
    that walks randomly.

    A white noise of density σ has the standard deviation σ / √Δt in samples Δt apart, and a walk of
    density σ moves by σ √Δt between them.

    Args:
        trajectory: whose time 0 is the first frame.
        stamps_ns: of the frames, [K], ascending; the first and last lie within the drive.
        rig: rate and noise of the IMU.
        rng: source of the noise.

    Returns:
        stamps [J], ns, half a period off the first frame, from the last but one before the frames
        to the second one after them; gyro [J, 3], rad/s, and accelerometer [J, 3], m/s², in the
        IMU's axes.
    """
    period_ns = round(1e9 / rig.imu_rate_hz)
    first_ns = (
        -period_ns - period_ns // 2
    )  # from here on relative to the first frame: small, so exact as floats
    count = -((first_ns - int(stamps_ns[-1] - stamps_ns[0])) // period_ns) + 2
    sample_ns = first_ns + period_ns * np.arange(count)
    t_s = 1e-9 * sample_ns
    period_s = 1e-9 * period_ns
    gyro = trajectory.angular_rate(t_s) @ C_CAM_IMU
    gyro += _white_noise(count, rig.gyro_noise_rad_s_sqrt_hz, period_s, rng=rng)
    gyro += _walking_bias(
        count,
        rig.gyro_bias_sigma_rad_s,
        rig.gyro_bias_walk_rad_s2_sqrt_hz,
        period_s=period_s,
        rng=rng,
    )
    accel = trajectory.specific_force(t_s) @ C_CAM_IMU
    accel += _white_noise(count, rig.accel_noise_m_s2_sqrt_hz, period_s, rng=rng)
    accel += _walking_bias(
        count,
        rig.accel_bias_sigma_m_s2,
        rig.accel_bias_walk_m_s3_sqrt_hz,
        period_s=period_s,
        rng=rng,
    )
    return stamps_ns[0] + sample_ns, gyro, accel


def _white_noise(
    count: int, density: float, period_s: float, rng: np.random.Generator
) -> FloatArray:
    return rng.normal(scale=density / np.sqrt(period_s), size=(count, 3))


def _walking_bias(
    count: int, sigma: float, walk: float, period_s: float, rng: np.random.Generator
) -> FloatArray:
    steps = rng.normal(size=(count, 3))
    steps[0] *= sigma
    steps[1:] *= walk * np.sqrt(period_s)
    return np.cumsum(steps, axis=0)
