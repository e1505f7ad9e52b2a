"""The angular rate of the camera (PROBE IV-C.1)."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import so3
from probevo.predictors.base import Needs, Predictor


def turn_rate(predicted_T_curr_prev: FloatArray, duration_s: float) -> FloatArray:
    """Compute the angular rate ω = −Log(C_curr_prev)/Δt of the predicted motion, and ‖ω‖.

    This is the gyro's rate less its bias or, without a gyro, the rate of the previous motion.
    PROBE has the magnitude alone. About x it is positive when the camera pitches up, about y when
    it turns right, about z when it rolls clockwise.

    Args:
        predicted_T_curr_prev: the predicted motion, [4, 4].
        duration_s: time Δt between the frames.

    Returns:
        (ω_x, ω_y, ω_z, ‖ω‖), [4], rad/s, the same for all features of a step; always defined.
    """
    # The minus: a camera that turns by ω moves its points by −ω. C_curr_prev = Exp(−ω Δt)
    rate = -so3.log(predicted_T_curr_prev[:3, :3]) / duration_s
    return np.append(rate, np.linalg.norm(rate))


TURN_RATE = Predictor(
    name="turn_rate",
    columns={
        "turn_rate_x": "rad/s",
        "turn_rate_y": "rad/s",
        "turn_rate_z": "rad/s",
        "turn_rate": "rad/s",
    },
    source="PROBE IV-C.1; signed: ours",
    needs=Needs.TRACKS,
    compute=lambda step: step.for_all_features(
        turn_rate(step.predicted_T_curr_prev, step.duration_s)
    ),
)
