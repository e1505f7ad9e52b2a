"""A comparison as data: one line, or one object, for each run, at full precision."""

from __future__ import annotations

import csv
import io
import os
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np

from probevo import __version__
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.metrics import Metrics
from probevo.files import write_atomically
from probevo.output.comparison import Entry

STEPS = tuple(status for status in Status if status is not Status.FIRST)
_PERCENTAGES = ("50", "90", "95", "99")
"""Of the ellipsoids in ``Metrics.nees_coverage``; columns for them there are in any case."""


def flat_record(entry: Entry) -> dict[str, object]:
    """A run as the cells of one line: whose, how many steps of each status, the median time, every
    metric.

    Names are those of ``metrics.json``; its ``nees_coverage`` has a column for each percentage.
    None where unknown.
    """
    values = {field.name: None for field in fields(Metrics)} | (
        entry.metrics.as_dict() if entry.metrics else {}
    )
    coverage = values.pop("nees_coverage") or {}
    shares = (
        {f"nees_coverage_{key}": coverage.get(key) for key in _PERCENTAGES}
        if isinstance(coverage, dict)
        else {}
    )
    steps = {f"steps_{name}": count for name, count in steps_of(entry).items()}
    whose = {"sequence": entry.sequence, "estimator": entry.estimator}
    values["out_of_domain"] = entry.result.out_of_domain  # it needs no truth
    return (
        whose
        | {"frames": len(entry.result)}
        | steps
        | {"ms_per_frame": _median_ms(entry)}
        | values
        | shares
    )


def record(entry: Entry, folder: Path) -> dict[str, object]:
    """A run as an object of JSON; the path of its report is relative to ``folder``."""
    report = (
        None if entry.report is None else Path(os.path.relpath(entry.report, folder)).as_posix()
    )
    return {
        "sequence": entry.sequence,
        "estimator": entry.estimator,
        "frames": len(entry.result),
        "steps": steps_of(entry),
        "ms_per_frame": _median_ms(entry),
        "out_of_domain": entry.result.out_of_domain,
        "metrics": None if entry.metrics is None else entry.metrics.as_dict(),
        "report": report,
        "settings": None if entry.config is None else entry.config.model_dump(mode="json"),
    }


def steps_of(entry: Entry) -> dict[str, int]:
    """How many steps have each status, by its name."""
    counts = Counter(entry.result.status.tolist())
    return {status.name.lower(): counts[int(status)] for status in STEPS}


def document(entries: Iterable[Entry], folder: Path) -> dict[str, object]:
    """All of a comparison as an object of JSON: the version, and each run."""
    return {"probevo": __version__, "runs": [record(entry, folder) for entry in entries]}


def write_csv(path: Path, records: Iterable[Mapping[str, object]]) -> None:
    """Write records that all have the keys of the first; numbers at full precision, None as
    nothing."""
    records = list(records)
    buffer = io.StringIO()
    writer = csv.DictWriter(buffer, fieldnames=list(records[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(records)
    write_atomically(path, buffer.getvalue())


def _median_ms(entry: Entry) -> float | None:
    return float(np.median(entry.result.total_ms)) if len(entry.result.total_ms) else None
