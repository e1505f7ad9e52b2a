"""Ground-truth poses: checks, and interpolation to the times of the frames."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.frame import GroundTruth

MAX_GAP_NS = 500_000_000
"""Longest gap over which truth is interpolated. The slowest common source, OXTS in sync drives, has
a pose every 0.1 s."""
MAX_EXTRAPOLATION_NS = 50_000_000
"""Longest extrapolation beyond the first and last pose, which is half of their own interval:
half a period of that source."""


def check_poses(T: FloatArray, where: str | Path) -> tuple[BoolArray, FloatArray]:
    """Check poses [K, 4, 4], which are NaN where unknown.

    Returns:
        Which poses are unknown, [K, 1, 1], and orthonormal rotations, [K, 3, 3], which are the
        identity where unknown.

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
    """Return the truth relative to the first known pose.

    Args:
        stamps_ns: times of the frames, [K].
        T: poses T_anyworld_cam, [K, 4, 4], NaN where unknown.
        where: file of the poses, for messages.

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


def interpolate_poses(stamps_ns: IntArray, T: FloatArray, times_ns: IntArray) -> FloatArray:
    """Interpolate poses to other times.

    Between two poses, the rotation has a constant rate and the position moves linearly. Beyond the
    ends, the last motion is extrapolated for half as long as it was observed, 50 ms at most.
    Further beyond, and within gaps over 0.5 s, the pose is NaN.

    Args:
        stamps_ns: time of each pose, [M], ascending.
        T: the poses, [M, 4, 4].
        times_ns: times to interpolate to, [K].

    Returns:
        Poses, [K, 4, 4].
    """
    # Index of the pose before each time, and of the pose after it.
    start = np.clip(
        np.searchsorted(stamps_ns, times_ns, side="right") - 1, 0, max(len(stamps_ns) - 2, 0)
    )
    end = np.minimum(start + 1, len(stamps_ns) - 1)
    gap_ns = stamps_ns[end] - stamps_ns[start]
    fraction = ((times_ns - stamps_ns[start]) / np.maximum(gap_ns, 1))[:, None]

    C_start = T[start][:, :3, :3]
    t_start = T[start][:, :3, 3]
    rotation_rad = so3.log(C_start.mT @ T[end][:, :3, :3])
    C = C_start @ so3.exp(fraction * rotation_rad)
    poses = se3.from_parts(C, t_start + fraction * (T[end][:, :3, 3] - t_start))

    is_at_pose = (times_ns == stamps_ns[start]) | (times_ns == stamps_ns[end])
    is_in_gap = (gap_ns > MAX_GAP_NS) & ~is_at_pose
    beyond_ns = np.maximum(stamps_ns[0] - times_ns, times_ns - stamps_ns[-1])
    is_beyond = beyond_ns > np.minimum(gap_ns // 2, MAX_EXTRAPOLATION_NS)
    poses[is_in_gap | is_beyond] = np.nan
    return poses
