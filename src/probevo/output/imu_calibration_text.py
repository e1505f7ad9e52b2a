"""What images have shown of the errors of an IMU's calibration, in words."""

from __future__ import annotations

import math

from probevo.measurements.imu_calibration_errors import EstimatedError, ImuCalibrationErrors

SIGNIFICANT = 3.0
"""Standard deviations from which on an error is worth a word."""
UNUSUAL = 2.0
"""Prior standard deviations from which on an error is worth a warning: one that is usual is what
the window expects, and takes into account."""


def imu_calibration_text(found: ImuCalibrationErrors) -> str:
    """Describe the errors that differ from zero significantly."""
    shown = _texts(found, prior_sigmas=0.0)
    if not shown:
        return "as given, as far as the images show it"
    return f"{'; '.join(shown)}; this is taken into account"


def imu_calibration_warning(found: ImuCalibrationErrors | None) -> str | None:
    """Warn of errors that are larger than usual; else None."""
    shown = [] if found is None else _texts(found, prior_sigmas=UNUSUAL)
    if not shown:
        return None
    return (
        f"The IMU differs from its calibration, as the images show: {'; '.join(shown)}. This is"
        " taken into account; correct the calibration nevertheless, so that the IMU helps from the"
        " start. `probevo calibrate-check SEQUENCE` tests it."
    )


def _texts(found: ImuCalibrationErrors, *, prior_sigmas: float) -> list[str]:
    """Return a text for each error that is significant, and at least so large."""
    late = "late" if found.delay_s.value > 0.0 else "early"
    mounting_deg = _with_sigma(found.mounting_rad, unit=math.radians(1.0))
    delay_ms = _with_sigma(found.delay_s, unit=1e-3)
    position_cm = _with_sigma(found.position_m, unit=1e-2)
    texts = (
        (found.mounting_rad, f"its mounting is off by {mounting_deg}°"),
        (found.delay_s, f"its stamps are {late} by {delay_ms} ms"),
        (found.gyro_scale, _scale_text("gyro", found.gyro_scale)),
        (found.accelerometer_scale, _scale_text("accelerometer", found.accelerometer_scale)),
        (found.position_m, f"its position is off by {position_cm} cm"),
    )
    return [text for error, text in texts if error.exceeds(SIGNIFICANT, prior_sigmas)]


def _scale_text(sensor: str, error: EstimatedError) -> str:
    direction = "too little" if error.value > 0.0 else "too much"
    return f"its {sensor} measures {_with_sigma(error, unit=1e-2)} % {direction}"


def _with_sigma(error: EstimatedError, *, unit: float) -> str:
    """Return the size of an error in a unit, with its standard deviation."""
    sigma = error.sigma / unit
    digits = 1 if sigma >= 0.1 else 2
    return f"{abs(error.value) / unit:.{digits}f} ± {sigma:.{digits}f}"
