"""Distance over time: closed forms of its length, its limits and its halts."""

from collections.abc import Callable

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo_sim.scene.pace import HALT_S, MAX_ACCELERATION_M_S2, REST_S, Pace

STEP_S = 1e-3


def steady(speed_m_s: float) -> Callable[[FloatArray], FloatArray]:
    return lambda distance_m: np.full(np.shape(distance_m), speed_m_s)


def uneven(distance_m: FloatArray) -> FloatArray:
    return 6.0 + 4.0 * np.cos(distance_m / 10.0)


def test_duration_has_the_closed_form() -> None:
    """D/v, v/a more for acceleration and deceleration, and at both ends rest and half a window."""
    pace = Pace.within(steady(9.0), 200.0, (), from_rest=True, to_rest=True)
    duration_s = 200.0 / 9.0 + 9.0 / MAX_ACCELERATION_M_S2 + 2 * (REST_S + 0.5)
    assert pace.duration_s == pytest.approx(duration_s, rel=1e-3)


@pytest.mark.parametrize("rest", [True, False])
def test_whole_distance_is_driven(rest: bool) -> None:
    pace = Pace.within(uneven, 100.0, (40.0,), from_rest=rest, to_rest=rest)
    np.testing.assert_allclose(pace.distance([0.0, pace.duration_s]), [0.0, 100.0], atol=1e-9)


def test_speed_is_the_derivative_of_the_distance() -> None:
    pace = Pace.within(uneven, 100.0, (40.0,), from_rest=True, to_rest=False)
    t_s = np.linspace(-0.5, pace.duration_s + 0.5, 2000)
    numeric = (pace.distance(t_s + STEP_S) - pace.distance(t_s - STEP_S)) / (2 * STEP_S)
    np.testing.assert_allclose(pace.speed(t_s), numeric, atol=1e-4)


def test_acceleration_is_bounded() -> None:
    pace = Pace.within(uneven, 200.0, (40.0, 90.0), from_rest=True, to_rest=True)
    speed = pace.speed(np.arange(-0.5, pace.duration_s + 0.5, STEP_S))
    assert np.abs(np.diff(speed)).max() < 1.01 * MAX_ACCELERATION_M_S2 * STEP_S
    assert speed.min() > -1e-9


def test_speed_limit_is_kept_up_to_the_smoothing() -> None:
    pace = Pace.within(uneven, 200.0, (), from_rest=False, to_rest=False)
    t_s = np.linspace(0.0, pace.duration_s, 2000)
    assert np.max(pace.speed(t_s) - uneven(pace.distance(t_s))) < 0.15


def test_halts_have_their_duration() -> None:
    pace = Pace.within(steady(5.0), 100.0, (30.0, 60.0, 130.0), from_rest=False, to_rest=False)
    t_s = np.arange(0.0, pace.duration_s, STEP_S)
    for stop_m in (30.0, 60.0):
        halted_s = STEP_S * np.sum(np.abs(pace.distance(t_s) - stop_m) < 1e-9)
        assert HALT_S - 0.01 < halted_s < HALT_S + 0.2
    assert STEP_S * np.sum(pace.speed(t_s) < 1e-6) < 2 * (HALT_S + 0.2)


def test_ends_are_at_rest() -> None:
    pace = Pace.within(steady(5.0), 50.0, (), from_rest=True, to_rest=True)
    rest_s = np.linspace(-0.5, REST_S, 50)
    np.testing.assert_allclose(pace.speed(np.r_[rest_s, pace.duration_s - rest_s]), 0.0, atol=1e-12)
