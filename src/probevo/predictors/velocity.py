"""The velocity of the camera (PROBE-GK)."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.predictors.base import Needs, Predictor


def velocity(predicted_T_curr_prev: FloatArray, duration_s: float) -> FloatArray:
    """Compute the constant body-frame velocity v that gives the predicted motion.

    (v, ω) = −Log(T_curr_prev)/Δt, since points move against the camera. Together with
    ``turn_rate`` it stands for PROBE-GK's estimated transform parameters; but these predictors are
    known before the motion is estimated. Driving forward is +z.

    Args:
        predicted_T_curr_prev: the predicted motion, [4, 4].
        duration_s: time Δt between the frames.

    Returns:
        (v_x, v_y, v_z), [3], m/s, the same for all features of a step; always defined.
    """
    # The first three of ξ = [ρ; φ] are the translational part of the twist, not the translation.
    v: FloatArray = -se3.log(predicted_T_curr_prev)[:3] / duration_s
    return v


VELOCITY = Predictor(
    name="velocity",
    columns={"velocity_x": "m/s", "velocity_y": "m/s", "velocity_z": "m/s"},
    source="PROBE-GK: transform parameters",
    needs=Needs.TRACKS,
    compute=lambda step: step.for_all_features(
        velocity(step.predicted_T_curr_prev, step.duration_s)
    ),
)
