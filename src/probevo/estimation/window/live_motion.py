"""What a window says of a step: the motion of the live path, and its share of the path's error.

The live pose of a frame is the window's estimate when that frame is the newest. A later one of the
same frame is better, but comes too late for whoever steers by it. The steps of the live path lead
from one live pose to the next, so that they compound to it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS, MotionEstimate
from probevo.estimation.pose_filter import PoseFilter
from probevo.estimation.window.window import Window
from probevo.geometry import se3
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM, squared_mahalanobis

MAX_ATTITUDE_SIGMA_RAD = 0.2
"""Standard deviation of the attitude in the world up to which covariances of poses in the world
may be subtracted from each other: beyond, their errors of linearisation exceed the difference."""
MAX_POSITION_SHARE = 1e5
"""Variance of the position in the world, over that of the translation of a step, up to which they
may be. A position known to 10 m beside a step known to 3 mm has 10⁷. With 10⁴ to 10⁶, the NEES of
steps of two rendered streets and of KITTI's raw drive 0039 is the same to 0.02."""


def live_motion(motion: MotionEstimate, before: Window, after: Window) -> MotionEstimate:
    """Return the step of the live path in place of a motion that two frames alone have shown.

    With e_k the error of the live pose k, the error of the step is ε = e_k − Ad e_{k−1}. Estimates
    from more data correct e_{k−1} by something that their own errors do not depend on, so that
    cov(e_k, e_{k−1}) is that of the two poses in the window after the step, and

        cov(ε) = cov(ξ_k − Ad ξ_{k−1} after) + Ad (P_{k−1} before − P_{k−1} after) Adᵀ.

    Where the position in the world is known much less than the step, as after blackouts or a long
    drive, P is relative to the oldest frame of the window, of which a new frame tells next to
    nothing; behind a long pause, to the oldest frame since then.

    The correction of e_{k−1} is known once it has been made. Where it is larger than its covariance
    admits, as when the window lets go of a car that it has followed, the step's covariance covers
    it, too. So it does with a P that is relative, which does not know how the oldest frame has been
    corrected.

    Args:
        motion: of the last two frames.
        before: the window whose last frame is the previous one, before the step.
        after: the window with the current frame, adjusted.
    """
    # From the live pose of the previous frame, as it was estimated before this step, to that of the
    # current one.
    T_curr_prev = after.T_cam_world[-1] @ se3.inverse(before.T_cam_world[-1])
    adjoint = se3.adjoint(T_curr_prev)
    last = len(after) - 1
    prev_before = before.pose(-1).cov
    curr_after = after.pose(last).cov
    T_relative, relative_cov = after.relative(last, last - 1)
    # cov(ε): the step after, and the share of the previous pose's error that this step has removed.
    # What the step has shown of the lenses' distortion removes nothing from that pose.
    cov_reduction = before.cov_given_calibration(-1) - after.cov_given_calibration(last - 1)
    largest_variance = MAX_POSITION_SHARE * np.diagonal(relative_cov)[:3].max()
    is_far = np.diagonal(prev_before)[:3].max() > largest_variance
    if is_far or np.diagonal(prev_before)[3:].max() > MAX_ATTITUDE_SIGMA_RAD**2:
        cov_reduction = _reduction_since_known_frame(before, after, largest_variance)
    corrected = adjoint @ cov_reduction @ adjoint.T
    cov = relative_cov + _positive_part(corrected)
    if after.is_blind[-1] and _log_volume(motion.cov) < _log_volume(cov):
        # Blind frames are dead-reckoned from the last usable one, each as if by itself.
        cov = motion.cov
    # T_curr_prev T_relative⁻¹: how far the step moved the previous pose, along the axes of the
    # current frame.
    correction = se3.log(T_curr_prev @ se3.inverse(T_relative))
    if is_far or squared_mahalanobis(correction, cov) > MOTIONS_DIFFER_FROM:
        cov = cov + np.outer(correction, correction)
    # The path's covariance has to come out as that of the window, P_k = Ad P_{k−1} Adᵀ + cov(ε) + X
    # + Xᵀ: its growth less cov(ε) is split evenly into X and Xᵀ.
    growth = curr_after - adjoint @ prev_before @ adjoint.T
    return replace(
        motion,
        T_curr_prev=T_curr_prev,
        cov=cov,
        common_mode=np.zeros((6, COMMON_MODE_COLUMNS)),
        path_cross_cov=0.5 * (growth - cov),
    )


def _reduction_since_known_frame(
    before: Window, after: Window, largest_variance: float
) -> FloatArray:
    """Return by how much a step has reduced the covariance of the previous pose, [6, 6], where both
    are relative to the oldest frame from which the motion to that pose is known.

    Args:
        before: the window before the step.
        after: the window after it.
        largest_variance: of the translation of a motion that is known, m².
    """
    prev = len(after) - 2
    for slot in range(prev):
        _, cov_before = before.relative(len(before) - 1, before.slot(int(after.frames[slot])))
        variances = np.diagonal(cov_before)
        is_known = variances[:3].max() <= largest_variance
        if is_known and variances[3:].max() <= MAX_ATTITUDE_SIGMA_RAD**2:
            _, cov_after = after.relative(prev, slot)
            return np.asarray(cov_before - cov_after)
    # The motion to the previous frame was not known before the step, as right behind a pause: there
    # is nothing relative to which it was.
    return np.zeros((6, 6))


def live_pose(window: Window) -> PoseFilter:
    """Return the pose of the newest frame; the rig's errors are part of its covariance."""
    newest = window.pose(len(window) - 1)
    return PoseFilter(
        T_world_cam=newest.T_world_cam,
        own_cov=newest.cov,
        common_mode=np.zeros((6, COMMON_MODE_COLUMNS)),
    )


def _log_volume(cov: FloatArray) -> float:
    """Return half of log |cov|; infinite where rounding has left no covariance."""
    try:
        return float(np.log(np.diagonal(np.linalg.cholesky(cov))).sum())
    except np.linalg.LinAlgError:
        return np.inf


def _positive_part(matrix: FloatArray) -> FloatArray:
    """Return a symmetric matrix without its negative eigenvalues, which are of linearisation."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    part: FloatArray = (vectors * np.maximum(values, 0.0)) @ vectors.T
    return part
