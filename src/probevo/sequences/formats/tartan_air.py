"""TartanAir, versions 1 and 2: the front cameras of a trajectory.

Wang et al., "TartanAir: a dataset to push the limits of visual SLAM", IROS 2020. The camera is the
same in all trajectories of a version, and no file has it.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.format_options import SIMULATED_RATE_HZ, rate_note
from probevo.sequences.frame import GroundTruth
from probevo.sequences.images import list_images
from probevo.sequences.poses import ground_truth
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamps import evenly_spaced
from probevo.sequences.text import read_table

C_NED_CAM = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""Camera axes right, down, forward to the axes of the poses: forward, right, down."""
NUMBER = re.compile("[0-9]+")


@dataclass(frozen=True)
class Version:
    """What differs between the versions."""

    left: str
    """Folder of the left images."""
    right: str
    poses: str
    """File of the true poses of the left camera."""
    camera: StereoCamera


VERSIONS = (
    Version(
        left="image_left",
        right="image_right",
        poses="pose_left.txt",
        camera=StereoCamera(
            fu_px=320.0, fv_px=320.0, cu_px=320.0, cv_px=240.0, baseline_m=0.25, size_px=(640, 480)
        ),
    ),
    Version(
        left="image_lcam_front",
        right="image_rcam_front",
        poses="pose_lcam_front.txt",
        camera=StereoCamera(
            fu_px=320.0, fv_px=320.0, cu_px=320.0, cv_px=320.0, baseline_m=0.25, size_px=(640, 640)
        ),
    ),
)


def open_tartan_air(path: Path, *, rate_hz: float | None = None) -> StereoRecording:
    """Open the front cameras of a trajectory, such as ``P000``.

    Its IMU is not read.

    Args:
        path: the folder of the trajectory.
        rate_hz: frames a second; by default 10, which is that of version 2. No file has the times
            of the images.

    Raises:
        InputError: images or their partners are missing, or the poses are faulty.
    """
    version = next((known for known in VERSIONS if (path / known.left).is_dir()), None)
    if version is None:
        what = f"it has neither {' nor '.join(known.left for known in VERSIONS)}."
        raise InputError(path, what, "Give the folder of one trajectory, such as P000.")
    left_files = _images_by_number(path / version.left)
    right_files = _images_by_number(path / version.right)
    missing = sorted(left_files.keys() ^ right_files.keys())
    if missing:
        side = version.right if missing[0] in left_files else version.left
        what = f"the image of number {missing[0]} is missing."
        raise InputError(path / side, what, "Left and right images have the same numbers.")
    stamps_ns = evenly_spaced(len(left_files), rate_hz or SIMULATED_RATE_HZ)
    poses = path / version.poses
    note = rate_note(rate_hz)
    return StereoRecording(
        path=path,
        format="tartanair",
        camera=version.camera,
        stamps_ns=stamps_ns,
        left_files=[left_files[number] for number in sorted(left_files)],
        right_files=[right_files[number] for number in sorted(left_files)],
        truth=_read_truth(poses, len(left_files), rate_hz) if poses.exists() else None,
        notes=(("times", note),),
    )


def _images_by_number(folder: Path) -> dict[int, Path]:
    """List the images of a folder by the number that their names begin with.

    Raises:
        InputError: the folder is missing or empty, a name has no number, or two have the same.
    """
    images: dict[int, Path] = {}
    for file in list_images(folder):
        number = NUMBER.match(file.name)
        if number is None or int(number[0]) in images:
            raise InputError(file, "its number is missing, or that of another image.")
        images[int(number[0])] = file
    return images


def _read_truth(path: Path, count: int, rate_hz: float | None) -> GroundTruth:
    """Read the poses of the left camera: lines of ``tx ty tz qx qy qz qw``, axes as an aircraft's.

    Raises:
        InputError: the file is faulty, or has another number of poses than there are images.
    """
    rows = read_table(path, 7)
    if len(rows) != count:
        raise InputError(path, f"{len(rows)} poses for {count} frames.", "Copy the file anew.")
    if not (np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) < 1e-3).all():
        raise InputError(path, "a quaternion is not of unit length.", "Order: x, y, z, w.")
    T_world_ned = se3.from_parts(Rotation.from_quat(rows[:, 3:]).as_matrix(), rows[:, :3])
    T_ned_cam = se3.from_parts(C_NED_CAM, np.zeros(3))
    stamps_ns = evenly_spaced(count, rate_hz or SIMULATED_RATE_HZ)
    return ground_truth(stamps_ns, T_world_ned @ T_ned_cam, path)
