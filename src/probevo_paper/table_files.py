"""The files that repeat a table of the papers: all that is not the page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

from probevo import __version__
from probevo.files import write_atomically
from probevo.output.comparison import Comparison, Entry
from probevo.output.comparison_files import flat_record, record, write_csv
from probevo.output.files import write_json
from probevo.output.trial_table import TrialTable, trials_latex


def write_table_files(
    stem: Path,
    comparison: Comparison,
    table: TrialTable,
    text: str,
    published: Callable[[Entry], Mapping[str, object]],
    more: Mapping[str, object] | None = None,
) -> None:
    """Write a table as .csv, .json, .tex and .txt.

    Args:
        stem: the files, but for their suffix.
        comparison: the runs.
        table: them in the form of the paper.
        text: the same for the terminal.
        published: what the paper says of a run, with the same keys for all; None where it says
            nothing.
        more: what else goes into the JSON file.

    Raises:
        InputError: a file cannot be written.
    """
    write_csv(
        stem.with_suffix(".csv"), ({**published(e), **flat_record(e)} for e in comparison.entries)
    )
    runs = [{**published(entry), **record(entry, stem.parent)} for entry in comparison.entries]
    write_json(
        stem.with_suffix(".json"),
        {"probevo": __version__, "notes": table.notes, **(more or {}), "runs": runs},
    )
    write_atomically(stem.with_suffix(".tex"), trials_latex(table))
    write_atomically(stem.with_suffix(".txt"), text)
