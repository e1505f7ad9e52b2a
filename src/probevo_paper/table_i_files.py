"""The results of the Table I experiment beside the published ones, as files and a page."""

from __future__ import annotations

from pathlib import Path

from probevo import __version__
from probevo.output.comparison.comparison import Comparison, Entry, truth_note
from probevo.output.comparison.comparison_page import write_comparison
from probevo.output.trial_table import UNKNOWN, TrialRow, TrialTable, errors_of
from probevo_paper.table_files import write_table_files
from probevo_paper.table_i import ESTIMATORS, TRIALS, TablePlan

_TRIAL_BY_NAME = {trial.drive.name: trial for trial in TRIALS}


def table_of(comparison: Comparison, plan: TablePlan, max_frames: int | None) -> TrialTable:
    """Return the table with two rows a trial: our errors, and the published ones.

    Args:
        comparison: the finished runs, named as the trials and as ``ESTIMATORS``.
        plan: the trials that were to be run, and what is missing.
        max_frames: the number of frames that each trial was limited to, if it was.

    """
    rows: list[TrialRow] = []
    for name in comparison.sequences:
        trial = _TRIAL_BY_NAME[name]
        entries = {entry.estimator: entry for entry in comparison.of(name)}
        errors = tuple(errors_of(entries[key]) if key in entries else UNKNOWN for key in ESTIMATORS)
        lengths_m = [entry.metrics.path_length_m for entry in entries.values() if entry.metrics]
        place = f"{trial.place} ({trial.training.number})"
        rows.append(TrialRow(name, errors, next(iter(lengths_m), None), kind=place))
        published = tuple(trial.published.get(key, UNKNOWN) for key in ESTIMATORS)
        rows.append(TrialRow("published", published, trial.path_length_m, is_aside=True))
    notes = _notes(comparison, plan, max_frames)
    return TrialTable(ESTIMATORS, tuple(rows), notes)


def _notes(comparison: Comparison, plan: TablePlan, max_frames: int | None) -> tuple[str, ...]:
    """Return what a reader of the table should know, one sentence each."""
    notes = ["In brackets: the drive of 26 September that PROBE is trained on."]
    names = [trial.drive.name for trial in plan.trials]
    unfinished = [name for name in names if len(comparison.of(name)) < len(ESTIMATORS)]
    if unfinished:
        notes.append(f"Stopped before all was run of {', '.join(unfinished)}.")
    if max_frames:
        notes.append(
            f"Only the first {max_frames} frames of each trial; published are whole drives."
        )
    return (*notes, *truth_note(comparison), *plan.missing)


def write_table(out: Path, comparison: Comparison, table: TrialTable, text: str) -> None:
    """Write table_i.html, .csv, .json, .tex and .txt, the last with the given text.

    Raises:
        InputError: a file cannot be written.

    """
    write_table_files(
        out / "table_i", comparison, table, text=text, published_of=_published_columns
    )
    write_comparison(
        out / "table_i.html",
        comparison,
        "PROBE Table I on KITTI",
        facts={"probevo": __version__},
        trials=table,
    )


def _published_columns(entry: Entry) -> dict[str, object]:
    """Return the published figures of a run; None for an estimator that PROBE does not have."""
    trial = _TRIAL_BY_NAME[entry.sequence]
    armse_m, final_error_m = trial.published.get(entry.estimator, UNKNOWN)
    return {
        "type": trial.place,
        "trained_on": trial.training.name,
        "published_path_length_m": trial.path_length_m,
        "published_armse_m": armse_m,
        "published_final_error_m": final_error_m,
    }
