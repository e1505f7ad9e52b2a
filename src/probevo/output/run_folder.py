"""Reading the folder that ``probevo run`` has written: its motions, and its smoothed path."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from probevo.errors import InputError
from probevo.output.motions_file import read_motions
from probevo.output.run_files import MOTIONS, SMOOTHED_KITTI
from probevo.output.run_result import RunResult
from probevo.sequences.pose_files import read_kitti_poses


def read_run(folder: Path) -> RunResult:
    """Read a run, with its smoothed path if it has one.

    Raises:
        InputError: the folder has no motions, one of the files is damaged, or they are of two runs.
    """
    motions = folder / MOTIONS
    if not motions.exists():
        what = "this file is missing."
        cure = "Give the --out folder of `probevo run`, or a trajectory file."
        raise InputError(motions, what, cure)
    result = read_motions(motions)
    path = folder / SMOOTHED_KITTI
    if not path.is_file():
        return result
    smoothed = read_kitti_poses(path)
    if len(smoothed) != len(result):
        what = f"it has {len(smoothed)} poses, and {MOTIONS} {len(result)} frames."
        raise InputError(path, what, "Are they of one run?")
    if not np.isfinite(smoothed).all():
        raise InputError(path, "some of its poses are not known.", "Run `probevo run` again.")
    return replace(result, smoothed=smoothed)
