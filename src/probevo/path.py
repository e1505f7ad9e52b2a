"""Compounding of motions to a path: poses with consistent covariances."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError, brief
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS, MotionEstimate, Status
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3


def compound(motions: Iterable[MotionEstimate]) -> tuple[FloatArray, FloatArray]:
    """Compound the estimates of successive steps to the poses of a path, with their covariances.

    Common-mode errors add up coherently, and the cross-covariances of successive steps are taken
    into account (``evaluation.consistency.drift_covariances``).

    Args:
        motions: estimates of K steps in their order, as ``step`` returns them; that of the first
            frame may be among them.

    Returns:
        T_world_cam, [K + 1, 4, 4], m, where the world is the first camera, and the covariances of
        the left perturbations of T_cam_world, [K + 1, 6, 6], m and rad, 0 at the first.

    Raises:
        InputError: it is a single estimate or none, or an element is not a MotionEstimate.
    """
    if not isinstance(motions, Iterable):
        cure = "Give a list of the estimates of all steps."
        raise InputError("motions", f"is {brief(motions)}.", cure)
    steps = []
    for motion in motions:
        if not isinstance(motion, MotionEstimate):
            raise InputError("motions", f"{brief(motion)} is not a MotionEstimate.")
        if motion.status is not Status.FIRST:
            steps.append(motion)
    T_curr_prev = np.array([step.T_curr_prev for step in steps]).reshape(-1, 4, 4)
    cov = drift_covariances(
        T_curr_prev,
        np.array([step.cov for step in steps]).reshape(-1, 6, 6),
        np.array([step.common_mode for step in steps]).reshape(-1, 6, COMMON_MODE_COLUMNS),
        path_cross_cov=np.array([step.path_cross_cov for step in steps]).reshape(-1, 6, 6),
    )
    return se3.chain_motions(T_curr_prev), cov
