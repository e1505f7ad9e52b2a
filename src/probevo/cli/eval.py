"""``probevo eval``: compare a run, or a trajectory file, with true poses."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from probevo.cli.arguments import parse
from probevo.cli.text import columns
from probevo.errors import InputError
from probevo.output.run_files import METRICS, MOTIONS

if TYPE_CHECKING:
    from probevo.arrays import FloatArray, IntArray
    from probevo.output.run_result import RunResult

PoseFormat = Literal["kitti", "tum"]
COLUMNS: dict[int, PoseFormat] = {12: "kitti", 8: "tum"}
"""Format of a file by its number of columns."""


@dataclass(frozen=True)
class EvalArguments:
    """Compares a run with true poses of the left camera.

    TUM poses are matched by time: they are interpolated at the time of each frame, but not over
    gaps of more than half a second. KITTI poses have no time and are matched by number: the first
    pose belongs to the first frame, and poses beyond the last frame are ignored.
    """

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Folder of a run (metrics.json is written into it), or a trajectory in TUM or KITTI format."""
    gt: Annotated[Path, tyro.conf.arg(metavar="POSES")]
    """True poses T_world_cam, in TUM or KITTI format."""
    gt_format: Annotated[PoseFormat | None, tyro.conf.arg(help_behavior_hint="")] = None
    """Format of the true poses; detected by the number of columns if not given."""


@dataclass(frozen=True)
class Trajectory:
    """The poses of a file or of a run, N of them."""

    where: Path
    """The file."""
    T_world_cam: FloatArray
    """Poses, [N, 4, 4], m; NaN where unknown."""
    stamps_ns: IntArray | None = None
    """Times, [N], ns; None if the file has none."""
    run: RunResult | None = None
    """The run, if it is one, and not a trajectory alone."""


def main(words: list[str]) -> None:
    """Parse the arguments and compare."""
    arguments = parse(EvalArguments, words, "eval")
    import numpy as np

    from probevo.estimation.motion_estimate import Status
    from probevo.evaluation.metrics import evaluate
    from probevo.evaluation.trajectory_errors import relative_motions
    from probevo.output.json_file import write_json
    from probevo.output.metrics_table import metrics_rows
    from probevo.output.run_warnings import step_length_warning, truth_warning

    estimate = _estimate(arguments.run)
    truth = read_trajectory(arguments.gt, arguments.gt_format)
    refuse_unknown(estimate)
    T_world_cam_true, remark = match_truth(estimate, truth)
    run = estimate.run
    if run is None:
        metrics = evaluate(estimate.T_world_cam, T_world_cam_true)
        T_curr_prev = relative_motions(estimate.T_world_cam)
        is_ok = np.ones(len(T_curr_prev), np.bool_)
    else:
        metrics = run.metrics(T_world_cam_true)
        T_curr_prev = run.T_curr_prev
        is_ok = run.status == Status.OK
    rows = metrics_rows(metrics)
    width = max(len(name) for name, _, _ in rows)
    print(columns((f"{name:<{width}}  {value}", text) for name, value, text in rows))
    if remark:
        print(remark)
    for warning in (
        truth_warning(T_curr_prev, is_ok, T_world_cam_true),
        step_length_warning(T_curr_prev, is_ok, T_world_cam_true),
    ):
        if warning is not None:
            print(f"probevo: warning: {warning}", file=sys.stderr)
    if run is not None:
        write_json(arguments.run / METRICS, metrics.as_dict())
        print(f"written: {arguments.run / METRICS}")


def _estimate(path: Path) -> Trajectory:
    """Read what is to be compared: the folder of a run, or a trajectory file.

    Raises:
        InputError: the folder has no motions, or a file is damaged.
    """
    from probevo.output.run_folder import read_run

    if not path.is_dir():
        return read_trajectory(path)
    run = read_run(path)
    return Trajectory(path / MOTIONS, run.T_world_cam, run.stamps_ns, run)


