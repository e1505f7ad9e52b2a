"""Trajectories and results as files. Text is written at full precision."""

from __future__ import annotations

import json
from collections.abc import Mapping
from decimal import Decimal
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray, IntArray
from probevo.files import write_atomically


def write_json(path: Path, values: Mapping[str, object]) -> None:
    """Write a JSON file such as ``metrics.json``.

    Keys stay in the given order, numbers have full precision, and None becomes null.
    """
    write_atomically(path, json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def write_tum(path: Path, stamps_ns: IntArray, T_world_cam: FloatArray) -> None:
    """Write a TUM trajectory, a line ``stamp tx ty tz qx qy qz qw`` for each pose, in s and m.

    Stamps have nine decimals; qw ≥ 0.
    """
    quaternions = Rotation.from_matrix(T_world_cam[:, :3, :3]).as_quat(canonical=True)
    numbers = np.concatenate([T_world_cam[:, :3, 3], quaternions], axis=1)
    stamps = [f"{Decimal(ns).scaleb(-9):.9f}" for ns in stamps_ns.tolist()]
    lines = [f"{stamp} {_join(row)}\n" for stamp, row in zip(stamps, numbers, strict=True)]
    write_atomically(path, "".join(lines))


def write_kitti_poses(path: Path, T_world_cam: FloatArray) -> None:
    """Write KITTI odometry poses: the upper three rows of T_world_cam, twelve numbers a line."""
    rows = T_world_cam[:, :3, :].reshape(-1, 12)
    write_atomically(path, "".join(f"{_join(row)}\n" for row in rows))


def _join(row: FloatArray) -> str:
    """Write numbers at full precision, with blanks between them."""
    # repr of a Python float is the shortest text that reads back as the same 64 bits.
    return " ".join(map(repr, row.tolist()))
