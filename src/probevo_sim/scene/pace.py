"""Distance driven over time: within limits of speed and acceleration, with halts, and smooth.

The fastest motion within the limits has steps in its acceleration. A convolution with a narrow
smoothing window removes them, so that the motion can be differentiated.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicHermiteSpline

from probevo.arrays import FloatArray

MAX_ACCELERATION_M_S2 = 1.5
HALT_S = 1.5
"""Duration of a halt on the way."""
REST_S = 0.5
"""Time that the vehicle stands at an end of the drive that is at rest."""
_NODE_STEP_M = 0.1
_RUN_UP_S = 2.0
"""The drive continues for at least this long beyond both ends, so that it is smooth there."""
_HALF_WINDOW_S = 0.5
"""Half the width of the smoothing window."""


def _smoothing_window() -> tuple[FloatArray, FloatArray]:
    """Return delays, s, and their weights, [101] each: four moving averages of 0.25 s in series."""
    box = np.full(26, 1.0 / 26)
    weight = np.convolve(np.convolve(box, box), np.convolve(box, box))
    return np.linspace(-_HALF_WINDOW_S, _HALF_WINDOW_S, len(weight)), weight / weight.sum()


_DELAY_S, _WEIGHT = _smoothing_window()


@dataclass(frozen=True, eq=False)
class Pace:
    """The distance driven from time 0 to ``duration_s``, and for a second beyond either end."""

    duration_s: float
    start_s: float
    """Time 0 on the clock of ``unsmoothed``."""
    unsmoothed: CubicHermiteSpline
    """Distance, m, over time, s, before smoothing: with steps in the acceleration."""

    @staticmethod
    def within(
        speed_limit: Callable[[FloatArray], FloatArray],
        distance_m: float,
        stops_m: tuple[float, ...],
        *,
        from_rest: bool,
        to_rest: bool,
    ) -> Pace:
        """Drive as fast as the limits allow.

        Args:
            speed_limit: positive limits, m/s, at distances, m; also asked a little before 0 and
                after the end.
            distance_m: distance to drive.
            stops_m: distances at which to halt; those not within the drive are left out.
            from_rest: whether the vehicle stands at the start; else it arrives at the speed limit.
            to_rest: whether the vehicle stands at the end; else it leaves at the speed limit.
        """
        # Nodes along the road: a run-up and a run-out where the ends are not at rest.
        ends_m = np.array([0.0, distance_m])
        run_up_m, run_out_m = _RUN_UP_S * speed_limit(ends_m) * [not from_rest, not to_rest]
        first_m = -run_up_m
        last_m = distance_m + run_out_m
        stops = np.array([stop for stop in stops_m if 0 < stop < distance_m])
        halts = np.r_[stops, ends_m[[from_rest, to_rest]]]
        count = 2 + int((last_m - first_m) / _NODE_STEP_M)
        nodes = np.unique(np.r_[np.linspace(first_m, last_m, count), halts])
        speed = _reachable(nodes, np.where(np.isin(nodes, halts), 0.0, speed_limit(nodes)))

        # Times at the nodes. Smoothing shortens each halt by half a window on both sides.
        pause_s = np.where(np.isin(nodes, stops), HALT_S + 2 * _HALF_WINDOW_S, 0.0)
        pause_s[[0, -1]] += _RUN_UP_S * np.array([from_rest, to_rest])
        driving_s = np.r_[0.0, np.cumsum(2.0 * np.diff(nodes) / (speed[1:] + speed[:-1]))]
        depart_s = driving_s + np.cumsum(pause_s)

        # A halt is a node twice: when the vehicle arrives and when it departs.
        waits = pause_s > 0
        time_s = np.r_[depart_s, (depart_s - pause_s)[waits]]
        order = np.argsort(time_s, kind="stable")
        path = CubicHermiteSpline(
            time_s[order], np.r_[nodes, nodes[waits]][order], np.r_[speed, speed[waits]][order]
        )

        # Where the drive itself begins and ends on this clock.
        start_s = depart_s[0] - REST_S - _HALF_WINDOW_S if from_rest else _time_at(0.0, path)
        end_s = (
            (depart_s - pause_s)[-1] + REST_S + _HALF_WINDOW_S
            if to_rest
            else _time_at(distance_m, path)
        )
        return Pace(float(end_s - start_s), float(start_s), unsmoothed=path)

    def distance(self, t_s: ArrayLike) -> FloatArray:
        """Return the distance at times [...], m; in a halt it is constant to rounding."""
        return _smoothed(self.unsmoothed, self.start_s + np.asarray(t_s, float))

    def speed(self, t_s: ArrayLike) -> FloatArray:
        """Return the speed at times [...], m/s."""
        return _smoothed(self.unsmoothed, self.start_s + np.asarray(t_s, float), derivative=1)


def _reachable(nodes: FloatArray, limit: FloatArray) -> FloatArray:
    """Return the highest speed at each node within the limits of speed and acceleration, m/s.

    Args:
        nodes: distances, [K], m.
        limit: speed limit at each, [K], m/s; 0 at a halt.
    """
    # At constant acceleration a, v² grows linearly with the distance, by 2a per metre. One pass
    # forwards limits the acceleration, one backwards the deceleration.
    gain = 2.0 * MAX_ACCELERATION_M_S2 * nodes
    squared = np.minimum(
        np.minimum.accumulate(limit**2 - gain) + gain,
        np.minimum.accumulate((limit**2 + gain)[::-1])[::-1] - gain,
    )
    return np.where(limit == 0.0, 0.0, np.sqrt(np.maximum(squared, 1e-12)))


def _smoothed(path: CubicHermiteSpline, time_s: FloatArray, derivative: int = 0) -> FloatArray:
    smoothed: FloatArray = path(time_s[..., None] + _DELAY_S, derivative) @ _WEIGHT
    return smoothed


def _time_at(distance_m: float, path: CubicHermiteSpline) -> float:
    """Return when the smoothed motion, which is not at rest there, passes a distance, s."""
    time_s = np.interp([distance_m], path(path.x), path.x)
    for _ in range(10):  # Newton's method
        speed_m_s = np.maximum(_smoothed(path, time_s, 1), 0.1)
        time_s += (distance_m - _smoothed(path, time_s)) / speed_m_s
    return float(time_s[0])
