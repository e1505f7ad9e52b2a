"""Poses, velocities and covariances as ROS has them: nav_msgs/Odometry (REP-103, REP-105)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.geometry import se3
from probevo.output.run_result import RunResult

UNKNOWN_VARIANCE = 1e6
"""Variance, (m/s)² and (rad/s)², of the velocity at the first frame, which is not known."""


@dataclass(frozen=True)
class RosOdometry:
    """The odometry of N frames as nav_msgs/Odometry has it: position first, axes as its text says.

    The frame ``odom`` is ``base_link`` at the first frame.
    """

    stamps_ns: IntArray
    """Time of each frame, [N]."""
    T_odom_base: FloatArray
    """Pose of ``base_link``, [N, 4, 4], m."""
    pose_cov: FloatArray
    """Covariance of the position and of the rotation about the fixed axes, both along the axes of
    ``odom``, [N, 6, 6], m and rad; 0 at the first frame."""
    twist: FloatArray
    """Mean velocity since the previous frame, linear and angular, along the axes of ``base_link``,
    [N, 6], m/s and rad/s; 0 at the first frame."""
    twist_cov: FloatArray
    """Covariance of ``twist``, [N, 6, 6]."""


def ros_odometry(result: RunResult, T_base_cam: FloatArray) -> RosOdometry:
    """Convert a run to the frames and the order of ROS.

    probevo's covariance of the path is that of the left perturbation of T_cam_world, along the axes
    of each camera. In T_base_odom it becomes Ad(T_base_cam) Σ Ad(T_base_cam)ᵀ. The inverse,
    T_odom_base, is perturbed on the right by −ξ, so that its position moves by C_odom_base ρ and it
    turns about the axes of ``odom`` by C_odom_base φ. The velocity is Log(T_prev_curr) / Δt of
    ``base_link``, and its covariance follows by the inverse of the right Jacobian of SE(3).

    Args:
        result: a run over N ≥ 1 frames.
        T_base_cam: pose of the rectified left camera in ``base_link``, [4, 4], m.
    """
    T_cam_base = se3.inverse(T_base_cam)
    T_odom_base = T_odom_base_of(result.T_world_cam, T_base_cam)
    adjoint = se3.adjoint(T_base_cam)

    path_cov = result.drift_covariances_from(0)

    # The velocity of the body is constant during a step, so that both ends have the same.
    duration_s = 1e-9 * np.diff(result.stamps_ns)[:, None]
    T_prev_curr = T_base_cam @ se3.inverse(result.T_curr_prev) @ T_cam_base
    xi = se3.log(T_prev_curr)
    twist_jacobian = np.linalg.inv(se3.left_jacobian(-xi)) @ adjoint / duration_s[..., None]
    return RosOdometry(
        stamps_ns=result.stamps_ns,
        T_odom_base=T_odom_base,
        pose_cov=pose_cov_of(path_cov, T_odom_base, T_base_cam),
        twist=np.concatenate([np.zeros((1, 6)), xi / duration_s]),
        twist_cov=np.concatenate(
            [
                UNKNOWN_VARIANCE * np.eye(6)[None],
                _symmetric(twist_jacobian @ result.cov @ twist_jacobian.mT),
            ]
        ),
    )


def T_odom_base_of(T_world_cam: FloatArray, T_base_cam: FloatArray) -> FloatArray:
    """Return the poses of ``base_link``, [N, 4, 4], m, in its own frame at the first camera pose.

    Args:
        T_world_cam: poses of the rectified left camera, the first the identity, [N, 4, 4], m.
        T_base_cam: its pose in ``base_link``, [4, 4], m.
    """
    return np.asarray(T_base_cam @ T_world_cam @ se3.inverse(T_base_cam))


def pose_cov_of(
    path_cov: FloatArray, T_odom_base: FloatArray, T_base_cam: FloatArray
) -> FloatArray:
    """Return the covariances of poses as ROS has them (``RosOdometry.pose_cov``), [N, 6, 6].

    Args:
        path_cov: covariances of the left perturbations of T_cam_world, [N, 6, 6].
        T_odom_base: the poses, [N, 4, 4], m.
        T_base_cam: pose of the rectified left camera in ``base_link``, [4, 4], m.
    """
    turned = _block_diagonal(T_odom_base[:, :3, :3]) @ se3.adjoint(T_base_cam)
    return _symmetric(turned @ path_cov @ turned.mT)


def _block_diagonal(C: FloatArray) -> FloatArray:
    """Return matrices with the rotation twice on their diagonal, [N, 6, 6]."""
    matrix = np.zeros((len(C), 6, 6))
    matrix[:, :3, :3] = C
    matrix[:, 3:, 3:] = C
    return matrix


def _symmetric(cov: FloatArray) -> FloatArray:
    """Return covariances without the asymmetry of rounding."""
    return np.asarray(0.5 * (cov + cov.mT))
