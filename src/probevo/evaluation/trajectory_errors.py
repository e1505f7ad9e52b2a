"""Errors of an estimated trajectory against the truth: ARMSE, ATE, RPE.

Trajectories are poses T_world_cam, [K, 4, 4], m, of the same K ≥ 1 frames, known unless said
otherwise.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3, so3


def from_first_camera(T_world_cam: FloatArray) -> FloatArray:
    """The same trajectory with the first camera as world frame, [K, 4, 4]."""
    return se3.inverse(T_world_cam[0]) @ T_world_cam


def relative_motions(T_world_cam: FloatArray) -> FloatArray:
    """T_curr_prev of each frame but the first, [K-1, 4, 4]; NaN where either pose is."""
    return se3.inverse(T_world_cam[1:]) @ T_world_cam[:-1]


def path_length(T_world_cam: FloatArray) -> float:
    """Length of the polyline through the positions, m."""
    return float(distance_along_path(T_world_cam)[-1])


def distance_along_path(T_world_cam: FloatArray) -> FloatArray:
    """Distance travelled up to each frame, [K], m; 0 at the first."""
    steps = np.linalg.norm(np.diff(T_world_cam[:, :3, 3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def position_errors(T_world_cam_est: FloatArray, T_world_cam_true: FloatArray) -> FloatArray:
    """e_k, estimated minus true position in the first camera frame, unaligned, [K, 3], m."""
    return (from_first_camera(T_world_cam_est) - from_first_camera(T_world_cam_true))[:, :3, 3]


def rotation_errors(T_world_cam_est: FloatArray, T_world_cam_true: FloatArray) -> FloatArray:
    """Log(C_true C_estᵀ) of the attitude relative to the first camera frame, unaligned, [K, 3],
    rad."""
    C_true = from_first_camera(T_world_cam_true)[:, :3, :3]
    C_est = from_first_camera(T_world_cam_est)[:, :3, :3]
    return so3.log(C_true @ np.swapaxes(C_est, -1, -2))


def armse(errors: FloatArray) -> float:
    """Average over frames of the root mean square over axes, mean_k √(‖e_k‖²/3) (PROBE, Table I);
    errors [K, 3]."""
    return float(np.mean(np.linalg.norm(errors, axis=1)) / np.sqrt(3.0))


def ate_rmse(
    T_world_cam_est: FloatArray, T_world_cam_true: FloatArray, *, align: bool = True
) -> float:
    """Absolute trajectory error, RMS over positions, m: after the best rigid fit, or with first
    cameras made equal."""
    if not align:
        return _rms(position_errors(T_world_cam_est, T_world_cam_true))
    p_est = T_world_cam_est[:, :3, 3]
    p_true = T_world_cam_true[:, :3, 3]
    T_true_est = rigid_alignment(p_est, p_true)
    return _rms(p_est @ T_true_est[:3, :3].T + T_true_est[:3, 3] - p_true)


def rigid_alignment(points_a: FloatArray, points_b: FloatArray) -> FloatArray:
    """T_b_a, [4, 4], that takes points_a [K, 3] to points_b [K, 3] with least squared error
    (Umeyama 1991).

    Points on a line or in one place leave the rotation about them open; one of the minimisers is
    returned.
    """
    center_a = points_a.mean(axis=0)
    center_b = points_b.mean(axis=0)
    U, _, Vt = np.linalg.svd((points_b - center_b).mT @ (points_a - center_a))
    U[:, 2] *= np.linalg.det(U @ Vt)
    C_b_a = U @ Vt
    return se3.from_parts(C_b_a, center_b - C_b_a @ center_a)


def rpe_rmse(
    T_world_cam_est: FloatArray, T_world_cam_true: FloatArray
) -> tuple[float, float] | None:
    """Relative pose error frame to frame (Sturm et al. 2012, as evo): RMS of its translation, m,
    and of its angle, deg.

    Only steps with truth at both ends count. The truth of KITTI is itself noisy from frame to
    frame, more so than good stereo odometry, so that this measures the truth as much as the
    estimate.
    """
    motion_true = relative_motions(T_world_cam_true)
    known = np.isfinite(motion_true).all(axis=(1, 2))
    if not known.any():
        return None
    error = motion_true[known] @ se3.inverse(relative_motions(T_world_cam_est)[known])
    return _rms(error[:, :3, 3]), float(np.rad2deg(_rms(so3.log(error[:, :3, :3]))))


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))
