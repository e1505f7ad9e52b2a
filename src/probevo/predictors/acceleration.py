"""How hard the camera is shaken and accelerated (PROBE IV-C.1)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.sequences.frame import ImuSamples

GRAVITY_M_S2 = 9.81


def acceleration(imu: ImuSamples) -> FloatArray:
    """How far the mean specific force is from gravity's, and how much the force varies over the
    interval.

    PROBE has the magnitude of the specific force. Which way is down is not known here, so that
    gravity can only be taken off the magnitude of the mean force: |‖f̄‖ − g|. This shows vertical
    acceleration, bumps, in full; horizontal acceleration a is nearly invisible in it, as √(g² + a²)
    − g ≈ a²/2g. A bias stays in it.

    The second is the root mean square of ‖f − f̄‖: vibration and jerk along any axis. The mean
    takes gravity and bias off, except for what gravity turns in the IMU's frame: about 0.03 m/s²
    for each 0.1 rad/s in a step of 0.1 s.

    Args:
        imu: samples of the interval, with an accelerometer.

    Returns:
        [2], m/s²; the same for all features of a step. NaN where a sample is, and where there is
        none.
    """
    if not len(imu.stamps_ns):
        return np.full(2, np.nan)
    mean = imu.accel_m_s2.mean(axis=0)
    offset = abs(float(np.linalg.norm(mean)) - GRAVITY_M_S2)
    squared = np.sum((imu.accel_m_s2 - mean) ** 2, axis=1)
    return np.array([offset, np.sqrt(squared.mean())])
