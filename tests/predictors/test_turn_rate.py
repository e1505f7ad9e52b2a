"""The turn rate of known rotations."""

import numpy as np
import pytest

from probevo.geometry import se3, so3
from probevo.predictors.turn_rate import turn_rate

DURATION_S = 0.1


@pytest.mark.parametrize(
    "rate_rad_s", [[0.3, 0.0, 0.0], [0.0, -0.5, 0.0], [0.1, 0.4, -0.2], [0.0, 0.0, 0.0]]
)
def test_it_is_the_rate_that_turned_the_camera(rate_rad_s: list[float]) -> None:
    """The attitude C_prev_curr is propagated by Exp(ω Δt)."""
    C_prev_curr = so3.exp(DURATION_S * np.array(rate_rad_s))
    predicted = se3.from_parts(C_prev_curr.T, np.array([0.1, 0.2, -1.0]))
    values = turn_rate(predicted, DURATION_S)
    np.testing.assert_allclose(values, [*rate_rad_s, np.linalg.norm(rate_rad_s)], atol=1e-12)


def test_turning_right_is_positive_about_y() -> None:
    """What was ahead is then seen to the left."""
    predicted = se3.from_parts(so3.exp(np.array([0.0, -0.05, 0.0])), np.zeros(3))
    assert se3.transform(predicted, np.array([0.0, 0.0, 10.0]))[0] < 0.0
    np.testing.assert_allclose(turn_rate(predicted, DURATION_S), [0.0, 0.5, 0.0, 0.5], atol=1e-12)
