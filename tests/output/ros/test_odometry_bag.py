"""The odometry as a bag: rosbags and evo read back what was written."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rosbags")

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.output.ros.bag_writer import written_bag
from probevo.output.ros.odometry_bag import write_odometry_bag
from probevo.output.ros.ros_odometry import ros_odometry
from probevo.output.run_result import RunResult
from probevo.run_config import RosSettings

ROS = RosSettings(odom_frame="map", base_frame="rover", camera_frame="left_optical")
CAMERA = StereoCamera(700.0, 701.0, 320.0, cv_px=240.0, baseline_m=0.12, size_px=(640, 480))


def read(path: Path) -> dict[str, list[Any]]:
    """Return the messages of a bag by topic."""
    messages: dict[str, list[Any]] = {}
    default = get_typestore(Stores.ROS2_HUMBLE)
    with AnyReader([path], default_typestore=default) as reader:
        for connection, _, data in reader.messages():
            message = reader.deserialize(data, connection.msgtype)
            messages.setdefault(connection.topic, []).append(message)
    return messages


def vector(value: Any) -> list[float]:
    return [value.x, value.y, value.z]


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_odometry_is_read_back(
    suffix: str, tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    run = make_run(45)
    path = tmp_path / f"odometry{suffix}"
    write_odometry_bag(path, run, ROS, camera=CAMERA)
    assert [each.name for each in tmp_path.iterdir()] == [path.name]
    messages = read(path)
    expected = ros_odometry(run, np.reshape(ROS.T_base_cam, (4, 4)))
    assert len(messages["/odometry"]) == len(messages["/tf"]) == len(run)
    for k, message in enumerate(messages["/odometry"]):
        stamp = message.header.stamp
        assert stamp.sec * 10**9 + stamp.nanosec == run.stamps_ns[k]
        assert (message.header.frame_id, message.child_frame_id) == ("map", "rover")
        pose = message.pose.pose
        q = pose.orientation
        C = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        np.testing.assert_allclose(C, expected.T_odom_base[k, :3, :3], atol=1e-12)
        np.testing.assert_array_equal(vector(pose.position), expected.T_odom_base[k, :3, 3])
        cov = message.pose.covariance.reshape(6, 6)
        np.testing.assert_array_equal(cov, expected.pose_cov[k])
        twist = message.twist.twist
        np.testing.assert_array_equal(
            [*vector(twist.linear), *vector(twist.angular)], expected.twist[k]
        )
        cov = message.twist.covariance.reshape(6, 6)
        np.testing.assert_array_equal(cov, expected.twist_cov[k])
        (moved,) = messages["/tf"][k].transforms
        assert vector(moved.transform.translation) == vector(pose.position)


T_BASE_CAM = np.array(
    [
        [0.6, 0.0, 0.8, 1.5],
        [-0.8, 0.0, 0.6, -0.25],
        [0.0, -1.0, 0.0, 2.0],
        [0.0, 0.0, 0.0, 1.0],
    ]
)
"""A camera 1.5 m ahead, 0.25 m to the right and 2 m above the base, which looks to the left by the
angle whose cosine is 0.8."""
ADJOINT = np.array(
    [
        [0.6, 0.0, 0.8, 1.6, 0.25, -1.2],
        [-0.8, 0.0, 0.6, 1.2, 1.5, 1.6],
        [0.0, -1.0, 0.0, -1.05, 0.0, 1.1],
        [0.0, 0.0, 0.0, 0.6, 0.0, 0.8],
        [0.0, 0.0, 0.0, -0.8, 0.0, 0.6],
        [0.0, 0.0, 0.0, 0.0, -1.0, 0.0],
    ]
)
"""Of ``T_BASE_CAM``, by hand: [[C, t× C], [0, C]], with t× = [[0, −2, −0.25], [2, 0, −1.5],
[0.25, 1.5, 0]]. It takes [ρ; φ] of the camera (right, down, forward) to those of the base (forward,
left, up)."""


def with_covariances(run: RunResult, T_curr_prev: FloatArray | None = None) -> RunResult:
    """Return the run with a covariance of its own for each step, errors independent."""
    if T_curr_prev is None:
        T_curr_prev = run.T_curr_prev
    roots = np.random.default_rng(0).normal(0.0, 0.01, (*T_curr_prev.shape[:1], 6, 6))
    poses = [np.eye(4)]
    for motion in T_curr_prev:
        poses.append(poses[-1] @ np.linalg.inv(motion))
    return replace(
        run,
        T_curr_prev=T_curr_prev,
        T_world_cam=np.array(poses),
        cov=roots @ roots.mT,
        common_mode=np.zeros_like(run.common_mode),
        path_cross_cov=np.zeros_like(run.path_cross_cov),
    )


def twice(C: FloatArray, upper: FloatArray | None = None) -> FloatArray:
    """Return [[C, upper], [0, C]]."""
    return np.block([[C, np.zeros((3, 3)) if upper is None else upper], [np.zeros((3, 3)), C]])


def covariance(message: Any) -> FloatArray:
    return np.asarray(message.covariance, float).reshape(6, 6)


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_poses_that_are_read_back_are_those_of_the_run_by_an_adjoint_written_out_by_hand(
    suffix: str, tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    """Nothing here but the writer is from probevo: matrices are inverted and multiplied."""
    run = with_covariances(make_run(12))
    path = tmp_path / f"odometry{suffix}"
    ros = ROS.model_copy(update={"T_base_cam": tuple(T_BASE_CAM.ravel().tolist())})
    write_odometry_bag(path, run, ros)
    path_cov = np.zeros((6, 6))
    for k, message in enumerate(read(path)["/odometry"]):
        T = T_BASE_CAM @ run.T_world_cam[k] @ np.linalg.inv(T_BASE_CAM)
        pose = message.pose.pose
        q = pose.orientation
        np.testing.assert_allclose(vector(pose.position), T[:3, 3], rtol=0.0, atol=1e-12)
        C_odom_base = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
        np.testing.assert_allclose(C_odom_base, T[:3, :3], rtol=0.0, atol=1e-12)
        if k > 0:
            # The covariance of the path, in the frame of the camera k, by its definition.
            C, t = run.T_curr_prev[k - 1, :3, :3], run.T_curr_prev[k - 1, :3, 3]
            cross = np.array([[0.0, -t[2], t[1]], [t[2], 0.0, -t[0]], [-t[1], t[0], 0.0]])
            onward = twice(C, cross @ C)
            path_cov = onward @ path_cov @ onward.T + run.cov[k - 1]
        turned = twice(C_odom_base) @ ADJOINT
        expected = turned @ path_cov @ turned.T
        atol = 1e-12 * np.abs(expected).max()
        np.testing.assert_allclose(covariance(message.pose), expected, rtol=0.0, atol=atol)


def test_twists_that_are_read_back_are_those_of_the_motions_by_an_adjoint_written_out_by_hand(
    tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    """Straight ahead by 1 m a step, so that the base moves by (0.8, 0.6, 0) m. The inverse right
    Jacobian of SE(3) is then [[I, ρ×/2], [0, I]]."""
    run = make_run(6)
    T_curr_prev = np.repeat(np.eye(4)[None], len(run) - 1, 0)
    T_curr_prev[:, 2, 3] = -1.0
    run = with_covariances(run, T_curr_prev)
    ros = ROS.model_copy(update={"T_base_cam": tuple(T_BASE_CAM.ravel().tolist())})
    write_odometry_bag(tmp_path / "odometry.mcap", run, ros)
    half_cross = np.array([[0.0, 0.0, 0.3], [0.0, 0.0, -0.4], [-0.3, 0.4, 0.0]])
    duration_s = 1e-9 * np.diff(run.stamps_ns)
    to_twist = twice(np.eye(3), half_cross) @ ADJOINT
    for k, message in enumerate(read(tmp_path / "odometry.mcap")["/odometry"][1:]):
        twist = message.twist.twist
        expected = np.array([0.8, 0.6, 0.0]) / duration_s[k]
        np.testing.assert_allclose(vector(twist.linear), expected, rtol=0.0, atol=1e-12)
        np.testing.assert_allclose(vector(twist.angular), np.zeros(3), rtol=0.0, atol=1e-12)
        cov = to_twist @ run.cov[k] @ to_twist.T / duration_s[k] ** 2
        atol = 1e-12 * np.abs(cov).max()
        np.testing.assert_allclose(covariance(message.twist), cov, rtol=0.0, atol=atol)


def test_status_mounting_and_camera_are_read_back(
    tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    run = make_run(45)
    write_odometry_bag(tmp_path / "odometry.mcap", run, ROS, camera=CAMERA)
    messages = read(tmp_path / "odometry.mcap")
    statuses = [each.status[0] for each in messages["/diagnostics"]]
    assert [each.message for each in statuses[:2]] == ["FIRST", "OK"]
    assert [k for k, each in enumerate(statuses) if each.level != 0] == [39]
    assert statuses[39].message == "GAP"
    assert {each.key: each.value for each in statuses[1].values}["num_tracks"] == str(
        run.num_tracks[0]
    )
    (mounting,) = messages["/tf_static"][0].transforms
    assert (mounting.header.frame_id, mounting.child_frame_id) == ("rover", "left_optical")
    right = messages["/right/camera_info"][0]
    assert -right.p[3] / right.p[0] == CAMERA.baseline_m
    assert (right.width, right.height) == CAMERA.size_px


def read_by_evo(path: Path, topic: str) -> FloatArray:
    """Read the poses of a topic as evo does, [N, 4, 4]."""
    file_interface = pytest.importorskip("evo.tools.file_interface")
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2 import Reader as Ros2Reader

    with Ros1Reader(path) if path.suffix == ".bag" else Ros2Reader(path) as reader:
        return np.array(file_interface.read_bag_trajectory(reader, topic).poses_se3)


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_evo_reads_the_trajectory(
    suffix: str, tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    run = make_run(20)
    path = tmp_path / f"odometry{suffix}"
    write_odometry_bag(path, run, ROS)
    expected = ros_odometry(run, np.reshape(ROS.T_base_cam, (4, 4)))
    np.testing.assert_allclose(read_by_evo(path, "/odometry"), expected.T_odom_base, atol=1e-12)


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_live_and_smoothed_poses_are_apart(
    suffix: str, tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    run = make_run(20)
    later = run.T_world_cam.copy()
    later[1:, 0, 3] += 0.01
    path = tmp_path / f"odometry{suffix}"
    write_odometry_bag(path, replace(run, smoothed=later), ROS)
    T_base_cam = np.reshape(ROS.T_base_cam, (4, 4))
    for topic, T_world_cam in (("/odometry", run.T_world_cam), ("/smoothed/pose", later)):
        expected = T_base_cam @ T_world_cam @ np.linalg.inv(T_base_cam)
        np.testing.assert_allclose(read_by_evo(path, topic), expected, atol=1e-12)


def test_smoothed_poses_have_the_covariance_of_live_ones_that_are_alike(
    tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    run = make_run(20)
    path = tmp_path / "odometry.mcap"
    run = with_covariances(run)
    alike = replace(run, smoothed=run.T_world_cam, smoothed_cov=run.drift_covariances_from(0))
    write_odometry_bag(path, alike, ROS)
    messages = read(path)
    for smoothed, live in zip(messages["/smoothed/pose"], messages["/odometry"], strict=True):
        np.testing.assert_allclose(
            covariance(smoothed.pose), covariance(live.pose), rtol=1e-9, atol=1e-15
        )
    assert covariance(live.pose).any()


def test_a_stamp_before_1970_is_refused(tmp_path: Path, make_run: Callable[..., RunResult]) -> None:
    run = make_run(3)
    run = replace(run, stamps_ns=run.stamps_ns - 2 * 10**18)
    with pytest.raises(InputError, match="cannot be written as a time of ROS"):
        write_odometry_bag(tmp_path / "odometry.mcap", run, ROS)
    assert not list(tmp_path.iterdir())


def test_another_ending_is_refused(tmp_path: Path, make_run: Callable[..., RunResult]) -> None:
    with pytest.raises(InputError, match=r"ends in none of \.bag, \.mcap, \.db3"):
        write_odometry_bag(tmp_path / "odometry.txt", make_run(3), ROS)


@pytest.mark.parametrize("suffix", [".bag", ".mcap", ".db3"])
def test_only_the_odometry_of_an_earlier_run_is_replaced(
    suffix: str, tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    run = make_run(3)
    path = tmp_path / f"odometry{suffix}"
    write_odometry_bag(path, make_run(20), ROS)
    write_odometry_bag(path, replace(run, smoothed=run.T_world_cam), ROS, camera=CAMERA)
    assert len(read(path)["/odometry"]) == 3
    write_odometry_bag(path, run, ROS)
    for content in (b"", path.read_bytes()[:100], b"no bag at all"):
        path.write_bytes(content)
        with pytest.raises(InputError, match="exists, and is no bag that can be read"):
            write_odometry_bag(path, run, ROS)
        assert path.read_bytes() == content


def test_a_bag_with_other_topics_is_not_replaced(
    tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    path = tmp_path / "imu.mcap"
    with written_bag(path) as bag:
        bag.write("/imu/data", "sensor_msgs/msg/Imu", 1, {}, frame="imu_link")
    before = path.read_bytes()
    with pytest.raises(InputError, match="not the odometry of a run: it has the topic /imu/data"):
        write_odometry_bag(path, make_run(3), ROS)
    assert path.read_bytes() == before
