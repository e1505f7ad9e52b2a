"""The acceleration and the vibration of the camera (PROBE IV-C.1)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.predictors.base import Needs, Predictor
from probevo.sequences.frame import ImuSamples
from probevo.sequences.imu_calibration import GRAVITY_M_S2


def acceleration(imu: ImuSamples) -> FloatArray:
    """Compute |‖f̄‖ − g| and the root mean square of ‖f − f̄‖ of the finite specific forces f.

    PROBE has the magnitude of the specific force. The direction of gravity is not known here, so
    that gravity can only be subtracted from the magnitude of the mean force f̄. Vertical
    acceleration, such as a bump, shows in full; horizontal acceleration a hardly shows, since
    √(g² + a²) − g ≈ a²/2g. The accelerometer's bias stays in it.

    The second number measures vibration and jerk along any axis. Subtracting the mean removes
    gravity and bias, except for the change of gravity's direction in the frame of the IMU: about
    0.03 m/s² for each 0.1 rad/s in a step of 0.1 s.

    Args:
        imu: samples of the interval, with an accelerometer.

    Returns:
        Acceleration and vibration, [2], m/s², the same for all features of a step, from the samples
        that are finite on all three axes. NaN where there is none.
    """
    # A sample that is not finite is a missing one
    is_finite = np.isfinite(imu.accel_m_s2).all(axis=1)
    if not is_finite.any():
        return np.full(2, np.nan)
    force = imu.accel_m_s2[is_finite]
    mean = force.mean(axis=0)
    # The direction of gravity is unknown: compare magnitudes
    offset = abs(float(np.linalg.norm(mean)) - GRAVITY_M_S2)
    # Subtracting the mean removes gravity and bias
    squared = np.sum((force - mean) ** 2, axis=1)
    return np.array([offset, np.sqrt(squared.mean())])


ACCELERATION = Predictor(
    name="acceleration",
    columns={"acceleration": "m/s²", "vibration": "m/s²"},
    source="PROBE IV-C.1",
    needs=Needs.ACCELEROMETER,
    compute=lambda step: step.for_all_features(acceleration(step.imu)),
    undefined="where the IMU has no finite sample",
)
