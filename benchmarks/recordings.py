"""The real recordings: below PROBEVO_DATA, or ../shared/data beside the repository."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np

import probevo as pv
from probevo.arrays import FloatArray

ROOT = Path(
    os.environ.get("PROBEVO_DATA", Path(__file__).resolve().parents[1] / ".." / "shared" / "data")
)
RECORDINGS = {
    "odometry 06": ROOT / "kitti_odometry" / "sequences" / "06",
    "raw 0005": ROOT / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync",
}


def available() -> dict[str, Path]:
    """Return the recordings that are there, by name; end the program with a message if none is."""
    found = {name: path.resolve() for name, path in RECORDINGS.items() if path.is_dir()}
    if not found:
        sys.exit(
            f"no recording under {ROOT}: set PROBEVO_DATA to the folder that holds kitti_odometry"
            " or kitti_raw"
        )
    return found


def by_velocities(drive: Path) -> FloatArray:
    """Return T_world_cam of a KITTI raw drive, [K, 4, 4], with positions from the INS velocities.

    Positions from latitude and longitude, as of KITTI's truth, are off by 0.3 to 0.5 m on drive
    0005, whose path is 3 % shorter by them. The vehicle's axes are taken as those of the camera,
    which is right to about a degree.
    """
    sequence = pv.open_sequence(drive)
    poses: FloatArray = sequence.truth.T_world_cam.copy()
    # Columns 8 to 10 of an OXTS file are the velocities forward, left and up, m/s.
    oxts = np.array([np.loadtxt(file) for file in sorted((drive / "oxts" / "data").glob("*.txt"))])
    forward, left, up = oxts[: len(poses), 8:11].T
    velocity = np.einsum("kij,kj->ki", poses[:, :3, :3], np.column_stack([-left, -up, forward]))
    # Trapezoidal rule.
    duration_s = np.diff(1e-9 * sequence.stamps_ns)[:, None]
    moved = 0.5 * (velocity[1:] + velocity[:-1]) * duration_s
    poses[1:, :3, 3] = poses[0, :3, 3] + np.cumsum(moved, axis=0)
    return poses
