"""Poses, velocities and covariances in the frames of ROS, against definitions and by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from probevo.arrays import FloatArray
from probevo.evaluation.consistency import drift_covariances
from probevo.geometry import se3, so3
from probevo.output.ros.ros_odometry import UNKNOWN_VARIANCE, ros_odometry
from probevo.output.run_result import RunResult
from probevo.run_config import RosSettings

T_BASE_CAM = np.reshape(RosSettings().T_base_cam, (4, 4))
MOUNTED = se3.exp(np.array([0.4, -0.2, 0.9, 0.0, 0.1, -0.05])) @ T_BASE_CAM
"""A camera that looks a little down and to the side, away from the origin of the base."""


def path_covariance(run: RunResult) -> FloatArray:
    return drift_covariances(
        run.T_curr_prev, run.cov, run.common_mode, path_cross_cov=run.path_cross_cov
    )


def test_a_camera_that_drives_ahead_is_a_base_that_drives_along_x(
    make_run: Callable[..., RunResult],
) -> None:
    odometry = ros_odometry(make_run(3), T_BASE_CAM)
    np.testing.assert_allclose(odometry.T_odom_base[0], np.eye(4), atol=1e-15)
    forward, left, up = odometry.T_odom_base[1, :3, 3]
    assert forward > 0.9
    assert abs(left) < 0.05
    assert abs(up) < 0.05


def test_covariance_by_a_hand_computed_adjoint(make_run: Callable[..., RunResult]) -> None:
    """The camera is 2 m ahead of the base: a rotation of the camera moves the base sideways."""
    run = make_run(2)
    T_base_cam = T_BASE_CAM.copy()
    T_base_cam[0, 3] = 2.0
    # ξ in camera axes (right, down, forward) to base axes (forward, left, up). The base lies at
    # z = −2 of the camera, and moves by ρ + φ × (0, 0, −2) = ρ + (−2 φ_y, 2 φ_x, 0).
    by_hand = np.array(
        [
            [0.0, 0.0, 1.0, 0.0, 0.0, 0.0],
            [-1.0, 0.0, 0.0, 0.0, 2.0, 0.0],
            [0.0, -1.0, 0.0, -2.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, 0.0, 1.0],
            [0.0, 0.0, 0.0, -1.0, 0.0, 0.0],
            [0.0, 0.0, 0.0, 0.0, -1.0, 0.0],
        ]
    )
    np.testing.assert_allclose(se3.adjoint(T_base_cam), by_hand, atol=1e-15)
    odometry = ros_odometry(run, T_base_cam)
    C = odometry.T_odom_base[1, :3, :3]
    both = np.kron(np.eye(2), C)
    expected = both @ by_hand @ path_covariance(run)[1] @ by_hand.T @ both.T
    np.testing.assert_allclose(odometry.pose_cov[1], expected, rtol=1e-12, atol=1e-18)
    np.testing.assert_array_equal(odometry.pose_cov[0], np.zeros((6, 6)))


def test_pose_covariance_is_that_of_perturbed_paths(make_run: Callable[..., RunResult]) -> None:
    """Central differences of position and of the rotation about fixed axes, at each pose."""
    run = make_run(5)
    odometry = ros_odometry(run, MOUNTED)
    step = 1e-6 * np.eye(6)
    for k in range(1, 5):
        T_cam_world = se3.inverse(run.T_world_cam[k])
        ends = []
        for sign in (1.0, -1.0):
            T = MOUNTED @ se3.inverse(se3.exp(sign * step) @ T_cam_world) @ se3.inverse(MOUNTED)
            turn = so3.log(T[:, :3, :3] @ odometry.T_odom_base[k, :3, :3].T)
            ends.append(np.concatenate([T[:, :3, 3], turn], axis=1))
        J = (ends[0] - ends[1]).T / 2e-6
        expected = J @ path_covariance(run)[k] @ J.T
        scale = np.abs(expected).max()
        np.testing.assert_allclose(odometry.pose_cov[k], expected, atol=1e-7 * scale)


def test_twist_takes_the_base_from_one_pose_to_the_next(make_run: Callable[..., RunResult]) -> None:
    run = make_run(6)
    odometry = ros_odometry(run, MOUNTED)
    duration_s = 1e-9 * np.diff(run.stamps_ns)[:, None]
    moved = odometry.T_odom_base[:-1] @ se3.exp(odometry.twist[1:] * duration_s)
    np.testing.assert_allclose(moved, odometry.T_odom_base[1:], atol=1e-12)
    np.testing.assert_array_equal(odometry.twist[0], np.zeros(6))
    np.testing.assert_array_equal(odometry.twist_cov[0], UNKNOWN_VARIANCE * np.eye(6))


def test_twist_covariance_is_that_of_perturbed_motions(make_run: Callable[..., RunResult]) -> None:
    run = make_run(4)
    odometry = ros_odometry(run, MOUNTED)
    step = 1e-6 * np.eye(6)
    for k in range(3):
        duration_s = 1e-9 * float(run.stamps_ns[k + 1] - run.stamps_ns[k])
        ends = [
            se3.log(
                MOUNTED
                @ se3.inverse(se3.exp(sign * step) @ run.T_curr_prev[k])
                @ se3.inverse(MOUNTED)
            )
            / duration_s
            for sign in (1.0, -1.0)
        ]
        J = (ends[0] - ends[1]).T / 2e-6
        expected = J @ run.cov[k] @ J.T
        scale = np.abs(expected).max()
        np.testing.assert_allclose(odometry.twist_cov[k + 1], expected, atol=1e-7 * scale)
