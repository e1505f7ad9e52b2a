"""What a run says of the errors of an IMU's calibration."""

import numpy as np

from probevo.measurements.imu_calibration_errors import ImuCalibrationErrors
from probevo.output.imu_calibration_text import imu_calibration_text, imu_calibration_warning

PRIOR = np.array([0.02, 0.02, 0.02, 0.006, 0.02, 0.02, 0.05, 0.05, 0.05])
SIGMA = np.array([0.001, 0.001, 0.001, 0.0003, 0.002, 0.002, 0.01, 0.01, 0.01])


def found(errors: dict[int, float]) -> ImuCalibrationErrors:
    values = np.zeros(9)
    values[list(errors)] = list(errors.values())
    return ImuCalibrationErrors(values, SIGMA, PRIOR)


def test_what_is_not_significant_is_not_said() -> None:
    small = found({0: 0.002, 3: -0.0008, 5: 0.004})
    assert imu_calibration_text(small) == "as given, as far as the images show it"
    assert imu_calibration_warning(small) is None
    assert imu_calibration_warning(None) is None


def test_what_is_usual_is_said_and_not_warned_of() -> None:
    usual = found({3: 0.004, 5: -0.015})
    text = imu_calibration_text(usual)
    assert "its stamps are late by 4.0 ± 0.3 ms" in text
    assert "its accelerometer measures 1.5 ± 0.2 % too much" in text
    assert imu_calibration_warning(usual) is None


def test_what_is_unusual_is_warned_of() -> None:
    unusual = found({0: 0.03, 1: 0.04, 3: -0.02, 5: -0.015, 7: 0.3})
    warning = imu_calibration_warning(unusual)
    assert warning is not None
    assert "its mounting is off by 2.86 ± 0.06°" in warning
    assert "its stamps are early by 20.0 ± 0.3 ms" in warning
    assert "its position is off by 30.0 ± 1.0 cm" in warning
    assert "accelerometer" not in warning
