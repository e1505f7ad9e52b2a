"""Thesis Table 1.3 (PROBE-GK Table II): loop closure errors, learned by EM on the first loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.config.training import TrainSettings
from probevo.evaluation.trajectory_errors import path_length
from probevo.geometry import se3
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.trial_table import Errors, TrialRow, TrialTable
from probevo_paper.gk_tables import ESTIMATOR_NOTE, FITTED, GK_EM, STATIC
from probevo_paper.table_1_3_config import Table13Config
from probevo_sim.scene.config import Effects, SceneConfig

ESTIMATORS = (STATIC, FITTED, GK_EM)
EFFECTS = Effects(traffic=0.5, shadows=0.5, noise=0.3)
MEASURES = (("loop error", "m"),)
_UNKNOWN: Errors = (None,)


@dataclass(frozen=True)
class PublishedLoop:
    """A row of the printed table."""

    path_length_m: float
    errors_m: dict[str, float]
    """Loop closure error by the name of the estimator."""


# Length and loop closure errors in m.
_PRINTED_TABLE = """
trial  length  GK-EM  student-t
2      250.3   3.88   8.07
3      250.5   3.07   6.64
4      205.4   2.81   7.57
5      249.9   2.34   7.75
"""


def _read_row(line: str) -> tuple[str, PublishedLoop]:
    """Read the name and the figures of one line of the printed table."""
    number, *figures = line.split()
    length_m, kernel_m, static_m = (float(figure) for figure in figures)
    return f"trial {number}", PublishedLoop(length_m, {GK_EM: kernel_m, STATIC: static_m})


PUBLISHED = dict(_read_row(line) for line in _PRINTED_TABLE.strip().splitlines()[1:])


def loops(settings: Table13Config) -> dict[str, SceneConfig]:
    """Return the scenes by name: one field, driven around again and again.

    Their truth is only that each loop closes.
    """
    return {
        f"trial {drive + 1}": SceneConfig(
            preset="rover",
            drive=drive,
            distance_m=settings.distance_m,
            truth="loop",
            effects=EFFECTS,
        )
        for drive in range(settings.trials)
    }


def training_settings(settings: Table13Config) -> dict[str, TrainSettings]:
    """Return how each learned estimator is trained on the first loop: without ground truth."""
    runs = settings.run_settings()
    return {
        FITTED: settings.training_settings("student-t", "none", runs),
        GK_EM: settings.training_settings("gk", "none", runs),
    }


def loop_error_m(entry: Entry) -> float:
    """Return the distance from the estimated to the true end of the path, from a common start, m.

    The true end is where the truth has it, if it knows both ends; otherwise it is the start.
    """
    end = _from_first_to_last(entry.result.T_world_cam)
    if entry.truth is not None and knows_ends(entry):
        true_end = _from_first_to_last(entry.truth)
    else:
        true_end = np.eye(4)
    return float(np.linalg.norm(end[:3, 3] - true_end[:3, 3]))


def knows_ends(entry: Entry) -> bool:
    """Return whether the truth knows the poses of the first and the last frame."""
    return entry.truth is not None and bool(np.isfinite(entry.truth[[0, -1]]).all())


def _from_first_to_last(T_world_cam: FloatArray) -> FloatArray:
    """Return the last pose in the frame of the first, [4, 4]."""
    T_first_last: FloatArray = se3.inverse(T_world_cam[0]) @ T_world_cam[-1]
    return T_first_last


def table_of(comparison: Comparison, planned: tuple[str, ...], own: bool) -> TrialTable:
    """Return the table: all loops except the first, under each its published errors.

    Args:
        comparison: the finished runs, named as the loops and as ``ESTIMATORS``.
        planned: names of all loops, the training loop first.
        own: whether the loops are the user's, of which nothing is published.

    """
    rows: list[TrialRow] = []
    for name in planned[1:]:
        entries = {entry.estimator: entry for entry in comparison.of(name)}
        if not entries:
            continue
        errors = tuple(
            (loop_error_m(entries[key]),) if key in entries else _UNKNOWN for key in ESTIMATORS
        )
        length_m = path_length(next(iter(entries.values())).result.T_world_cam)
        rows.append(TrialRow(name, errors, length_m))
        if name in PUBLISHED and not own:
            loop = PUBLISHED[name]
            published = tuple((loop.errors_m.get(key),) for key in ESTIMATORS)
            rows.append(TrialRow("published", published, loop.path_length_m, is_aside=True))
    notes = _notes(comparison, planned, own)
    return TrialTable(ESTIMATORS, tuple(rows), notes, measures=MEASURES, form="thesis Table 1.3")


def _notes(comparison: Comparison, planned: tuple[str, ...], own: bool) -> tuple[str, ...]:
    """Return what a reader of the table should know, one sentence each."""
    notes = [
        "Distance of the end from where the loop closes, m; lengths are as estimated. Trained on"
        f" {planned[0]}.",
        ESTIMATOR_NOTE,
    ]
    if not own:
        notes.append("The loops are rendered here; published are those of a rover in the field.")
    assumed = dict.fromkeys(entry.sequence for entry in comparison.entries if not knows_ends(entry))
    if assumed:
        notes.append(
            f"Taken to end where it began, as no truth says otherwise: {', '.join(assumed)}."
        )
    unfinished = [name for name in planned[1:] if len(comparison.of(name)) < len(ESTIMATORS)]
    if unfinished:
        notes.append(f"Stopped before all was run of {', '.join(unfinished)}.")
    return tuple(notes)


def loop_columns(entry: Entry, own: bool) -> dict[str, object]:
    """Return the loop closure error of a run, and the published figures; None where there are none.

    Args:
        entry: the run.
        own: whether its loop is the user's, of which nothing is published.

    """
    loop = None if own else PUBLISHED.get(entry.sequence)
    return {
        "loop_error_m": loop_error_m(entry),
        "estimated_length_m": path_length(entry.result.T_world_cam),
        "published_path_length_m": loop.path_length_m if loop else None,
        "published_loop_error_m": loop.errors_m.get(entry.estimator) if loop else None,
    }
