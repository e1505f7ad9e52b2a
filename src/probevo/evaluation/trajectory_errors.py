"""Errors of an estimated trajectory against the truth: ARMSE, ATE, RPE.

Trajectories are poses T_world_cam, [K, 4, 4], m, of the same K ≥ 1 frames, known unless said
otherwise.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3, so3


def from_first_camera(T_world_cam: FloatArray) -> FloatArray:
    """Transform a trajectory to the first camera as its world frame, [K, 4, 4]."""
    return se3.inverse(T_world_cam[0]) @ T_world_cam


def relative_motions(T_world_cam: FloatArray) -> FloatArray:
    """Compute T_curr_prev of each frame but the first, [K-1, 4, 4]; NaN where either pose is."""
    return se3.inverse(T_world_cam[1:]) @ T_world_cam[:-1]


def path_length(T_world_cam: FloatArray) -> float:
    """Measure the polyline through the positions, m.

    Args:
        T_world_cam: poses of K frames, [K, 4, 4], m, in any world frame.
    """
    return float(distance_along_path(T_world_cam)[-1])


def distance_along_path(T_world_cam: FloatArray) -> FloatArray:
    """Measure the distance travelled up to each frame, [K], m; 0 at the first."""
    steps = np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def position_errors(T_world_cam_est: FloatArray, T_world_cam_true: FloatArray) -> FloatArray:
    """Compute e_k, estimated minus true position in the first camera frame, [K, 3], m."""
    return (from_first_camera(T_world_cam_est) - from_first_camera(T_world_cam_true))[:, :3, 3]


def rotation_errors(T_world_cam_est: FloatArray, T_world_cam_true: FloatArray) -> FloatArray:
    """Compute Log(C_true C_estᵀ), [K, 3], rad; attitudes are relative to the first, unaligned."""
    C_true = from_first_camera(T_world_cam_true)[:, :3, :3]
    C_est = from_first_camera(T_world_cam_est)[:, :3, :3]
    return so3.log(C_true @ np.swapaxes(C_est, -1, -2))


def armse(errors: FloatArray) -> float:
    """Average the root mean square error over frames, mean_k √(‖e_k‖²/3) (PROBE, Table I).

    The root mean square is taken over the three axes of each error, [K, 3].
    """
    return float(np.mean(np.linalg.norm(errors, axis=1)) / np.sqrt(3.0))


def ate_rmse(
    T_world_cam_est: FloatArray, T_world_cam_true: FloatArray, *, align: bool = True
) -> float:
    """Compute the absolute trajectory error (ATE), RMS over positions, m.

    Positions are compared after the best rigid alignment, or with the first cameras made equal.

    Args:
        T_world_cam_est: estimated poses, [K, 4, 4], m. With ``align``, in any world frame.
        T_world_cam_true: true poses of the same frames, [K, 4, 4], m, in a world frame of their
            own.
        align: whether to align all positions rigidly first.
    """
    if not align:
        return _rms(position_errors(T_world_cam_est, T_world_cam_true))
    p_est = T_world_cam_est[:, :3, 3]
    p_true = T_world_cam_true[:, :3, 3]
    T_true_est = rigid_alignment(p_est, p_true)
    return _rms(p_est @ T_true_est[:3, :3].T + T_true_est[:3, 3] - p_true)


def rigid_alignment(points_a: FloatArray, points_b: FloatArray) -> FloatArray:
    """Find the T_b_a, [4, 4], that takes points_a to points_b, [K, 3] each (Umeyama 1991).

    It minimises the sum of squared distances. Points on a line or in one place leave the rotation
    about them open; one of the minimisers is returned.
    """
    center_a = points_a.mean(axis=0)
    center_b = points_b.mean(axis=0)
    C_b_a = so3.most_aligned((points_b - center_b).mT @ (points_a - center_a))
    return se3.from_parts(C_b_a, center_b - C_b_a @ center_a)


def rpe_rmse(
    T_world_cam_est: FloatArray, T_world_cam_true: FloatArray
) -> tuple[float, float] | None:
    """Compute the relative pose error (RPE) from frame to frame (Sturm et al. 2012, as in evo).

    The truth of KITTI is itself noisy from frame to frame, more so than good stereo odometry. There
    the RPE measures the truth as much as the estimate.

    Args:
        T_world_cam_est: estimated poses, [K, 4, 4], m, in any world frame.
        T_world_cam_true: true poses of the same frames, [K, 4, 4], m, in any world frame; NaN where
            unknown.

    Returns:
        The RMS of its translation, m, and of its angle, deg; None without a step whose truth is
        known at both ends.
    """
    motion_true = relative_motions(T_world_cam_true)
    known = np.isfinite(motion_true).all(axis=(1, 2))
    if not known.any():
        return None
    # The left perturbation T_true T_est⁻¹, as in the consistency of the covariance
    error = motion_true[known] @ se3.inverse(relative_motions(T_world_cam_est)[known])
    return _rms(error[:, :3, 3]), float(np.rad2deg(_rms(so3.log(error[:, :3, :3]))))


def _rms(vectors: FloatArray) -> float:
    """Compute the root mean square length of vectors, [K, 3]."""
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
