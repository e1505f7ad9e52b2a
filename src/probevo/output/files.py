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
    """Write e.g. ``metrics.json``: keys in the given order, numbers at full precision, None as
    null."""
    write_atomically(path, json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + "\n")


def write_tum(path: Path, stamps_ns: IntArray, T_world_cam: FloatArray) -> None:
    """Write a TUM trajectory: a line is ``stamp tx ty tz qx qy qz qw``, s with nine decimals and m;
    qw ≥ 0."""
    quaternions = Rotation.from_matrix(T_world_cam[:, :3, :3]).as_quat(canonical=True)
    numbers = np.concatenate([T_world_cam[:, :3, 3], quaternions], axis=1)
    stamps = [f"{Decimal(ns).scaleb(-9):.9f}" for ns in stamps_ns.tolist()]
    lines = [f"{stamp} {_join(row)}\n" for stamp, row in zip(stamps, numbers, strict=True)]
    write_atomically(path, "".join(lines))


def write_kitti_poses(path: Path, T_world_cam: FloatArray) -> None:
    """Write KITTI odometry poses: the upper three rows of T_world_cam, row by row, twelve numbers a
    line."""
    write_atomically(
        path, "".join(f"{_join(row)}\n" for row in T_world_cam[:, :3, :].reshape(-1, 12))
    )


def _join(row: FloatArray) -> str:
    # repr of a Python float is the shortest text that reads back as the same 64 bits.
    return " ".join(map(repr, row.tolist()))
