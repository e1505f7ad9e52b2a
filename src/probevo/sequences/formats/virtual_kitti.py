"""Virtual KITTI 2: a variation of a scene, such as ``Scene01/clone``.

Cabon, Murray, Humenberger, "Virtual KITTI 2", arXiv 2001.10773, 2020.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.calibrations.rectified_pair import PinholeIntrinsics, rectified_camera
from probevo.sequences.format_options import SIMULATED_RATE_HZ, rate_note
from probevo.sequences.images import list_pairs, read_gray
from probevo.sequences.poses import ground_truth
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamps import evenly_spaced
from probevo.sequences.text import parse_floats, read_lines

CURE = "Unpack vkitti_2.0.3_textgt.tar over the folder of the images."


def open_virtual_kitti(path: Path, *, rate_hz: float | None = None) -> StereoRecording:
    """Open Camera_0 and Camera_1 of a variation of a scene.

    Args:
        path: the folder with ``frames``, ``intrinsic.txt`` and ``extrinsic.txt``.
        rate_hz: frames a second; by default 10, that of the drives of KITTI which it imitates. No
            file has times.

    Raises:
        InputError: a file is missing or faulty, the camera changes from frame to frame, or the
            counts of images and poses differ.
    """
    rgb = path / "frames" / "rgb"
    left_files, right_files = list_pairs(rgb / "Camera_0", rgb / "Camera_1")
    count = len(left_files)
    height, width = read_gray(left_files[0]).shape
    intrinsics = _read_table(path / "intrinsic.txt", 4, count)
    extrinsics = _read_table(path / "extrinsic.txt", 16, count).reshape(2, count, 4, 4)
    if (intrinsics != intrinsics[:, :1]).any():
        raise InputError(path / "intrinsic.txt", "the intrinsics change from frame to frame.")
    where = path / "extrinsic.txt"
    C_cam_world = so3.check_rotation(extrinsics[..., :3, :3].reshape(-1, 3, 3), where)
    T_cam_world = se3.from_parts(C_cam_world.reshape(2, count, 3, 3), extrinsics[..., :3, 3])
    T_right_left = T_cam_world[1] @ se3.inverse(T_cam_world[0])
    camera = rectified_camera(
        PinholeIntrinsics(*intrinsics[0, 0].tolist()),
        PinholeIntrinsics(*intrinsics[1, 0].tolist()),
        _mean_pose(T_right_left),
        size_px=(width, height),
        where=where,
    )
    rate = rate_hz or SIMULATED_RATE_HZ
    stamps_ns = evenly_spaced(count, rate)
    return StereoRecording(
        path=path,
        format="vkitti2",
        camera=camera,
        stamps_ns=stamps_ns,
        left_files=left_files,
        right_files=right_files,
        truth=ground_truth(stamps_ns, se3.inverse(T_cam_world[0]), where),
        notes=(("times", rate_note(rate_hz)),),
    )


def _mean_pose(T: FloatArray) -> FloatArray:
    """Average poses that differ by rounding only, [K, 4, 4] to [4, 4]."""
    first = T[0]
    return np.asarray(se3.exp(se3.log(T @ se3.inverse(first)).mean(axis=0)) @ first)


def _read_table(path: Path, columns: int, count: int) -> FloatArray:
    """Read lines of ``frame camera`` and numbers, below a header, [2, count, columns].

    Raises:
        InputError: the file is missing, a line is faulty, or a frame of a camera is missing.
    """
    header, *lines = read_lines(path, CURE)
    if not header[1].startswith("frame cameraID"):
        raise InputError(header[0], "this is not a header of Virtual KITTI 2.", "frame cameraID …")
    table = np.full((2, count, columns), np.nan)
    for where, line in lines:
        numbers = parse_floats(line.split(), where)
        if len(numbers) != columns + 2:
            what = f"this line has {len(numbers)} values; expected {columns + 2}."
            raise InputError(where, what)
        frame, side = numbers[:2]
        if frame not in range(count) or side not in (0, 1):
            what = f"frame {frame:g} of camera {side:g}; there are {count} images of 0 and 1."
            raise InputError(where, what, "Unpack all images of this scene.")
        table[int(side), int(frame)] = numbers[2:]
    missing = np.argwhere(np.isnan(table[..., 0]))
    if len(missing):
        side, frame = missing[0]
        raise InputError(path, f"frame {frame} of camera {side} is missing.", CURE)
    return table
