"""``probevo eval``: compares a run, or a trajectory file, with true poses."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from probevo.cli.arguments import parse
from probevo.cli.text import columns
from probevo.errors import InputError

if TYPE_CHECKING:
    from probevo.arrays import FloatArray, IntArray

PoseFormat = Literal["kitti", "tum"]
COLUMNS: dict[int, PoseFormat] = {12: "kitti", 8: "tum"}


@dataclass(frozen=True)
class EvalArguments:
    """Figures of merit of a run against true poses of the left camera.

    TUM poses are matched by time: interpolated at that of each frame, but not over gaps of more
    than half a second.
    KITTI poses have no time and are matched by number: the first belongs to the first frame, and
    those beyond the last
    frame are left out.
    """

    run: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="RUN")]
    """Folder of a run (metrics.json is written into it), or a trajectory in TUM or KITTI form."""
    gt: Annotated[Path, tyro.conf.arg(metavar="POSES")]
    """True poses T_world_cam, in TUM or KITTI form."""
    gt_format: Annotated[PoseFormat | None, tyro.conf.arg(help_behavior_hint="")] = None
    """Form of the true poses; found out by the number of columns where it is not named."""


@dataclass(frozen=True)
class Trajectory:
    """Poses as a file or a run has them."""

    where: Path
    T_world_cam: FloatArray
    """[N, 4, 4], m."""
    stamps_ns: IntArray | None = None
    """[N]; None where the file has no times."""
    T_curr_prev: FloatArray | None = None
    """Relative motions of a run, [N-1, 4, 4], m."""
    cov: FloatArray | None = None
    """Their covariances, [N-1, 6, 6]."""
    out_of_domain: float | None = None
    """See ``RunResult.out_of_domain``."""
    stopped: str | None = None
    """See ``RunResult.stopped``."""


def main(words: list[str]) -> None:
    """Parse and compare."""
    arguments = parse(EvalArguments, words, "eval")
    from probevo.evaluation.metrics import evaluate
    from probevo.output.files import write_json
    from probevo.output.metrics_table import metrics_rows

    estimate = read_run(arguments.run) if arguments.run.is_dir() else read_trajectory(arguments.run)
    truth = read_trajectory(arguments.gt, arguments.gt_format)
    refuse_unknown(estimate)
    T_world_cam_true, remark = match_truth(estimate, truth)
    metrics = evaluate(
        estimate.T_world_cam, T_world_cam_true, estimate.T_curr_prev, cov=estimate.cov
    )
    metrics = replace(metrics, out_of_domain=estimate.out_of_domain, stopped=estimate.stopped)
    rows = metrics_rows(metrics)
    width = max(len(name) for name, _, _ in rows)
    print(columns((f"{name:<{width}}  {value}", text) for name, value, text in rows))
    if remark:
        print(remark)
    if arguments.run.is_dir():
        write_json(arguments.run / "metrics.json", metrics.as_dict())
        print(f"written: {arguments.run / 'metrics.json'}")


def read_run(folder: Path) -> Trajectory:
    """The motions that ``probevo run`` left in a folder."""
    from probevo.output.motions_file import read_motions

    path = folder / "motions.npz"
    if not path.exists():
        raise InputError(
            path,
            "this file is missing.",
            "Give the --out folder of `probevo run`, or a trajectory file.",
        )
    result = read_motions(path)
    poses = (result.T_world_cam, result.stamps_ns)
    motions = (result.T_curr_prev, result.cov)
    return Trajectory(path, *poses, *motions, result.out_of_domain, result.stopped)


def read_trajectory(path: Path, form: PoseFormat | None = None) -> Trajectory:
    """Poses in TUM or KITTI form, told apart by their number of columns.

    Raises:
        InputError: the file cannot be read, or has neither form.
    """
    from probevo.sequences.pose_files import read_kitti_poses, read_tum
    from probevo.sequences.text import read_lines

    if form is None:
        where, line = read_lines(path, "Give a file of poses, one a line.")[0]
        if "," in line:
            cure = (
                "Set blanks in place of commas. EuRoC's own truth is of the body: `probevo run`"
                " compares with it."
            )
            what = "its numbers are apart by commas; in KITTI's and TUM's form they are not."
            raise InputError(where, what, cure)
        if len(line.split()) not in COLUMNS:
            what = f"this line has {len(line.split())} columns."
            raise InputError(
                where, what, "Poses have 12 columns in KITTI's form and 8 in TUM's (stamp, t, q)."
            )
        form = COLUMNS[len(line.split())]
    if form == "kitti":
        return Trajectory(path, read_kitti_poses(path))
    stamps_ns, T_world_cam = read_tum(path)
    return Trajectory(path, T_world_cam, stamps_ns)


def refuse_unknown(estimate: Trajectory) -> None:
    """Refuse an estimate with poses that are not known, as only truth may have them.

    Raises:
        InputError: names the first of them.
    """
    import numpy as np

    for k in np.flatnonzero(np.isnan(estimate.T_world_cam).any(axis=(1, 2)))[:1]:
        raise InputError(
            estimate.where,
            f"pose {k} (from 0) is not known.",
            "An estimate has one for each frame.",
        )


def match_truth(estimate: Trajectory, truth: Trajectory) -> tuple[FloatArray, str]:
    """True pose of each estimated frame, [N, 4, 4], NaN where unknown; and a remark for the user,
    or nothing.

    Raises:
        InputError: the truth is too short, or fewer than two frames have a true pose.
    """
    import numpy as np

    frames = len(estimate.T_world_cam)
    poses = len(truth.T_world_cam)
    remark = ""
    if estimate.stamps_ns is not None and truth.stamps_ns is not None:
        from probevo.sequences.poses import interpolate_poses

        matched = interpolate_poses(truth.stamps_ns, truth.T_world_cam, estimate.stamps_ns)
        spans = [
            f"{s[0] * 1e-9:.3f} to {s[-1] * 1e-9:.3f} s"
            for s in (truth.stamps_ns, estimate.stamps_ns)
        ]
        cure = f"Its poses are of {spans[0]}, the frames of {spans[1]}: both need the same clock."
    else:
        if poses < frames:
            what = f"{poses} poses for the {frames} frames of {estimate.where}."
            raise InputError(
                truth.where,
                what,
                "Without times they are matched by number: give one for each frame.",
            )
        if poses > frames and truth.stamps_ns is not None:
            what = (
                f"{poses} poses for the {frames} frames of {estimate.where}, which has no times to"
                " match them by."
            )
            raise InputError(
                truth.where, what, "Give the run's folder or its trajectory.tum instead."
            )
        if poses > frames:
            remark = f"Compared with the first {frames} of {poses} true poses: the run has no more."
        matched = truth.T_world_cam[:frames]
        cure = "The others are nan."
    known = int(np.isfinite(matched).all(axis=(1, 2)).sum())
    if known < 2:
        raise InputError(
            truth.where, f"{known} of {frames} frames have a true pose; it takes two.", cure
        )
    if known < frames:
        remark = f"{frames - known} of {frames} frames have no true pose. {remark}".strip()
    return matched, remark
