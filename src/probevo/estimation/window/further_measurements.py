"""Further measurements of the poses of a window, which become part of its prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation import levenberg_marquardt
from probevo.estimation.window.equations import POSE
from probevo.estimation.window.window import MarginalPrior, Window
from probevo.geometry import se3
from probevo.measurements.base import Measurement
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
    values = window.values()
    at_linear = dict(zip(values, window.T_linear, strict=True))
    information = window.prior.information.copy()
    vector = window.prior.vector.copy()
    x = window.offsets()
    for measurement in measurements:
        if isinstance(measurement, VectorMeasurement):
            linear = measurement.linearize_about(values, jacobians_at=at_linear)
        else:
            linear = measurement.linearize(values)
        # Where its variables lie in the joint vector; all are poses.
        first = [POSE * window.slot(variable.frame) for variable in measurement.variables]
        joint = (np.array(first)[:, None] + np.arange(POSE)).ravel()
        # Its gradient g is at the present offsets x, but the prior's vector is that at x = 0, where
        # the gradient of the same quadratic is g + H x.
        information[np.ix_(joint, joint)] += linear.hessian
        vector[joint] += linear.gradient + linear.hessian @ x[joint]
    return replace(window, prior=MarginalPrior(information, vector))


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
