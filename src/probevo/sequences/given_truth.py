"""True poses that the user names: a TUM file, of the camera or of the IMU."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.frame import GroundTruth
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.pose_files import read_tum
from probevo.sequences.poses import ground_truth, interpolate_poses

CAMERA = "camera"
IMU = "imu"
FRAMES = (CAMERA, IMU)


def truth_of_file(
    path: Path, stamps_ns: IntArray, *, truth_of: str | None, imu: ImuCalibration | None
) -> GroundTruth:
    """Read the truth of the frames from a TUM file, whose poses are interpolated by their stamps.

    Args:
        path: the file.
        stamps_ns: times of the frames, [K].
        truth_of: whose poses the file has, ``camera`` (rectified, left; the default) or ``imu``.
        imu: calibration of the IMU; None if there is none.

    Raises:
        InputError: the file is faulty, its poses are of something else, or they cover no frame.
    """
    T_body_cam = np.eye(4)
    if truth_of == IMU:
        T_body_cam = imu_from_camera(imu, path)
    elif truth_of not in (None, CAMERA):
        cure = f"Of a file they may be those of {' or '.join(FRAMES)}."
        raise InputError("--truth-of", f"{truth_of!r} is not known.", cure)
    poses_ns, T_world_body = read_tum(path)
    return truth_at(stamps_ns, poses_ns, T_world_body @ T_body_cam, where=path)


def imu_from_camera(imu: ImuCalibration | None, where: str | Path) -> FloatArray:
    """Return T_imu_cam, [4, 4], m.

    Raises:
        InputError: the recording has no IMU whose pose in the camera's frame is known.
    """
    if imu is None:
        what = "its poses are those of the IMU, whose place in the camera's frame is not known."
        cure = "Give a calibration with T_cam_imu by --calibration, or poses of the camera."
        raise InputError(where, what, cure)
    return se3.inverse(imu.T_cam_imu)


def truth_at(
    stamps_ns: IntArray, poses_ns: IntArray, T_world_cam: FloatArray, *, where: str | Path
) -> GroundTruth:
    """Interpolate true poses to the frames.

    Args:
        stamps_ns: times of the frames, [K].
        poses_ns: times of the poses, [M], strictly ascending.
        T_world_cam: the poses, [M, 4, 4], m.
        where: where they come from, for messages.

    Raises:
        InputError: there are fewer than two poses, or none at the times of the frames.
    """
    if len(poses_ns) < 2:
        raise InputError(where, f"{len(poses_ns)} true poses; at least 2 are needed.")
    return ground_truth(stamps_ns, interpolate_poses(poses_ns, T_world_cam, stamps_ns), where)
