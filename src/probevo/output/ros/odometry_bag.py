"""The odometry of a run as a bag: nav_msgs/Odometry, transforms, and the status of each step."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.estimation.motion_estimate import Status
from probevo.output.ros.bag_writer import BagWriter, check_bag_path, written_bag
from probevo.output.ros.ros_fields import (
    camera_info_fields,
    pose_fields,
    transform_fields,
    vector_fields,
)
from probevo.output.ros.ros_odometry import (
    RosOdometry,
    T_odom_base_of,
    pose_cov_of,
    ros_odometry,
)
from probevo.output.run_result import RunResult
from probevo.run_config import RosSettings
from probevo.sequences.formats.rosbag_file import opened_bag

ODOMETRY = "/odometry"
SMOOTHED = "/smoothed/pose"
DIAGNOSTICS = "/diagnostics"
CAMERA_INFO = ("/left/camera_info", "/right/camera_info")
TRANSFORMS = "/tf"
STATIC_TRANSFORMS = "/tf_static"
TOPICS = frozenset({ODOMETRY, SMOOTHED, DIAGNOSTICS, *CAMERA_INFO, TRANSFORMS, STATIC_TRANSFORMS})
"""All topics that the odometry of a run has."""
OK_LEVEL = 0
WARN_LEVEL = 1


def check_odometry_path(path: Path, option: str) -> None:
    """Refuse a path where no odometry can be written, before anything is computed.

    An existing file is replaced only if it is the odometry of an earlier run: any other bag may be
    a recording, even the one that is run.

    Args:
        path: the file that is to be written.
        option: the flag that names it, for messages.

    Raises:
        InputError: as ``check_bag_path``, or the file exists and is anything but an odometry.
    """
    check_bag_path(path, option)
    if not path.exists():
        return
    cure = "Name another file, or remove that one."
    try:
        with opened_bag(path) as bag:
            others = sorted(bag.topics.keys() - TOPICS)
    except InputError as error:
        raise InputError(option, f"{path} exists, and is no bag that can be read.", cure) from error
    if others:
        what = f"{path} exists, and is not the odometry of a run: it has the topic {others[0]}."
        raise InputError(option, what, cure)


def write_odometry_bag(
    path: Path, result: RunResult, ros: RosSettings, camera: StereoCamera | None = None
) -> None:
    """Write a run as a bag.

    Topics: ``/odometry`` (nav_msgs/Odometry with both covariances), ``/tf`` (``odom`` ←
    ``base_link``), ``/tf_static`` (``base_link`` ← left camera), ``/diagnostics`` (the status of
    each step), and once, if the camera is known, its ``camera_info``. All of these are live: a
    message knows nothing of later frames. With a window, the poses as later frames improved them
    are apart, in ``/smoothed/pose`` (geometry_msgs/PoseWithCovarianceStamped; a covariance of zeros
    is one that is not known).

    Args:
        path: a file .bag (ROS 1), .mcap or .db3 (ROS 2).
        result: the run.
        ros: names of the frames, and the pose of the camera in ``base_link``.
        camera: the rectified camera; None to leave out its CameraInfo.

    Raises:
        InputError: as ``check_odometry_path``, the file cannot be written, or a stamp does not fit
            into a message of ROS.
    """
    check_odometry_path(path, str(path))
    T_base_cam = np.reshape(ros.T_base_cam, (4, 4))
    odometry = ros_odometry(result, T_base_cam)
    start_ns = int(result.stamps_ns[0])
    with written_bag(path) as bag:
        mounting = transform_fields(
            T_base_cam, start_ns, parent=ros.base_frame, child=ros.camera_frame
        )
        bag.write_transforms(STATIC_TRANSFORMS, start_ns, [mounting])
        if camera is not None:
            for topic, is_right in zip(CAMERA_INFO, (False, True), strict=True):
                info = camera_info_fields(camera, is_right=is_right)
                bag.write(
                    topic, "sensor_msgs/msg/CameraInfo", start_ns, info, frame=ros.camera_frame
                )
        for index in range(len(result)):
            _write_frame(bag, index, result, odometry=odometry, ros=ros)
        if result.smoothed is not None:
            _write_smoothed(bag, result.stamps_ns, result.smoothed, result.smoothed_cov, ros=ros)


def _write_smoothed(
    bag: BagWriter,
    stamps_ns: IntArray,
    T_world_cam: FloatArray,
    cov: FloatArray | None,
    *,
    ros: RosSettings,
) -> None:
    """Add the poses of all frames as they left the window, [N, 4, 4], and their covariances."""
    T_base_cam = np.reshape(ros.T_base_cam, (4, 4))
    T_odom_base = T_odom_base_of(T_world_cam, T_base_cam)
    pose_cov = np.zeros((len(T_odom_base), 6, 6))
    if cov is not None:
        pose_cov = pose_cov_of(cov, T_odom_base, T_base_cam)
    for index, stamp_ns in enumerate(stamps_ns):
        pose = {"pose": pose_fields(T_odom_base[index]), "covariance": pose_cov[index]}
        bag.write(
            SMOOTHED,
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            int(stamp_ns),
            {"pose": pose},
            frame=ros.odom_frame,
        )


def _write_frame(
    bag: BagWriter, index: int, result: RunResult, *, odometry: RosOdometry, ros: RosSettings
) -> None:
    """Add the messages of one frame."""
    stamp_ns = int(odometry.stamps_ns[index])
    fields = {
        "child_frame_id": ros.base_frame,
        "pose": {
            "pose": pose_fields(odometry.T_odom_base[index]),
            "covariance": odometry.pose_cov[index],
        },
        "twist": {
            "twist": {
                "linear": vector_fields(odometry.twist[index, :3]),
                "angular": vector_fields(odometry.twist[index, 3:]),
            },
            "covariance": odometry.twist_cov[index],
        },
    }
    bag.write(ODOMETRY, "nav_msgs/msg/Odometry", stamp_ns, fields, frame=ros.odom_frame)
    transform = transform_fields(
        odometry.T_odom_base[index], stamp_ns, parent=ros.odom_frame, child=ros.base_frame
    )
    bag.write_transforms(TRANSFORMS, stamp_ns, [transform])
    diagnostics = {"status": [_status_fields(index, result)]}
    bag.write(DIAGNOSTICS, "diagnostic_msgs/msg/DiagnosticArray", stamp_ns, diagnostics, frame="")


def _status_fields(index: int, result: RunResult) -> dict[str, Any]:
    """Return the diagnostic_msgs/DiagnosticStatus of a frame: a warning where it is not OK."""
    step = index - 1
    status = Status.FIRST if step < 0 else Status(int(result.status[step]))
    values = {}
    if step >= 0:
        values = {
            "num_tracks": result.num_tracks[step],
            "num_inliers": result.num_inliers[step],
            "total_ms": result.total_ms[step],
        }
    return {
        "level": OK_LEVEL if status in (Status.FIRST, Status.OK) else WARN_LEVEL,
        "name": "probevo: odometry",
        "message": status.name,
        "hardware_id": "stereo camera",
        "values": [{"key": key, "value": str(value)} for key, value in values.items()],
    }
