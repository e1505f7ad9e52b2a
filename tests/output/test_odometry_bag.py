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

from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.output.odometry_bag import write_odometry_bag
from probevo.output.ros_odometry import ros_odometry
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


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_evo_reads_the_trajectory(
    suffix: str, tmp_path: Path, make_run: Callable[..., RunResult]
) -> None:
    file_interface = pytest.importorskip("evo.tools.file_interface")
    from rosbags.rosbag1 import Reader as Ros1Reader
    from rosbags.rosbag2 import Reader as Ros2Reader

    run = make_run(20)
    path = tmp_path / f"odometry{suffix}"
    write_odometry_bag(path, run, ROS)
    reader = Ros1Reader(path) if suffix == ".bag" else Ros2Reader(path)
    with reader:
        trajectory = file_interface.read_bag_trajectory(reader, "/odometry")
    expected = ros_odometry(run, np.reshape(ROS.T_base_cam, (4, 4)))
    np.testing.assert_allclose(trajectory.poses_se3, expected.T_odom_base, atol=1e-12)


def test_a_stamp_before_1970_is_refused(tmp_path: Path, make_run: Callable[..., RunResult]) -> None:
    run = make_run(3)
    run = replace(run, stamps_ns=run.stamps_ns - 2 * 10**18)
    with pytest.raises(InputError, match="cannot be written as a time of ROS"):
        write_odometry_bag(tmp_path / "odometry.mcap", run, ROS)
    assert not list(tmp_path.iterdir())


def test_another_ending_is_refused(tmp_path: Path, make_run: Callable[..., RunResult]) -> None:
    with pytest.raises(InputError, match=r"ends in none of \.bag, \.mcap, \.db3"):
        write_odometry_bag(tmp_path / "odometry.txt", make_run(3), ROS)
