"""Further measurements of the poses of a window, which become part of its prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from probevo.estimation.window import MarginalPrior, Window
from probevo.estimation.window_numba import POSE
from probevo.measurements.base import Measurement, pose_of


def with_measurements(window: Window, measurements: Sequence[Measurement]) -> Window:
    """Return the window with measurements of its poses, linearised at their current values.

    Args:
        window: K frames.
        measurements: of variables ``pose_of(frame)``, of frames of the window only.
    """
    if not measurements:
        return window
    values = {
        pose_of(int(frame)): T for frame, T in zip(window.frames, window.T_cam_world, strict=True)
    }
    information = window.prior.information.copy()
    vector = window.prior.vector.copy()
    x = window.offsets()
    for measurement in measurements:
        linear = measurement.linearize(values)
        # Where its variables lie in the joint vector; all are poses.
        first = [POSE * window.slot(variable.frame) for variable in measurement.variables]
        joint = (np.array(first)[:, None] + np.arange(POSE)).ravel()
        information[np.ix_(joint, joint)] += linear.hessian
        vector[joint] += linear.gradient + linear.hessian @ x[joint]
    return replace(window, prior=MarginalPrior(information, vector))
