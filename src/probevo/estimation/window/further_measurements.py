"""Further measurements of the poses of a window.

They become part of its prior at once, or, where they stand in for features, once a frame of them
leaves the window.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.estimation import levenberg_marquardt
from probevo.estimation.window.equations import POSE
from probevo.estimation.window.window import MarginalPrior, Window
from probevo.geometry import se3
from probevo.measurements.base import Linearization, Measurement
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.vector_measurement import VectorMeasurement


def with_measurements(window: Window, measurements: Sequence[Measurement]) -> Window:
    """Return the window with measurements of its poses, linearised about their current values.

    Their Jacobians are formed at the linearisation points of the poses. At the current values, the
    directions along which a relative measurement says nothing would be others than those of the
    prior, and the sum of both would know where in the world the window is.

    Args:
        window: K frames.
        measurements: of variables ``pose_of(frame)``, of frames of the window only.
    """
    if not measurements:
        return window
    information = window.prior.information.copy()
    vector = window.prior.vector.copy()
    x = window.offsets()
    for joint, linear in linearized_measurements(window, measurements):
        # Its gradient g is at the present offsets x, but the prior's vector is that at x = 0, where
        # the gradient of the same quadratic is g + H x.
        information[np.ix_(joint, joint)] += linear.hessian
        vector[joint] += linear.gradient + linear.hessian @ x[joint]
    return replace(window, prior=MarginalPrior(information, vector))


def linearized_measurements(
    window: Window, measurements: Sequence[Measurement]
) -> Iterator[tuple[IntArray, Linearization]]:
    """Yield the normal equations of each measurement at the current poses, its Jacobians at their
    linearisation points.

    Args:
        window: K frames.
        measurements: of variables ``pose_of(frame)``, of frames of the window only.

    Yields:
        Where the n degrees of freedom of its variables lie in the joint vector, [n], and its
        equations over them.
    """
    values = window.values()
    at_linear = dict(zip(values, window.T_linear, strict=True))
    for measurement in measurements:
        if isinstance(measurement, VectorMeasurement):
            linear = measurement.linearize_about(values, jacobians_at=at_linear)
        else:
            linear = measurement.linearize(values)
        # All of its variables are poses.
        first = [POSE * window.slot(variable.frame) for variable in measurement.variables]
        joint = (np.array(first)[:, None] + np.arange(POSE)).ravel()
        yield joint, linear


def with_dead_reckoning(window: Window, measurements: Sequence[Measurement]) -> Window:
    """Return the window with measurements that stand in for features.

    A dead-reckoned pose may be off by tens of degrees. An IMU that later turns it to where it is
    would be linearised where it was, if the prior held it there, and so would seem to know gravity,
    velocities and its own place better than it does.
    """
    return replace(window, dead_reckoning=(*window.dead_reckoning, *measurements))


def with_dead_reckoning_in_prior(window: Window, leaving: BoolArray) -> Window:
    """Return the window with the dead reckoning of frames that are to leave it, [K], in its
    prior."""
    if not window.dead_reckoning:
        return window
    left = set(window.frames[leaving].tolist())
    marginalized: list[Measurement] = []
    remaining: list[Measurement] = []
    for measurement in window.dead_reckoning:
        if any(variable.frame in left for variable in measurement.variables):
            marginalized.append(measurement)
        else:
            remaining.append(measurement)
    return replace(with_measurements(window, marginalized), dead_reckoning=tuple(remaining))


def reweighted_and_combined(
    motion: RelativePose, measurements: Sequence[Measurement], window: Window
) -> tuple[list[Measurement], FloatArray]:
    """Reweight measurements of the next pose by their innovations against a dead-reckoned motion,
    and combine all of them.

    A window linearises its measurements once. Where a precise sensor contradicts the dead-reckoned
    motion by tens of degrees, that has to be at the pose that follows from both.

    Args:
        motion: from a frame of the window to the next one, by dead reckoning.
        measurements: of poses of the window and of the next one.
        window: K frames, without the next one.

    Returns:
        The measurements, and the most likely T_curr_prev, [4, 4], m.
    """
    if not measurements:
        return [], motion.T_curr_prev
    T_prev_world = window.T_cam_world[window.slot(motion.prev_frame)]
    values = {**window.values(), motion.curr: motion.T_curr_prev @ T_prev_world}
    reweighted = [
        one.reweighted(values, motion.covariance, of=motion.curr)
        if isinstance(one, VectorMeasurement) and motion.curr in one.variables
        else one
        for one in measurements
    ]
    optimum = levenberg_marquardt.minimize([motion, *reweighted], values, [motion.curr])
    return reweighted, optimum.values[motion.curr] @ se3.inverse(T_prev_world)
