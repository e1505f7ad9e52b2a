"""Ground-truth poses: reading, checking, and carrying them over to the times of the frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.frame import GroundTruth

LONGEST_GAP_NS = 500_000_000
"""Truth is not interpolated over longer gaps; the slowest common source (OXTS in sync drives) comes
every 0.1 s."""
LONGEST_EXTRAPOLATION_NS = 50_000_000
"""Nor carried further beyond its ends: half a period of that source."""


def check_poses(T: FloatArray, where: str | Path) -> tuple[BoolArray, FloatArray]:
    """Which of K poses [K, 4, 4] are unknown, NaN, [K, 1, 1], and the orthonormal rotations of all,
    [K, 3, 3].

    Raises:
        InputError: a pose is neither finite nor wholly NaN, or holds no rotation matrix.
    """
    unknown = np.all(np.isnan(T[:, :3]), axis=(1, 2), keepdims=True)
    broken = np.flatnonzero(~np.isfinite(np.where(unknown, 0.0, T)).reshape(len(T), 16).all(axis=1))
    if len(broken):
        raise InputError(
            where,
            f"pose {broken[0]} (from 0) is partly not finite.",
            "Use NaN throughout for unknown.",
        )
    return unknown, so3.check_rotation(np.where(unknown, np.eye(3), T[:, :3, :3]), where)


def ground_truth(stamps_ns: IntArray, T: FloatArray, where: str | Path) -> GroundTruth:
    """Truth relative to the first known pose, from T_anyworld_cam [K, 4, 4], NaN where unknown.

    Raises:
        InputError: no pose is known, or as ``check_poses`` raises.
    """
    unknown, C = check_poses(T, where)
    if unknown.all():
        what = (
            f"it gives no pose between {stamps_ns[0]} and {stamps_ns[-1]} ns, the times of the"
            " frames."
        )
        raise InputError(where, what, "Remove it to go without ground truth.")
    T_any_cam = np.where(unknown, np.nan, se3.from_parts(C, T[:, :3, 3]))
    return GroundTruth(stamps_ns, se3.inverse(T_any_cam[np.argmin(unknown)]) @ T_any_cam)


def interpolate_poses(stamps_ns: IntArray, T: FloatArray, at_ns: IntArray) -> FloatArray:
    """Poses T [M, 4, 4] at M stamps, carried to the times ``at_ns`` [K]: [K, 4, 4].

    Rotations turn at a constant rate between neighbours, positions move linearly. Beyond the ends
    the last motion goes on for as long as it was seen, but for 50 ms at most; there and within gaps
    over 0.5 s the pose is NaN.
    """
    before = np.clip(
        np.searchsorted(stamps_ns, at_ns, side="right") - 1, 0, max(len(stamps_ns) - 2, 0)
    )
    after = np.minimum(before + 1, len(stamps_ns) - 1)
    gap = stamps_ns[after] - stamps_ns[before]
    fraction = ((at_ns - stamps_ns[before]) / np.maximum(gap, 1))[:, None]
    start = T[before]
    end = T[after]
    turn = so3.log(start[:, :3, :3].mT @ end[:, :3, :3])
    C = start[:, :3, :3] @ so3.exp(fraction * turn)
    poses = se3.from_parts(C, start[:, :3, 3] + fraction * (end[:, :3, 3] - start[:, :3, 3]))
    beyond_ns = np.maximum(stamps_ns[0] - at_ns, at_ns - stamps_ns[-1])
    lost = (gap > LONGEST_GAP_NS) & (at_ns != stamps_ns[before]) & (at_ns != stamps_ns[after])
    poses[lost | (beyond_ns > np.minimum(gap, LONGEST_EXTRAPOLATION_NS))] = np.nan
    return poses
