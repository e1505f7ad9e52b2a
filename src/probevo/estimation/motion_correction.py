"""The motion of a step as a correction has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probevo.estimation.motion_estimate import MotionEstimate
from probevo.measurements.base import Measurement
from probevo.measurements.relative_pose import RelativePose


def corrected(motion: MotionEstimate, measurement: Measurement) -> MotionEstimate:
    """Return the corrected motion in place of that of the images, with its covariance.

    This covariance is that of the corrected motion's whole error, errors of the rig's calibration
    included, and it is calibrated on sums of successive errors: there is neither a common-mode part
    nor a cross-covariance with the path beside it.
    """
    if not isinstance(measurement, RelativePose):
        return motion
    return replace(
        motion,
        T_curr_prev=measurement.T_curr_prev,
        cov=measurement.covariance,
        common_mode=np.zeros((6, 3)),
        path_cross_cov=np.zeros((6, 6)),
    )
