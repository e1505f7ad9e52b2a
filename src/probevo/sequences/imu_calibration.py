"""Calibration of an IMU on a stereo rig: its pose, its noise, and the offset of its clock."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.geometry import se3

GRAVITY_M_S2 = 9.81
"""Length of gravity; by where on the earth it is, it differs by 0.03."""
ACCEL_NOISE_M_S2_SQRT_HZ = 3e-3
"""White noise of a consumer MEMS accelerometer. EuRoC's sensor.yaml gives 2.0e-3, TUM-VI's
calibration 2.8e-3."""
ACCEL_BIAS_SIGMA_M_S2 = 0.2
"""Bias of a MEMS accelerometer at power-up, 20 mg; no calibration file gives it."""
ACCEL_BIAS_WALK_M_S3_SQRT_HZ = 3e-3
"""Bias random walk as in EuRoC's sensor.yaml; TUM-VI's calibration gives 0.9e-3."""
DENSITIES = (
    "gyro_noise_rad_s_sqrt_hz",
    "gyro_bias_sigma_rad_s",
    "gyro_bias_walk_rad_s2_sqrt_hz",
    "accel_noise_m_s2_sqrt_hz",
    "accel_bias_sigma_m_s2",
    "accel_bias_walk_m_s3_sqrt_hz",
)
"""The noise figures among the fields."""
MAX_NOISE = 1e6
"""Largest noise figure, in any of their units; no sensor has it."""
MAX_OFFSET_S = 4e9
"""Largest time offset: from 1900 to now, and stamps in ns that are shifted by it fit in 64 bits."""


@dataclass(frozen=True)
class ImuCalibration:
    """The calibration of an IMU against the (rectified) left camera."""

    T_cam_imu: FloatArray
    """Pose of the IMU in the left camera's frame, p_cam = T_cam_imu p_imu, [4, 4], m."""
    gyro_noise_rad_s_sqrt_hz: float
    """White noise density of the gyro, rad/s/√Hz."""
    gyro_bias_sigma_rad_s: float
    """Standard deviation of the unknown constant gyro bias at the start, rad/s."""
    gyro_bias_walk_rad_s2_sqrt_hz: float = 0.0
    """Density of the random walk of the gyro bias, rad/s²/√Hz."""
    accel_noise_m_s2_sqrt_hz: float = ACCEL_NOISE_M_S2_SQRT_HZ
    """White noise density of the accelerometer, m/s²/√Hz."""
    accel_bias_sigma_m_s2: float = ACCEL_BIAS_SIGMA_M_S2
    """Standard deviation of the unknown constant accelerometer bias at the start, m/s²."""
    accel_bias_walk_m_s3_sqrt_hz: float = ACCEL_BIAS_WALK_M_S3_SQRT_HZ
    """Density of the random walk of the accelerometer bias, m/s³/√Hz."""
    time_offset_s: float = 0.0
    """Time of an event on the clock of the IMU minus its time on the clock of the images:
    t_imu = t_cam + time_offset_s, as Kalibr's ``timeshift_cam_imu``. The odometry does not apply
    it: the readers have, and the stamps of ``ImuSamples`` are on the clock of the images. For
    samples from elsewhere, ``on_image_clock`` does."""

    def __post_init__(self) -> None:
        """Refuse values that no IMU has.

        Raises:
            InputError: T_cam_imu is no rigid transform, a noise figure is negative or not finite,
                or the time offset is not finite.
        """
        if np.shape(self.T_cam_imu) == (3, 3):
            what = "has shape (3, 3), that of a rotation."
            cure = "Give the whole transform, [4, 4]: the rotation with the IMU's position."
            raise InputError("T_cam_imu", what, cure)
        se3.check_transform(self.T_cam_imu, "T_cam_imu")
        object.__setattr__(self, "T_cam_imu", np.asarray(self.T_cam_imu, np.float64))
        for name in DENSITIES:
            value = getattr(self, name)
            if not (_is_number(value) and 0.0 <= value <= MAX_NOISE):
                cure = f"It must be a finite number from 0 to {MAX_NOISE:g}."
                raise InputError(name, f"is {value}.", cure)
        if not (_is_number(self.time_offset_s) and abs(self.time_offset_s) <= MAX_OFFSET_S):
            what = f"is {self.time_offset_s}."
            cure = f"It must be a finite number of seconds, at most {MAX_OFFSET_S:g}."
            raise InputError("time_offset_s", what, cure)

    @property
    def C_cam_imu(self) -> FloatArray:
        """Rotation from IMU to left camera coordinates, [3, 3]."""
        return self.T_cam_imu[:3, :3]

    def on_image_clock(self, imu_stamps_ns: IntArray) -> IntArray:
        """Return IMU stamps, [J], ns, on the clock of the images: t_cam = t_imu − time_offset_s."""
        return imu_stamps_ns - round(1e9 * self.time_offset_s)


def _is_number(value: object) -> bool:
    """Return whether a value is a real number, of Python or of NumPy."""
    return isinstance(value, int | float | np.integer | np.floating)
