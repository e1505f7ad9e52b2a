"""The results of the experiment of thesis Table 1.2 beside the published ones, as files."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from probevo import __version__
from probevo.output.comparison.comparison import Comparison, Entry, truth_note
from probevo.output.comparison.comparison_page import write_comparison
from probevo.output.trial_table import UNKNOWN, Errors, TrialRow, TrialTable
from probevo_paper.gk_tables import ESTIMATOR_NOTE, FITTED, GK_GT
from probevo_paper.table_1_2 import ESTIMATORS, OWN, PUBLISHED, SYNTHETIC
from probevo_paper.table_files import write_table_files

STEM = "table_1_2"
MEASURES = (("trans.", "m"), ("rot.", "rad"))


def table_of(
    comparison: Comparison, planned: Collection[str], without_truth: Collection[str]
) -> TrialTable:
    """Return the table with two rows a place: our errors, and the published ones.

    Args:
        comparison: the finished runs, named as the rows and as ``ESTIMATORS``.
        planned: names of the rows that were to be run.
        without_truth: the drives that have no ground truth to train with.

    """
    rows: list[TrialRow] = []
    for name in comparison.sequences:
        entries = {entry.estimator: entry for entry in comparison.of(name)}
        errors = tuple(_errors(entries[key]) if key in entries else UNKNOWN for key in ESTIMATORS)
        lengths_m = [entry.metrics.path_length_m for entry in entries.values() if entry.metrics]
        rows.append(TrialRow(name, errors, next(iter(lengths_m), None)))
        if name in PUBLISHED:
            row = PUBLISHED[name]
            published = tuple(row.errors.get(key, UNKNOWN) for key in ESTIMATORS)
            rows.append(TrialRow("published", published, row.path_length_m, is_aside=True))
    notes = (
        *_notes(planned, without_truth),
        *_unfinished(comparison, planned, without_truth),
        *truth_note(comparison),
    )
    return TrialTable(ESTIMATORS, tuple(rows), notes, measures=MEASURES, form="thesis Table 1.2")


def _errors(entry: Entry) -> Errors:
    """Return the errors of a run in the order of ``MEASURES``."""
    return (entry.metrics.armse_m, entry.metrics.rot_armse_rad) if entry.metrics else UNKNOWN


def _notes(planned: Collection[str], without_truth: Collection[str]) -> list[str]:
    """Return what a reader should know of the recordings, one sentence each."""
    notes = ["ARMSE of translation, m, and of rotation, rad.", ESTIMATOR_NOTE]
    if "synthetic" in planned:
        noise = SYNTHETIC.noise
        outliers = SYNTHETIC.outliers
        notes.append(
            f"Synthetic: noise from {noise.sigma_low_px:g} px at the bottom of the image to"
            f" {noise.sigma_high_px:g} px at its top, {outliers.fraction:.0%} outliers of up to"
            f" {outliers.range_px:g} px, no self-calibration."
        )
    rendered = [name for name in planned if name not in ("synthetic", OWN)]
    if rendered:
        notes.append(
            f"Rendered, each trained on other streets: {', '.join(rendered)}; published are longer"
            " drives of KITTI."
        )
    if without_truth:
        notes.append(
            f"No {GK_GT} where no truth is known to train with, and {FITTED} without it:"
            f" {', '.join(without_truth)}."
        )
    return notes


def _unfinished(
    comparison: Comparison, planned: Collection[str], without_truth: Collection[str]
) -> list[str]:
    """Name the rows of which not every run was finished; without truth there is no GK-GT."""
    unfinished = []
    for name in planned:
        runs = len(ESTIMATORS) - 1 if name in without_truth else len(ESTIMATORS)
        if len(comparison.of(name)) < runs:
            unfinished.append(name)
    return [f"Stopped before all was run of {', '.join(unfinished)}."] if unfinished else []


def write_table(out: Path, comparison: Comparison, table: TrialTable, text: str) -> None:
    """Write table_1_2.html, .csv, .json, .tex and .txt, the last with the given text.

    Raises:
        InputError: a file cannot be written.

    """
    write_table_files(out / STEM, comparison, table, text=text, published_of=_published_columns)
    write_comparison(
        out / f"{STEM}.html",
        comparison,
        "Learned noise without truth: thesis Table 1.2",
        facts={"probevo": __version__},
        trials=table,
    )


def _published_columns(entry: Entry) -> dict[str, object]:
    """Return the published figures of a run; None where nothing was published."""
    row = PUBLISHED.get(entry.sequence)
    trans_m, rot_rad = row.errors.get(entry.estimator, UNKNOWN) if row else UNKNOWN
    return {
        "published_path_length_m": row.path_length_m if row else None,
        "published_armse_m": trans_m,
        "published_rot_armse_rad": rot_rad,
    }
