"""The velocity of known motions."""

import numpy as np

from probevo.geometry import se3
from probevo.predictors.turn_rate import turn_rate
from probevo.predictors.velocity import velocity


def test_driving_forward_is_positive_z() -> None:
    """At 12 m/s, what stood at the camera is after 0.1 s 1.2 m behind it."""
    predicted = se3.from_parts(np.eye(3), np.array([0.0, 0.0, -1.2]))
    np.testing.assert_allclose(velocity(predicted, 0.1), [0.0, 0.0, 12.0], atol=1e-12)


def test_velocity_and_turn_rate_integrate_to_the_motion() -> None:
    """Integrated in a thousand steps, they are the motion again."""
    predicted = se3.exp(np.array([0.1, -0.05, -1.2, 0.02, -0.1, 0.03]))
    T_prev_curr = np.eye(4)
    step_s = 0.1 / 1000
    for _ in range(1000):
        T_prev_curr = T_prev_curr @ se3.exp(
            step_s * np.r_[velocity(predicted, 0.1), turn_rate(predicted, 0.1)[:3]]
        )
    np.testing.assert_allclose(se3.inverse(T_prev_curr), predicted, atol=1e-12)
