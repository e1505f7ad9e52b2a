"""Trajectories and results as files. Text is written at full precision; a file appears whole or not at all."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from contextlib import suppress
from decimal import Decimal, InvalidOperation
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError

FARTHEST_M = 1e9
"""Positions beyond are no positions of a vehicle; their squares would overflow in the evaluation."""


def check_folder(folder: Path, option: str) -> None:
    """Refuse, without making anything, a folder into which files cannot be written.

    Args:
        folder: it may be missing as yet, and its parents too.
        option: how the user names it, for the message.

    Raises:
        InputError: a file is in the way, or the nearest folder that exists cannot be written to.
    """
    place = folder.absolute()
    while not os.path.lexists(place):
        place = place.parent
    if not place.is_dir():
        raise InputError(option, f"{place} is a file.", "Choose another output folder.")
    if not os.access(place, os.W_OK | os.X_OK):
        raise InputError(option, f"{place} cannot be written to.", "Choose another output folder.")


def write_atomically(path: Path, content: bytes | str, writer: str = "") -> None:
    """Write beside ``path`` and rename, so that an interrupted run leaves the old file or the new one, never half.

    Missing folders are made. Where two may write the same file at a time, each names itself as ``writer``. Raises
    InputError if the place cannot be written to.
    """
    data = content.encode() if isinstance(content, str) else content
    partial = path.with_name(f"{path.name}{writer}.part")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        partial.write_bytes(data)
        os.replace(partial, path)
    except OSError as error:
        with suppress(OSError):
            partial.unlink()
        raise InputError(path, f"cannot be written: {error.strerror}", "Choose another output folder.") from error


def remove_stale(path: Path) -> None:
    """Remove what an earlier run left and this one does not write, lest it pass for a result of this one."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise InputError(path, f"cannot be removed: {error.strerror}", "Choose another output folder.") from error


