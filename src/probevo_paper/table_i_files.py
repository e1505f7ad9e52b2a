"""What the Table I experiment came to, beside what was published: text, CSV, JSON, LaTeX and a
page."""

from __future__ import annotations

from pathlib import Path

from probevo import __version__
from probevo.output.comparison import Comparison, Entry, truth_note
from probevo.output.comparison_page import write_comparison
from probevo.output.trial_table import UNKNOWN, TrialRow, TrialTable, errors_of
from probevo_paper.table_files import write_table_files
from probevo_paper.table_i import ESTIMATORS, TRIALS, Plan, Trial

_BY_NAME = {trial.drive.name: trial for trial in TRIALS}


def table_of(comparison: Comparison, plan: Plan, max_frames: int | None) -> TrialTable:
    """Two rows a trial, ours and the published one.

    Args:
        comparison: the runs that are done, named as the trials and as ``ESTIMATORS``.
        plan: what was to be run, and what is missing.
        max_frames: where each trial was stopped, if it was.
    """
    rows: list[TrialRow] = []
    for name in comparison.sequences:
        trial = _BY_NAME[name]
        entries = {entry.estimator: entry for entry in comparison.of(name)}
        errors = tuple(errors_of(entries[key]) if key in entries else UNKNOWN for key in ESTIMATORS)
        lengths_m = [entry.metrics.path_length_m for entry in entries.values() if entry.metrics]
        published = tuple(trial.published.get(key, UNKNOWN) for key in ESTIMATORS)
        kind = f"{trial.kind} ({trial.training.number})"
        rows.append(TrialRow(name, errors, next(iter(lengths_m), None), kind=kind))
        rows.append(TrialRow("published", published, trial.path_length_m, is_aside=True))
    unfinished = [
        trial.drive.name
        for trial in plan.trials
        if len(comparison.of(trial.drive.name)) < len(ESTIMATORS)
    ]
    notes = ["In brackets: the drive of 26 September that PROBE is trained on."]
    notes += [f"Stopped before all was run of {', '.join(unfinished)}."] if unfinished else []
    notes += (
        [f"Only the first {max_frames} frames of each trial; published are whole drives."]
        if max_frames
        else []
    )
    return TrialTable(ESTIMATORS, tuple(rows), (*notes, *truth_note(comparison), *plan.missing))


def write_table(out: Path, comparison: Comparison, table: TrialTable, text: str) -> None:
    """Write table_i.html, .csv, .json, .tex and .txt, which holds the given text.

    Raises:
        InputError: a file cannot be written.
    """
    write_table_files(out / "table_i", comparison, table, text=text, published=_published)
    write_comparison(
        out / "table_i.html",
        comparison,
        "PROBE Table I on KITTI",
        facts={"probevo": __version__},
        trials=table,
    )


def _published(entry: Entry) -> dict[str, object]:
    """What PROBE says of a run; None of an estimator that it does not have."""
    trial: Trial = _BY_NAME[entry.sequence]
    armse_m, final_error_m = trial.published.get(entry.estimator, UNKNOWN)
    return {
        "type": trial.kind,
        "trained_on": trial.training.name,
        "published_path_length_m": trial.path_length_m,
        "published_armse_m": armse_m,
        "published_final_error_m": final_error_m,
    }
