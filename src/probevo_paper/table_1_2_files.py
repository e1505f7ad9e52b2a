"""What the experiment of thesis Table 1.2 came to, beside what was published: text, CSV, JSON,
LaTeX and a page."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

from probevo import __version__
from probevo.output.comparison import Comparison, Entry, truth_note
from probevo.output.comparison_page import write_comparison
from probevo.output.trial_table import UNKNOWN, Errors, TrialRow, TrialTable
from probevo_paper.kernel_trials import ESTIMATOR_NOTE, FITTED, GK_GT
from probevo_paper.table_1_2 import ESTIMATORS, OWN, PUBLISHED, SYNTHETIC
from probevo_paper.table_files import write_table_files

STEM = "table_1_2"
MEASURES = (("trans.", "m"), ("rot.", "rad"))


def table_of(
    comparison: Comparison, planned: Collection[str], untrue: Collection[str]
) -> TrialTable:
    """Two rows a place, ours and the published one.

    Args:
        comparison: the runs that are done, named as the rows and as ``ESTIMATORS``.
        planned: names of the rows that were to be run.
        untrue: of those, which have no truth to train with.
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
        *_notes(planned, untrue),
        *_unfinished(comparison, planned, untrue),
        *truth_note(comparison),
    )
    return TrialTable(ESTIMATORS, tuple(rows), notes, measures=MEASURES, form="thesis Table 1.2")


def _notes(planned: Collection[str], untrue: Collection[str]) -> list[str]:
    notes = ["ARMSE of translation, m, and of rotation, rad.", ESTIMATOR_NOTE]
    rendered = [name for name in planned if name not in ("synthetic", OWN)]
    if "synthetic" in planned:
        share = SYNTHETIC.outliers.fraction
        range_px = SYNTHETIC.outliers.range_px
        notes.append(
            f"Synthetic: noise from {SYNTHETIC.noise.sigma_low_px:g} px at the bottom of the image"
            f" to {SYNTHETIC.noise.sigma_high_px:g} px at its top, {share:.0%} outliers of up to"
            f" {range_px:g} px, no self-calibration."
        )
    if rendered:
        places = ", ".join(rendered)
        notes.append(
            f"Rendered, each trained on other streets: {places}; published are longer drives of"
            " KITTI."
        )
    if untrue:
        notes.append(
            f"No {GK_GT} where no truth is known to train with, and {FITTED} without it:"
            f" {', '.join(untrue)}."
        )
    return notes


def _unfinished(
    comparison: Comparison, planned: Collection[str], untrue: Collection[str]
) -> list[str]:
    counts = {name: len(ESTIMATORS) - (name in untrue) for name in planned}
    names = [name for name, count in counts.items() if len(comparison.of(name)) < count]
    return [f"Stopped before all was run of {', '.join(names)}."] if names else []


def _errors(entry: Entry) -> Errors:
    return (entry.metrics.armse_m, entry.metrics.rot_armse_rad) if entry.metrics else UNKNOWN


def write_table(out: Path, comparison: Comparison, table: TrialTable, text: str) -> None:
    """Write table_1_2.html, .csv, .json, .tex and .txt, which holds the given text.

    Raises:
        InputError: a file cannot be written.
    """
    write_table_files(out / STEM, comparison, table, text=text, published=_published)
    title = "Learned noise without truth: thesis Table 1.2"
    write_comparison(
        out / f"{STEM}.html", comparison, title, facts={"probevo": __version__}, trials=table
    )


def _published(entry: Entry) -> dict[str, object]:
    """What PROBE-GK says of a run; None where it says nothing."""
    row = PUBLISHED.get(entry.sequence)
    trans_m, rot_rad = row.errors.get(entry.estimator, UNKNOWN) if row else UNKNOWN
    return {
        "published_path_length_m": row.path_length_m if row else None,
        "published_armse_m": trans_m,
        "published_rot_armse_rad": rot_rad,
    }
