"""4Seasons: a recording with its rectified images, and the ``calibration`` beside it.

Wenzel et al., "4Seasons: a cross-season dataset for multi-weather SLAM in autonomous driving",
GCPR 2020; the files are those of its documentation.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError, brief
from probevo.geometry import se3, so3
from probevo.sequences.calibrations.rectified_pair import PinholeIntrinsics, rectified_camera
from probevo.sequences.calibrations.stereo_calibration import mems_imu
from probevo.sequences.frame import GroundTruth
from probevo.sequences.images import list_images
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.poses import ground_truth, interpolate_poses
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamp_pairs import pair_stamps
from probevo.sequences.stamps import check_stamps, stamps_of_names
from probevo.sequences.text import (
    parse_floats,
    parse_stamp_ns,
    read_fields,
    read_lines,
    read_table,
    read_text,
)

IMAGES = "undistorted_images"
POSE_OF_IMU = "TS_cam_imu"
"""Entry of ``Transformations.txt``: from the IMU to the left camera."""
LONGEST_QUATERNION_ERROR = 1e-3
"""Largest error of the length of a quaternion, which the files round to six decimals."""


def open_four_seasons(path: Path) -> StereoRecording:
    """Open the undistorted images, which are rectified, and IMU and ground truth if present.

    Frames have the stamps in their names. The truth is that of ``GNSSPoses.txt``, whose keyframes
    are interpolated.

    Args:
        path: the folder of a recording; ``calibration`` lies in it, or beside it.

    Raises:
        InputError: a file is missing or faulty, or only distorted images are there.
    """
    if not (path / IMAGES).is_dir():
        what = f"the folder {IMAGES} is missing."
        cure = (
            "Unpack the undistorted images of this recording here. The distorted ones can be read"
            " as left/ and right/ of a folder, with --calibration camchain.yaml."
        )
        raise InputError(path, what, cure)
    stamps_ns, left_files, right_files, notes = _pairs(path / IMAGES)
    imu, imu_stream = _read_imu(path, stamps_ns)
    return StereoRecording(
        path=path,
        format="4seasons",
        camera=_read_camera(_calibration_folder(path)),
        stamps_ns=stamps_ns,
        left_files=left_files,
        right_files=right_files,
        imu=imu,
        imu_stream=imu_stream,
        truth=_read_truth(path / "GNSSPoses.txt", stamps_ns),
        notes=notes,
    )


def _calibration_folder(path: Path) -> Path:
    """Find the folder of the calibration.

    Raises:
        InputError: it is neither in the recording nor beside it.
    """
    beside = path.resolve().parent
    for folder in (path / "calibration", beside / "calibration", beside.parent / "calibration"):
        if folder.is_dir():
            return folder
    what = "the folder calibration is neither in this recording nor beside it."
    raise InputError(path, what, "Unpack calibration.zip of 4Seasons beside the recording.")


def _read_camera(folder: Path) -> StereoCamera:
    """Read the rectified pair.

    The documentation calls the matrix of ``undistorted_calib_stereo.txt`` the transform from the
    right to the left camera; in the files it is that from left to right, with a negative x. Either
    is taken: cam0 is the left one.

    Raises:
        InputError: a file is missing or faulty, or the pair is not rectified.
    """
    left, size_px = _read_intrinsics(folder / "undistorted_calib_0.txt")
    right, _ = _read_intrinsics(folder / "undistorted_calib_1.txt")
    stereo = folder / "undistorted_calib_stereo.txt"
    rows = read_table(stereo, 4)
    if len(rows) < 3:
        raise InputError(stereo, f"{len(rows)} rows of four numbers; at least 3 are needed.")
    C_right_left = so3.check_rotation(rows[:3, :3], stereo)
    T_right_left = se3.from_parts(C_right_left, rows[:3, 3])
    if T_right_left[0, 3] > 0.0:
        T_right_left = se3.inverse(T_right_left)
    return rectified_camera(left, right, T_right_left, size_px=size_px, where=stereo)


def _read_intrinsics(path: Path) -> tuple[PinholeIntrinsics, tuple[int, int]]:
    """Read ``Pinhole fx fy cx cy`` with distortions of zero, and the size on the next line.

    Raises:
        InputError: it is another model, or a number is missing.
    """
    lines = read_lines(path, "It is part of calibration.zip of 4Seasons.")
    if len(lines) < 2:
        raise InputError(path, "the size of the images is missing on its second line.")
    where, line = lines[0]
    model, *texts = line.split()
    if model != "Pinhole" or len(texts) < 4:
        what = f"its first line is {brief(line)}."
        raise InputError(where, what, "Expected Pinhole fx fy cx cy.")
    numbers = parse_floats(texts, where)
    if any(numbers[4:]):
        raise InputError(where, "the undistorted camera has a distortion.", "Expected zeros.")
    size_where, size_line = lines[1]
    size = parse_floats(size_line.split(), size_where)
    if len(size) != 2 or not all(1.0 <= value <= 1e5 and value == int(value) for value in size):
        raise InputError(size_where, f"the size is {brief(size_line)}.", "Expected width height.")
    return PinholeIntrinsics(*numbers[:4]), (int(size[0]), int(size[1]))


def _pairs(
    folder: Path,
) -> tuple[IntArray, list[Path], list[Path], tuple[tuple[str, str], ...]]:
    """Pair the images of cam0 and cam1 by their names, which are stamps in ns.

    Returns:
        Stamps of the frames, left and right files, and a note on images without a partner.

    Raises:
        InputError: names are no stamps, or less than half of the images have a partner.
    """
    left = list_images(folder / "cam0")
    right = list_images(folder / "cam1")
    left_ns = stamps_of_names(left)
    right_ns = stamps_of_names(right)
    if left_ns is None or right_ns is None:
        what = "the names of its images are not stamps in ns."
        raise InputError(folder, what, "Expected cam0/1585157782199447626.png and so on.")
    pairs = pair_stamps(left_ns, right_ns, 0)
    if 2 * len(pairs) < max(len(left), len(right)):
        what = f"only {len(pairs)} of {len(left)} and {len(right)} images have a partner."
        raise InputError(folder, what, "Left and right images have the same names.")
    notes: tuple[tuple[str, str], ...] = ()
    unpaired = len(left) + len(right) - 2 * len(pairs)
    if unpaired:
        notes = (("! pairs", f"{len(pairs)}; {unpaired} images are without a partner"),)
    return (
        check_stamps(left_ns[pairs.left], folder / "cam0"),
        [left[index] for index in pairs.left],
        [right[index] for index in pairs.right],
        notes,
    )


def _read_imu(path: Path, frames_ns: IntArray) -> tuple[ImuCalibration | None, ImuStream | None]:
    """Read the IMU; None without its samples, or without its pose.

    Raises:
        InputError: a file is faulty.
    """
    samples = path / "imu.txt"
    transformations = path / "Transformations.txt"
    if not samples.exists() or not transformations.exists():
        return None, None
    T_cam_imu = _read_transformation(transformations, POSE_OF_IMU)
    rows = read_fields(samples, 7)
    stamps_ns = np.array([parse_stamp_ns(fields[0], where) for where, fields in rows])
    values = np.array([parse_floats(fields[1:], where) for where, fields in rows])
    stream = ImuStream.checked(
        stamps_ns=stamps_ns,
        gyro_rad_s=values[:, :3],
        accel_m_s2=values[:, 3:],
        frames_ns=frames_ns,
        where=samples,
    )
    return mems_imu(T_cam_imu), stream


def _read_transformation(path: Path, name: str) -> FloatArray:
    """Read one pose of ``Transformations.txt``, whose names are comments above them, [4, 4].

    Raises:
        InputError: there is no transformation of this name, or it is no pose.
    """
    lines = read_text(path).splitlines()
    for number, line in enumerate(lines[:-1], start=1):
        if line.lstrip("# ").startswith(name):
            where = f"{path}:{number + 1}"
            row = parse_floats(lines[number].split(","), where)
            transform: FloatArray = _poses([row], where)[0]
            return transform
    raise InputError(path, f"the transform {name} is missing.", "Copy the file anew.")


def _read_truth(path: Path, stamps_ns: IntArray) -> GroundTruth | None:
    """Read the poses of the keyframes; None without the file.

    Positions are to be multiplied by the scale behind them, from odometry to GNSS.

    Raises:
        InputError: the file is faulty, or knows no pose of the frames.
    """
    if not path.exists():
        return None
    keyframes_ns = []
    rows = []
    for where, line in read_lines(path):
        texts = line.split(",")
        if len(texts) < 9:
            what = f"this line has {len(texts)} values; expected 9 or more, with commas."
            raise InputError(where, what)
        keyframes_ns.append(parse_stamp_ns(texts[0], where))
        rows.append(parse_floats(texts[1:9], where))
    numbers = np.array(rows)
    T_world_cam = _poses(numbers[:, :7], path)
    T_world_cam[:, :3, 3] *= numbers[:, 7:]
    poses_ns = check_stamps(np.array(keyframes_ns, dtype=np.int64), path)
    if len(poses_ns) < 2:
        raise InputError(path, f"{len(poses_ns)} poses; at least 2 are needed.")
    return ground_truth(stamps_ns, interpolate_poses(poses_ns, T_world_cam, stamps_ns), path)


def _poses(rows: FloatArray | list[list[float]], where: str | Path) -> FloatArray:
    """Make poses, [N, 4, 4], of rows of translation and quaternion (x, y, z, w).

    Raises:
        InputError: a row has another length, or a quaternion is not of unit length.
    """
    numbers = np.atleast_2d(np.asarray(rows, dtype=np.float64))
    if numbers.shape[1] != 7:
        raise InputError(where, f"{numbers.shape[1]} values; expected 7, with commas.")
    lengths = np.linalg.norm(numbers[:, 3:], axis=1)
    if not (np.abs(lengths - 1.0) < LONGEST_QUATERNION_ERROR).all():
        raise InputError(where, "a quaternion is not of unit length.", "Order: x, y, z, w.")
    return se3.from_parts(Rotation.from_quat(numbers[:, 3:]).as_matrix(), numbers[:, :3])