def read_trajectory(path: Path, pose_format: PoseFormat | None = None) -> Trajectory:
    """Read poses in TUM or KITTI format, by default as their number of columns says.

    Raises:
        InputError: the file cannot be read, or has neither format.
    """
    from probevo.sequences.pose_files import read_kitti_poses, read_tum
    from probevo.sequences.text import read_lines

    if path.is_dir():
        raise InputError(path, "is a folder.", "Give a file of poses, such as that of a run.")
    if pose_format is None:
        where, line = read_lines(path, "Give a file of poses, in the KITTI or TUM format.")[0]
        if "," in line:
            what = "its numbers are separated by commas; the KITTI and TUM formats have blanks."
            cure = (
                "Replace the commas by blanks. EuRoC's own truth is of the body; `probevo run`"
                " compares with it."
            )
            raise InputError(where, what, cure)
        num_columns = len(line.split())
        if num_columns not in COLUMNS:
            cure = (
                "Poses have 12 columns in the KITTI format, and 8 in the TUM format (stamp, t, q)."
            )
            raise InputError(where, f"this line has {num_columns} columns.", cure)
        pose_format = COLUMNS[num_columns]
    if pose_format == "kitti":
        return Trajectory(path, read_kitti_poses(path))
    stamps_ns, T_world_cam = read_tum(path)
    return Trajectory(path, T_world_cam, stamps_ns)


def refuse_unknown(estimate: Trajectory) -> None:
    """Refuse an estimate with unknown (NaN) poses; only the truth may have them.

    Raises:
        InputError: names the first unknown pose.
    """
    import numpy as np

    unknown = np.flatnonzero(np.isnan(estimate.T_world_cam).any(axis=(1, 2)))
    if len(unknown):
        raise InputError(
            estimate.where,
            f"pose {unknown[0]} (from 0) is not known.",
            "An estimate needs a pose for each frame.",
        )


def match_truth(estimate: Trajectory, truth: Trajectory) -> tuple[FloatArray, str]:
    """Find the true pose of each estimated one: by time if both have times, else by number.

    Returns:
        The true poses, [N, 4, 4], m, NaN where unknown; and a remark for the user, or "".

    Raises:
        InputError: there are too few true poses, or fewer than two frames have one.
    """
    import numpy as np

    num_frames = len(estimate.T_world_cam)
    remark = ""
    if estimate.stamps_ns is not None and truth.stamps_ns is not None:
        from probevo.sequences.poses import interpolate_poses

        matched = interpolate_poses(truth.stamps_ns, truth.T_world_cam, estimate.stamps_ns)
        cure = (
            f"Its poses are of {_span(truth.stamps_ns)}, the frames of"
            f" {_span(estimate.stamps_ns)}: both need the same clock."
        )
    else:
        remark = _check_numbers(estimate, truth)
        matched = truth.T_world_cam[:num_frames]
        cure = "Give true poses of at least two frames; others may be nan."

    num_known = int(np.isfinite(matched).all(axis=(1, 2)).sum())
    if num_known < 2:
        what = f"{num_known} of {num_frames} frames have a true pose; two are needed."
        raise InputError(truth.where, what, cure)
    if num_known < num_frames:
        unknown = f"{num_frames - num_known} of {num_frames} frames have no true pose."
        remark = f"{unknown} {remark}".strip()
    return matched, remark


def _span(stamps_ns: IntArray) -> str:
    """Return the times of the first and the last stamp as text."""
    return f"{stamps_ns[0] * 1e-9:.3f} to {stamps_ns[-1] * 1e-9:.3f} s"


def _check_numbers(estimate: Trajectory, truth: Trajectory) -> str:
    """Check that true poses can be matched by number; return a remark if there are more of them."""
    from probevo.output.run_result import num_lost_frames

    num_frames = len(estimate.T_world_cam)
    num_poses = len(truth.T_world_cam)
    if num_poses < num_frames:
        raise InputError(
            truth.where,
            f"{num_poses} poses for the {num_frames} frames of {estimate.where}.",
            "Without times they are matched by number: give one for each frame.",
        )
    if num_poses == num_frames:
        return ""
    num_lost = 0 if estimate.stamps_ns is None else num_lost_frames(estimate.stamps_ns)
    if num_lost:
        raise InputError(
            truth.where,
            f"{num_poses} poses for the {num_frames} frames of {estimate.where}, of"
            f" which {num_lost} are missing by the times: it is not known which pose is of which.",
            "Give one pose for each frame that is there, or true poses with times (TUM).",
        )
    if truth.stamps_ns is not None:
        raise InputError(
            truth.where,
            f"{num_poses} poses for the {num_frames} frames of {estimate.where}, which has no times"
            " to match them by.",
            "Give the folder of the run, or its trajectory.tum, instead.",
        )
    return (
        f"Compared with the first {num_frames} of {num_poses} true poses: the estimate has no more."
    )
