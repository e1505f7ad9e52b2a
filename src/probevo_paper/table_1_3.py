"""Thesis Table 1.3 (PROBE-GK Table II): loops, the first to learn from by EM, how far the others
are from closing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo.evaluation.trajectory_errors import path_length
from probevo.geometry import se3
from probevo.output.comparison import Comparison, Entry
from probevo.output.trial_table import Errors, TrialRow, TrialTable
from probevo.training.settings import TrainSettings
from probevo_paper.kernel_trials import ESTIMATOR_NOTE, FITTED, GK_EM, STATIC
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
    """Loop closure error of the two estimators."""


PUBLISHED = {
    f"trial {number}": PublishedLoop(length_m, {GK_EM: kernel_m, STATIC: static_m})
    for number, length_m, kernel_m, static_m in (
        (2, 250.3, 3.88, 8.07),
        (3, 250.5, 3.07, 6.64),
        (4, 205.4, 2.81, 7.57),
        (5, 249.9, 2.34, 7.75),
    )
}


def loops(settings: Table13Config) -> dict[str, SceneConfig]:
    """The same field driven around again and again, by name; it is known only that each loop
    closes."""
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


def trainings(settings: Table13Config) -> dict[str, TrainSettings]:
    """How each learned estimator is trained on the first loop: without truth."""
    runs = settings.shared()
    return {
        FITTED: settings.training("student-t", "none", runs),
        GK_EM: settings.training("gk", "none", runs),
    }


def loop_error_m(entry: Entry) -> float:
    """How far the end lies from where it should be, the starts made equal, m.

    That is where the truth says, if it knows both ends; else the start.
    """
    end = _from_first_to_last(entry.result.T_world_cam)
    true_end = (
        np.eye(4)
        if not knows_ends(entry) or entry.truth is None
        else _from_first_to_last(entry.truth)
    )
    return float(np.linalg.norm(end[:3, 3] - true_end[:3, 3]))


def knows_ends(entry: Entry) -> bool:
    """Whether the truth knows the poses of the first and the last frame."""
    return entry.truth is not None and bool(np.isfinite(entry.truth[[0, -1]]).all())


def table_of(comparison: Comparison, planned: tuple[str, ...], own: bool) -> TrialTable:
    """The loops but for the first; under each what was published of it.

    Args:
        comparison: the runs that are done, named as the loops and as ``ESTIMATORS``.
        planned: names of all loops, the one to train on first.
        own: whether they are the user's, and nothing is published of them.
    """
    rows: list[TrialRow] = []
    for name in planned[1:]:
        entries = {entry.estimator: entry for entry in comparison.of(name)}
        if not entries:
            continue
        errors = tuple(
            (loop_error_m(entries[key]),) if key in entries else _UNKNOWN for key in ESTIMATORS
        )
        rows.append(
            TrialRow(name, errors, path_length(next(iter(entries.values())).result.T_world_cam))
        )
        if name in PUBLISHED and not own:
            row = PUBLISHED[name]
            published = tuple((row.errors_m.get(key),) for key in ESTIMATORS)
            rows.append(TrialRow("published", published, row.path_length_m, is_aside=True))
    notes = _notes(comparison, planned, own)
    return TrialTable(ESTIMATORS, tuple(rows), notes, measures=MEASURES, form="thesis Table 1.3")


def _notes(comparison: Comparison, planned: tuple[str, ...], own: bool) -> tuple[str, ...]:
    notes = [
        "How far the end is from where the loop closes, m; lengths are as estimated. Trained on"
        f" {planned[0]}."
    ]
    notes.append(ESTIMATOR_NOTE)
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


def published(entry: Entry, own: bool) -> dict[str, object]:
    """The loop closure error of a run, and what PROBE-GK says of it; None where it says nothing."""
    row = None if own else PUBLISHED.get(entry.sequence)
    return {
        "loop_error_m": loop_error_m(entry),
        "estimated_length_m": path_length(entry.result.T_world_cam),
        "published_path_length_m": row.path_length_m if row else None,
        "published_loop_error_m": row.errors_m.get(entry.estimator) if row else None,
    }


def _from_first_to_last(T_world_cam: FloatArray) -> FloatArray:
    ends: FloatArray = se3.inverse(T_world_cam[0]) @ T_world_cam[-1]
    return ends
