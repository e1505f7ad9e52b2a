"""The simulated IMU: what it measures at the left camera on a drive."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.sequences.frame import ImuSamples
from probevo_sim.scene.config import RigConfig
from probevo_sim.scene.drive import C_BODY_CAM, Trajectory

C_CAM_IMU: FloatArray = C_BODY_CAM.T
"""Rotation from the IMU (x forward, y left, z up) to the camera (x right, y down, z forward)."""


def simulate_imu(
    trajectory: Trajectory, stamps_ns: IntArray, rig: RigConfig, rng: np.random.Generator
) -> ImuSamples:
    """Sample the true angular rate and specific force, with white noise and a random-walk bias.

    White noise of density σ has the standard deviation σ / √Δt in samples Δt apart; a random walk
    of density σ moves by σ √Δt between them.

    Args:
        trajectory: the motion; its time 0 is the first frame.
        stamps_ns: stamps of the frames, [K], ascending; the first and last lie within the drive.
        rig: rate and noise of the IMU.
        rng: source of the noise.

    Returns:
        J samples in the IMU's axes, half a period off the first frame: from the last but one before
        the frames to the second one after them.
    """
    # Times relative to the first frame, which are small and so exact as floating-point numbers.
    period_ns = round(1e9 / rig.imu_rate_hz)
    first_ns = -period_ns - period_ns // 2
    count = -((first_ns - int(stamps_ns[-1] - stamps_ns[0])) // period_ns) + 2
    sample_ns = first_ns + period_ns * np.arange(count)
    t_s = 1e-9 * sample_ns
    period_s = 1e-9 * period_ns

    gyro = trajectory.angular_rate(t_s) @ C_CAM_IMU
    gyro += _white_noise(count, rig.gyro_noise_rad_s_sqrt_hz, period_s, rng=rng)
    gyro += _random_walk_bias(
        count,
        rig.gyro_bias_sigma_rad_s,
        rig.gyro_bias_walk_rad_s2_sqrt_hz,
        period_s=period_s,
        rng=rng,
    )
    accel = trajectory.specific_force(t_s) @ C_CAM_IMU
    accel += _white_noise(count, rig.accel_noise_m_s2_sqrt_hz, period_s, rng=rng)
    accel += _random_walk_bias(
        count,
        rig.accel_bias_sigma_m_s2,
        rig.accel_bias_walk_m_s3_sqrt_hz,
        period_s=period_s,
        rng=rng,
    )
    return ImuSamples(stamps_ns[0] + sample_ns, gyro_rad_s=gyro, accel_m_s2=accel)


def _white_noise(
    count: int, density: float, period_s: float, rng: np.random.Generator
) -> FloatArray:
    """Return white noise of a density at samples ``period_s`` apart, [count, 3]."""
    return rng.normal(scale=density / np.sqrt(period_s), size=(count, 3))


def _random_walk_bias(
    count: int, sigma: float, walk: float, period_s: float, rng: np.random.Generator
) -> FloatArray:
    """Return a random walk that starts with standard deviation ``sigma``, [count, 3]."""
    steps = rng.normal(size=(count, 3))
    steps[0] *= sigma
    steps[1:] *= walk * np.sqrt(period_s)
    return np.cumsum(steps, axis=0)
