"""Where the real recordings lie: PROBEVO_DATA, or ../shared/data beside the repository."""

from __future__ import annotations

import os
import sys
from pathlib import Path

ROOT = Path(os.environ.get("PROBEVO_DATA", Path(__file__).resolve().parents[1] / ".." / "shared" / "data"))
RECORDINGS = {
    "odometry 06": ROOT / "kitti_odometry" / "sequences" / "06",
    "raw 0005": ROOT / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync",
}


def available() -> dict[str, Path]:
    """Those that are there, by name; ends the program with a word if none is."""
    found = {name: path.resolve() for name, path in RECORDINGS.items() if path.is_dir()}
    if not found:
        sys.exit(f"no recording under {ROOT}: set PROBEVO_DATA to the folder that holds kitti_odometry or kitti_raw")
    return found
