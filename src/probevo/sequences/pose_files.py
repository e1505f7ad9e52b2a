"""Poses in the text formats of KITTI and TUM, read and written.

Every error names the file, and the line or the pose. Numbers are written at full precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.frame import GroundTruth
from probevo.sequences.poses import check_poses, ground_truth
from probevo.sequences.stamps import check_stamps, seconds_to_ns
from probevo.sequences.text import parse_floats, read_fields, read_table
from probevo.storage.files import write_atomically

FARTHEST_M = 1e9
"""Largest plausible coordinate. Squares of much larger ones would overflow in the evaluation."""


def read_kitti_poses(path: Path) -> FloatArray:
    """Read poses T_world_cam, [N, 4, 4], m, in KITTI's format.

    Each line holds the first three rows of the pose of one frame, 12 numbers. Twelve ``nan`` mean
    an unknown pose, which becomes NaN.

    Raises:
        InputError: the file cannot be read, a line holds no pose, or a position is implausibly far.
    """
    T = _read_kitti(path)
    unknown, _ = check_poses(T, path)
    _check_positions(T, path)
    return np.where(unknown, np.nan, T)


def read_kitti_truth(
    path: Path, stamps_ns: IntArray, *, image_names: Sequence[str] = ()
) -> GroundTruth:
    """Read the ground truth of the frames with these stamps, [K], from poses in KITTI's format.

    Args:
        path: the file.
        stamps_ns: of the frames, [K], ns.
        image_names: names of their images, without suffix. Where these are numbers, a file with
            more poses than frames belongs to a longer recording, and a frame has the pose of its
            number.

    Raises:
        InputError: the file cannot be read, the counts of poses and frames differ, or as
            ``ground_truth`` raises.
    """
    T = _read_kitti(path)
    if len(T) > len(stamps_ns) and image_names and all(name.isdigit() for name in image_names):
        numbers = [int(name) for name in image_names]
        if max(numbers) < len(T):
            T = T[numbers]
    if len(T) != len(stamps_ns):
        what = f"{len(T)} poses for {len(stamps_ns)} frames."
        raise InputError(
            path, what, "Each frame needs one line; write twelve nan where the pose is unknown."
        )
    return ground_truth(stamps_ns, T, path)


def read_tum(path: Path) -> tuple[IntArray, FloatArray]:
    """Read poses in TUM's format: lines of ``stamp tx ty tz qx qy qz qw``, in s and m.

    Returns:
        Stamps, [N], ns, exact to the last of nine decimals, and poses T_world_cam, [N, 4, 4], m.

    Raises:
        InputError: the file cannot be read, a line is not eight numbers, a quaternion is not of
            unit length, the stamps do not ascend, or a position is implausibly far.
    """
    stamps = []
    rows = []
    for where, fields in read_fields(path, 8):
        stamps.append(seconds_to_ns(fields[0], where))
        rows.append(parse_floats(fields[1:], where))
        length = np.linalg.norm(rows[-1][3:])
        if not abs(length - 1.0) < 1e-3:
            raise InputError(
                where, f"the quaternion has length {length:.6g}.", "Expected a unit quaternion."
            )
    numbers = np.array(rows)
    T = se3.from_parts(Rotation.from_quat(numbers[:, 3:]).as_matrix(), numbers[:, :3])
    _check_positions(T, path)
    return check_stamps(np.array(stamps, dtype=np.int64), path), T


def _read_kitti(path: Path) -> FloatArray:
    """Read the matrices of a file in KITTI's format, [N, 4, 4], unchecked.

    Raises:
        InputError: the file cannot be read, or a line is not twelve numbers.
    """
    rows = read_table(path, 12, nan_allowed=True).reshape(-1, 3, 4)
    return se3.from_parts(rows[:, :, :3], rows[:, :, 3])


def _check_positions(T: FloatArray, path: Path) -> None:
    """Refuse poses [N, 4, 4] whose position is implausibly far.

    Raises:
        InputError: names the first such pose.
    """
    too_far = np.flatnonzero((np.abs(T[:, :3, 3]) > FARTHEST_M).any(axis=1))
    if len(too_far):
        what = f"the position of pose {too_far[0]} (from 0) is over {FARTHEST_M:g} m away."
        raise InputError(path, what, "Positions are in metres.")


def write_tum(path: str | Path, stamps_ns: IntArray, T_world_cam: FloatArray) -> None:
    """Write a TUM trajectory.

    A line is ``stamp tx ty tz qx qy qz qw``: the stamp in s with nine decimals, the position in m,
    and the unit quaternion with qw ≥ 0. Unknown poses, of NaN, have no line.

    Args:
        path: the file.
        stamps_ns: [N], ns, ascending.
        T_world_cam: poses, [N, 4, 4], m.

    Raises:
        InputError: the poses or the stamps have another shape, a pose is partly not finite or holds
            no rotation, stamps do not ascend, or the file cannot be written.
    """
    T_world_cam, stamps_ns = _checked_path(T_world_cam, stamps_ns)
    is_known = np.isfinite(T_world_cam[:, 0, 3])
    T_world_cam = T_world_cam[is_known]
    stamps_ns = stamps_ns[is_known]
    quaternions = Rotation.from_matrix(T_world_cam[:, :3, :3]).as_quat(canonical=True)
    numbers = np.concatenate([T_world_cam[:, :3, 3], quaternions], axis=1)
    stamps = [f"{Decimal(ns).scaleb(-9):.9f}" for ns in stamps_ns.tolist()]
    lines = [f"{stamp} {_shortest_text(row)}\n" for stamp, row in zip(stamps, numbers, strict=True)]
    write_atomically(Path(path), "".join(lines))


def write_kitti_poses(path: str | Path, T_world_cam: FloatArray) -> None:
    """Write poses T_world_cam, [N, 4, 4], m, in KITTI's odometry form.

    A line holds the upper three rows of one pose, row by row: twelve numbers, NaN where unknown.

    Raises:
        InputError: the poses have another shape, a pose is partly not finite or holds no rotation,
            or the file cannot be written.
    """
    T_world_cam, _ = _checked_path(T_world_cam)
    rows = T_world_cam[:, :3, :].reshape(-1, 12)
    write_atomically(Path(path), "".join(f"{_shortest_text(row)}\n" for row in rows))


def _checked_path(
    T_world_cam: FloatArray, stamps_ns: IntArray | None = None
) -> tuple[FloatArray, IntArray]:
    """Return poses [N, 4, 4] and their stamps [N] as arrays; without stamps, those are counted.

    Raises:
        InputError: they have another shape, a pose is partly not finite or holds no rotation, or
            stamps do not ascend.
    """
    poses = np.asarray(T_world_cam, np.float64)
    if poses.ndim != 3 or poses.shape[1:] != (4, 4):
        raise InputError("T_world_cam", f"its shape is {poses.shape}, where [N, 4, 4] is expected.")
    check_poses(poses, "T_world_cam")
    stamps = np.arange(len(poses)) if stamps_ns is None else np.asarray(stamps_ns)
    if stamps.shape != (len(poses),) or stamps.dtype.kind != "i":
        raise InputError(
            "stamps_ns",
            f"its shape is {stamps.shape} and its type {stamps.dtype}, for {len(poses)} poses.",
            "Give a whole number of ns for each pose.",
        )
    backwards = np.flatnonzero(stamps[1:] <= stamps[:-1])
    if len(backwards):
        index = int(backwards[0]) + 1
        what = f"stamp {index} (from 0), {stamps[index]} ns, is not after the one before."
        raise InputError("stamps_ns", what, "Give the poses in the order of their times.")
    return poses, stamps


def _shortest_text(row: FloatArray) -> str:
    # repr of a Python float is the shortest text that reads back as the same 64 bits.
    return " ".join(map(repr, row.tolist()))
