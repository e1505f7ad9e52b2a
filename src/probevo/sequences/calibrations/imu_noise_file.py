"""The noise of an IMU as Kalibr's ``imu.yaml`` and OpenVINS's ``kalibr_imu_chain.yaml`` have it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from probevo.errors import InputError
from probevo.sequences.calibrations.calibration_content import CalibrationContent, load_calibration
from probevo.sequences.imu_calibration import ImuCalibration

SECTION = "imu0"
"""Where Kalibr's results, and OpenVINS's files, have the keys; its inputs have them at the top."""


def with_noise_of(calibration: ImuCalibration | None, path: Path | None) -> ImuCalibration | None:
    """Return an IMU's calibration with the noise that a file gives.

    The file does not give the bias at power-up, which stays.

    Args:
        calibration: None without an IMU.
        path: the file; None to change nothing.

    Raises:
        InputError: there is a file but no IMU, a key is missing, or a figure is not positive.
    """
    if path is None:
        return calibration
    if calibration is None:
        what = "the recording has no IMU whose pose in the camera's frame is known."
        raise InputError(path, what, "Leave out --imu-noise, or give that pose.")
    content = load_calibration(path)
    if SECTION in content:
        content = content.inner(SECTION)
    return replace(
        calibration,
        gyro_noise_rad_s_sqrt_hz=_positive(content, "gyroscope_noise_density"),
        gyro_bias_walk_rad_s2_sqrt_hz=_positive(content, "gyroscope_random_walk"),
        accel_noise_m_s2_sqrt_hz=_positive(content, "accelerometer_noise_density"),
        accel_bias_walk_m_s3_sqrt_hz=_positive(content, "accelerometer_random_walk"),
    )


def _positive(content: CalibrationContent, key: str) -> float:
    """Return a positive number.

    Raises:
        InputError: there is no such key, or its value is none.
    """
    number = content.number(key)
    if number <= 0.0:
        raise InputError(content.where(key), f"is {number:g}.", "A noise density is positive.")
    return number
