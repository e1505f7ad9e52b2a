"""Files of a comparison: a line of CSV, or an object of JSON, for each run, at full precision."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import fields
from pathlib import Path

import numpy as np

from probevo import __version__
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.metrics import Metrics
from probevo.output.comparison.comparison import Comparison, Entry
from probevo.output.run_result import STEPS_WITHOUT_IMU_BY_FAULT
from probevo.output.table import records_table
from probevo.storage.files import write_atomically

STEPS = tuple(status for status in Status if status is not Status.FIRST)
_OF_SMOOTHED = tuple(Metrics(num_frames=0).of_path())
"""The errors in ``Metrics.smoothed``; each has a column, whether it is known or not."""
_PERCENTAGES = ("50", "90", "95", "99")
"""The ellipsoids in ``Metrics.nees_coverage``; each has a column, whether it is known or not."""


def flat_record(entry: Entry) -> dict[str, object]:
    """Describe a run by the cells of one line: names, number of steps by status, time, metrics.

    Metrics have the names of ``metrics.json``; its ``nees_coverage`` has a column for each
    percentage, its ``smoothed`` one for each error, and of ``faults`` there is only the sum, in
    which a step without an IMU counts once. None where unknown.
    """
    values: dict[str, object] = {field.name: None for field in fields(Metrics)}
    if entry.metrics is not None:
        values |= entry.metrics.as_dict()
    values["out_of_domain"] = entry.result.out_of_domain  # it needs no truth
    # Of all kinds, but not by cause what is counted already. They need no truth either.
    values["faults"] = sum(
        count
        for name, count in entry.result.faults.items()
        if name not in STEPS_WITHOUT_IMU_BY_FAULT
    )
    del values["nees_coverage"]
    del values["smoothed"]
    coverage = (entry.metrics and entry.metrics.nees_coverage) or {}
    smoothed = (entry.metrics and entry.metrics.smoothed) or {}
    return {
        "sequence": entry.sequence,
        "estimator": entry.estimator,
        "frames": len(entry.result),
        **{f"steps_{name}": count for name, count in steps_of(entry).items()},
        "ms_per_frame": _median_ms(entry),
        **values,
        **{f"nees_coverage_{percent}": coverage.get(percent) for percent in _PERCENTAGES},
        **{f"smoothed_{error}": smoothed.get(error) for error in _OF_SMOOTHED},
    }


def record(entry: Entry, folder: Path) -> dict[str, object]:
    """Describe a run as an object of JSON; the path of its report is relative to ``folder``."""
    report = None
    if entry.report is not None:
        report = Path(os.path.relpath(entry.report, folder)).as_posix()
    return {
        "sequence": entry.sequence,
        "estimator": entry.estimator,
        "frames": len(entry.result),
        "steps": steps_of(entry),
        "ms_per_frame": _median_ms(entry),
        "out_of_domain": entry.result.out_of_domain,
        "faults": entry.result.faults,
        "metrics": None if entry.metrics is None else entry.metrics.as_dict(),
        "report": report,
        "settings": None if entry.config is None else entry.config.model_dump(mode="json"),
    }


def steps_of(entry: Entry) -> dict[str, int]:
    """Count the steps of each status, by its name in lower case."""
    counts = Counter(entry.result.status.tolist())
    return {status.name.lower(): counts[int(status)] for status in STEPS}


def ranking_records(comparison: Comparison) -> dict[str, dict[str, object]]:
    """Describe who is best by each error of each sequence, as objects of JSON.

    For each rival there is the reduction by the best, % of the rival's error, with the ends of its
    interval, and the p-value that both are equally good.
    """
    records: dict[str, dict[str, object]] = {}
    for sequence, rankings in comparison.rankings.items():
        records[sequence] = {
            error: {
                "best": ranking.best,
                "against": {
                    rival: dict(
                        zip(
                            ("reduction_percent", "low_percent", "high_percent"),
                            difference.reduction_percent,
                            strict=True,
                        ),
                        p_value=difference.p_value,
                        is_significant=difference.is_significant,
                    )
                    for rival, difference in ranking.against.items()
                },
            }
            for error, ranking in rankings.items()
        }
    return records


def document(entries: Iterable[Entry], folder: Path) -> dict[str, object]:
    """Describe a comparison as an object of JSON: the version, and each run."""
    return {"probevo": __version__, "runs": [record(entry, folder) for entry in entries]}


def write_csv(path: Path, records: Iterable[Mapping[str, object]]) -> None:
    """Write records that all have the keys of the first; None becomes an empty cell.

    Raises:
        InputError: the file cannot be written.
    """
    write_atomically(path, records_table(records).as_csv())


def _median_ms(entry: Entry) -> float | None:
    return float(np.median(entry.result.total_ms)) if len(entry.result.total_ms) else None
