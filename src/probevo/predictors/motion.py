"""How fast the camera moves (PROBE-GK)."""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.geometry import se3


def velocity(expected: FloatArray, duration_s: float) -> FloatArray:
    """Velocity of the expected motion along the camera's own axes, constant over the step.

    With ``turn_rate``, it stands for PROBE-GK's estimated transform parameters; but these are known
    before the motion is solved. Driving forward is +z.

    Args:
        expected: T_curr_prev, [4, 4].
        duration_s: of the step.

    Returns:
        (v_x, v_y, v_z), [3], m/s; the same for all features of a step.
    """
    # Exp of −(v, ω) times the duration takes points from the previous to the current frame.
    rate: FloatArray = -se3.log(expected)[:3] / duration_s
    return rate