def write_json(path: Path, values: Mapping[str, object]) -> None:
    """Write e.g. ``metrics.json``: keys in the given order, numbers at full precision, None as null."""
    write_atomically(path, json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def write_tum(path: Path, stamps_ns: IntArray, T_world_cam: FloatArray) -> None:
    """Write a TUM trajectory: a line is ``stamp tx ty tz qx qy qz qw``, s with nine decimals and m; qw ≥ 0."""
    quaternions = Rotation.from_matrix(T_world_cam[:, :3, :3]).as_quat(canonical=True)
    numbers = np.concatenate([T_world_cam[:, :3, 3], quaternions], axis=1)
    stamps = [f"{Decimal(ns).scaleb(-9):.9f}" for ns in stamps_ns.tolist()]
    lines = [f"{stamp} {_join(row)}\n" for stamp, row in zip(stamps, numbers, strict=True)]
    write_atomically(path, "".join(lines))


def read_tum(path: Path) -> tuple[IntArray, FloatArray]:
    """Stamps, [N], ns, exact to the last of nine decimals, and poses T_world_cam, [N, 4, 4], m, of a TUM trajectory.

    Raises:
        InputError: the file cannot be read, a line is not eight numbers, a quaternion is not of unit length, or the
            stamps do not ascend, or a position is absurdly far.
    """
    rows = _read_table(path, columns=8, example="stamp tx ty tz qx qy qz qw")
    stamps_ns = np.array([_nanoseconds(path, line, cells[0]) for line, cells in rows], dtype=np.int64)
    numbers = _numbers(path, rows)[:, 1:]
    for (line, _), length in zip(rows, np.linalg.norm(numbers[:, 3:], axis=1), strict=True):
        if not abs(length - 1.0) < 1e-3:
            raise InputError(
                path, f"line {line}: the quaternion has length {length:.6g}", "Expected a unit quaternion."
            )
    for k in np.flatnonzero(np.diff(stamps_ns) <= 0)[:1]:
        raise InputError(
            path, f"line {rows[k + 1][0]}: stamp is not later than the one before", "Sort the file by time."
        )
    T_world_cam = np.tile(np.eye(4), (len(rows), 1, 1))
    T_world_cam[:, :3, :3] = Rotation.from_quat(numbers[:, 3:]).as_matrix()
    T_world_cam[:, :3, 3] = numbers[:, :3]
    _check_positions(path, rows, T_world_cam)
    return stamps_ns, T_world_cam


def write_kitti_poses(path: Path, T_world_cam: FloatArray) -> None:
    """Write KITTI odometry poses: the upper three rows of T_world_cam, row by row, twelve numbers a line."""
    write_atomically(path, "".join(f"{_join(row)}\n" for row in T_world_cam[:, :3, :].reshape(-1, 12)))


def read_kitti_poses(path: Path) -> FloatArray:
    """Poses T_world_cam, [N, 4, 4], m, of a KITTI odometry pose file; NaN where a line is twelve times ``nan``.

    Raises:
        InputError: the file cannot be read, a line is not twelve numbers, their first 3×3 is no rotation, or a
            position is absurdly far.
    """
    rows = _read_table(path, columns=12, example="the upper three rows of T_world_cam, row by row")
    numbers = _numbers(path, rows, allow_unknown=True)
    T_world_cam = np.tile(np.eye(4), (len(rows), 1, 1))
    T_world_cam[:, :3, :] = numbers.reshape(-1, 3, 4)
    T_world_cam[np.isnan(numbers).all(axis=1)] = np.nan
    _check_positions(path, rows, T_world_cam)
    C = np.where(np.isnan(T_world_cam), np.eye(4), T_world_cam)[:, :3, :3]
    skewed = np.abs(C @ np.swapaxes(C, -1, -2) - np.eye(3)).max(axis=(1, 2), initial=0.0) > 1e-3
    for k in np.flatnonzero(skewed | (np.linalg.det(C) < 0.0))[:1]:
        raise InputError(path, f"line {rows[k][0]}: columns 1-3, 5-7, 9-11 are no rotation", "Is it a KITTI pose file?")
    return T_world_cam


def _join(row: FloatArray) -> str:
    # repr of a Python float is the shortest text that reads back as the same 64 bits.
    return " ".join(map(repr, row.tolist()))


def _read_table(path: Path, columns: int, example: str) -> list[tuple[int, list[str]]]:
    """Line number and cells of each line that is neither empty nor a comment."""
    try:
        text = path.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(path, f"cannot be read: {error}", "Expected a text file with one pose a line.") from error
    cells = ((number, line.split()) for number, line in enumerate(text.splitlines(), start=1))
    rows = [(number, row) for number, row in cells if row and not row[0].startswith("#")]
    if not rows:
        raise InputError(path, "holds no poses", f"Expected one a line: {example}.")
    for number, row in rows:
        if len(row) != columns:
            raise InputError(path, f"line {number}: {len(row)} numbers", f"Expected {columns}: {example}.")
    return rows


def _numbers(path: Path, rows: list[tuple[int, list[str]]], *, allow_unknown: bool = False) -> FloatArray:
    """The cells as numbers, [N, columns]; finite, or all NaN in a line if that is allowed."""
    numbers = np.empty((len(rows), len(rows[0][1])))
    for k, (line, cells) in enumerate(rows):
        try:
            numbers[k] = [float(cell) for cell in cells]
        except ValueError as error:
            raise InputError(path, f"line {line}: {error}", "Expected numbers only.") from error
        if not (np.isfinite(numbers[k]).all() or (allow_unknown and np.isnan(numbers[k]).all())):
            raise InputError(path, f"line {line}: not all numbers are finite", "Mend or remove the line.")
    return numbers


def _check_positions(path: Path, rows: list[tuple[int, list[str]]], T_world_cam: FloatArray) -> None:
    for k in np.flatnonzero((np.abs(T_world_cam[:, :3, 3]) > FARTHEST_M).any(axis=1))[:1]:
        what = f"line {rows[k][0]}: the position is over {FARTHEST_M:g} m away"
        raise InputError(path, what, "Positions are in metres.")


def _nanoseconds(path: Path, line: int, stamp: str) -> int:
    with suppress(InvalidOperation, ValueError, OverflowError):
        stamp_ns = int(Decimal(stamp).scaleb(9).to_integral_value())
        if abs(stamp_ns) < 2**63:
            return stamp_ns
    raise InputError(path, f"line {line}: stamp {stamp!r} is no time in s", "Expected a number.")
