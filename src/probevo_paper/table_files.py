"""The files that repeat a table of the papers, except its page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from probevo import __version__
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.comparison.comparison_files import flat_record, record, write_csv
from probevo.output.json_file import write_json
from probevo.output.trial_table import TrialTable, trials_latex
from probevo.storage.files import write_atomically


def write_table_files(
    stem: Path,
    comparison: Comparison,
    table: TrialTable,
    *,
    text: str,
    published_of: Callable[[Entry], Mapping[str, object]],
    more: Mapping[str, object] | None = None,
) -> None:
    """Write a table as .csv, .json, .tex and .txt.

    Args:
        stem: path of the files without their suffix.
        comparison: the runs.
        table: the runs in the form of the paper.
        text: the table for the terminal.
        published_of: returns the published figures of a run, with the same keys for all runs; None
            where nothing was published.
        more: further entries of the JSON file.

    Raises:
        InputError: a file cannot be written.

    """
    entries = comparison.entries
    write_csv(
        stem.with_suffix(".csv"),
        ({**published_of(entry), **flat_record(entry)} for entry in entries),
    )
    document = {
        "probevo": __version__,
        "notes": table.notes,
        **(more or {}),
        "runs": [{**published_of(entry), **record(entry, stem.parent)} for entry in entries],
    }
    write_json(stem.with_suffix(".json"), document)
    write_atomically(stem.with_suffix(".tex"), trials_latex(table))
    write_atomically(stem.with_suffix(".txt"), text)
