"""Figures of runs for notebooks and scripts: the same as those of the reports."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from probevo.arrays import FloatArray
from probevo.errors import InputError, brief
from probevo.output.motions_file import read_motions
from probevo.output.run_result import RunResult
from probevo.python_arguments import as_path
from probevo.sequences.frame import GroundTruth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from probevo.output.comparison.comparison import Entry
    from probevo.runs.runner import Run

KINDS = ("path", "error")


def plot(
    *runs: RunResult | Run | str | Path,
    truth: FloatArray | GroundTruth | None = None,
    names: tuple[str, ...] = (),
    kind: Literal["path", "error"] = "path",
) -> Figure:
    """Draw runs over the same recording: their paths from above, or their errors.

    A notebook shows the figure; ``figure.savefig("path.png")`` writes it.

    Args:
        runs: results, or folders of ``probevo run``.
        truth: true poses T_world_cam, [N, 4, 4], m, NaN where unknown, or the truth of a sequence;
            by default those of the first ``Run`` that has them.
        names: names of the runs, for the legend; by default their folders or their numbers.
        kind: ``path`` from above, forward up, over the true one; or ``error``, the distance from
            the true position along the path, beside the 3σ that each run claims.

    Raises:
        InputError: there is no run, or one of fewer than two frames; names or truth do not fit; or
            a folder is not that of a run.
    """
    # Only now: Matplotlib takes half a second.
    from probevo.output.comparison.comparison_plots import errors_figure, paths_figure
    from probevo.output.svg import CYCLE, figure_style

    if kind not in KINDS:
        raise InputError("kind", f"is {brief(kind)}.", f"Choose one of {', '.join(KINDS)}.")
    entries = _entries(runs, truth, names)
    colors = {entry.estimator: CYCLE[k % len(CYCLE)] for k, entry in enumerate(entries)}
    draw = paths_figure if kind == "path" else errors_figure
    with figure_style():
        return draw(entries, colors)


def _entries(
    runs: tuple[RunResult | Run | str | Path, ...],
    truth: FloatArray | GroundTruth | None,
    names: tuple[str, ...],
) -> list[Entry]:
    """Read and check the runs.

    Raises:
        InputError: as ``plot`` raises.
    """
    from probevo.output.comparison.comparison import Entry
    from probevo.runs.runner import Run

    if not runs:
        raise InputError("runs", "there is none.", "Give a result, or the folder of a run.")
    if names and len(names) != len(runs):
        raise InputError(
            "names", f"{len(names)} names for {len(runs)} runs.", "Name each, or none."
        )
    entries = []
    for k, run in enumerate(runs):
        if isinstance(run, Run):
            result = run.result
            truth = run.truth if truth is None else truth
        elif isinstance(run, RunResult):
            result = run
        else:
            result = read_motions(as_path(run, "runs"))
        if len(result) < 2:
            raise InputError("runs", f"run {k + 1} has {len(result)} frames.", "Two are needed.")
        default = Path(run).resolve().name if isinstance(run, str | Path) else f"run {k + 1}"
        name = names[k] if names else default
        entries.append(Entry(sequence="", estimator=name, result=result))
    if truth is None:
        return entries
    cure = "Give poses T_world_cam, [N, 4, 4], or the truth of a sequence."
    poses = truth.T_world_cam if isinstance(truth, GroundTruth) else truth
    try:
        true = np.asarray(poses, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError("truth", f"is {brief(truth)}.", cure) from error
    if true.ndim != 3 or true.shape[1:] != (4, 4):
        raise InputError("truth", f"has shape {true.shape}.", cure)
    short = [len(entry.result) for entry in entries if len(entry.result) > len(true)]
    if short:
        raise InputError("truth", f"has {len(true)} poses for {short[0]} frames.")
    return [replace(entry, truth=true[: len(entry.result)]) for entry in entries]
