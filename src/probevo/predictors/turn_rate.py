"""How fast the camera turns (PROBE IV-C.1)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import so3


def turn_rate(expected: FloatArray, duration_s: float) -> FloatArray:
    """Angular rate of the expected motion: about the camera's axes, and its magnitude.

    It is the gyro's, less its bias, or that of the last motion where there is no gyro. PROBE has
    the magnitude alone. About x it is positive when the camera pitches up, about y when it turns
    right, about z when it rolls clockwise.

    Args:
        expected: T_curr_prev, [4, 4].
        duration_s: of the step.

    Returns:
        (ω_x, ω_y, ω_z, ‖ω‖), [4], rad/s; the same for all features of a step.
    """
    # A camera that turns by ω moves its points by −ω.
    rate = -so3.log(expected[:3, :3]) / duration_s
    return np.append(rate, np.linalg.norm(rate))
