"""Trajectories and results as files. Text is written at full precision."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

from probevo.files import write_atomically
from probevo.sequences.pose_files import write_kitti_poses as write_kitti_poses
from probevo.sequences.pose_files import write_tum as write_tum


def write_json(path: Path, values: Mapping[str, object]) -> None:
    """Write e.g. ``metrics.json``: keys in the given order, numbers at full precision, None as
    null."""
    write_atomically(path, json.dumps(values, indent=2, allow_nan=False, ensure_ascii=False) + "\n")
