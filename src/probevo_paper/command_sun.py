"""``probevo paper sun``: thesis section 5.7 from the first drive to the last file."""

from __future__ import annotations

import csv
import io
from dataclasses import asdict, fields
from pathlib import Path

from probevo.cli.progress import progress_bar
from probevo.cli.text import table
from probevo.output.json_file import write_json
from probevo.storage.files import write_atomically
from probevo_paper.sun import (
    FAULTS,
    SUN_EVERY,
    SUN_NOISES_DEG,
    SunRow,
    experiment,
    simulate_drive,
)
from probevo_paper.sun_config import SunConfig

TABLE_HEAD = (
    "sun sensor",
    "heading, °",
    "at the end, °",
    "bound, °",
    "claimed, °",
    "× without",
    "rot. ARMSE, °",
    "trans. ARMSE, m",
    "excluded after",
)
NUM_ROWS = 1 + len(SUN_NOISES_DEG) * len(SUN_EVERY) + len(FAULTS)


def repeat_experiment(settings: SunConfig, out: Path) -> list[str]:
    """Repeat the experiment; return the lines to print.

    Args:
        settings: of drives and sensor.
        out: folder for sun.csv, sun.json and sun.txt.

    Raises:
        InputError: a file cannot be written.

    """
    with progress_bar("driving without a sun", "starting") as show:
        drives = []
        for index in range(settings.drives):
            drives.append(simulate_drive(settings, index))
            show(index + 1, settings.drives)
    rows = []
    with progress_bar("fusing the sun", "starting") as show:
        for row in experiment(drives, settings.seed):
            rows.append(row)
            show(len(rows), NUM_ROWS)
    way_m = settings.step_m * (settings.frames - 1)
    lines = [
        table(TABLE_HEAD, [cells(row, rows[0]) for row in rows]),
        "",
        f"{settings.drives} drives of {way_m:,.0f} m, sun {settings.elevation_deg:g}° high."
        " Heading: RMS over all frames; × without: at the end; bound: Cramér–Rao; excluded"
        " after so many sightings.",
    ]
    write_atomically(out / "sun.txt", "\n".join([*lines, ""]))
    write_atomically(out / "sun.csv", _csv(rows))
    write_json(
        out / "sun.json",
        {"settings": settings.model_dump(mode="json"), "rows": [asdict(row) for row in rows]},
    )
    return [*lines, str(out / "sun.csv")]


def cells(row: SunRow, without: SunRow) -> tuple[str, ...]:
    """Return a row of the table, under ``TABLE_HEAD``."""
    return (
        row.name,
        f"{row.heading_rms_deg:.2f}",
        f"{row.heading_end_deg:.2f}",
        "" if row.heading_bound_deg is None else f"{row.heading_bound_deg:.2f}",
        f"{row.claimed_deg:.2f}",
        f"{row.heading_end_deg / without.heading_end_deg:.2f}",
        f"{row.rot_armse_deg:.2f}",
        f"{row.trans_armse_m:.2f}",
        _exclusion(row),
    )


def _exclusion(row: SunRow) -> str:
    """Say after how many sightings the sensor was excluded, and in which share of the drives."""
    if row.excluded_after is None:
        return ""
    if row.excluded_drives == row.drives:
        return f"{row.excluded_after:.0f}"
    return f"{row.excluded_after:.0f}, in {row.excluded_drives} of {row.drives} drives"


def _csv(rows: list[SunRow]) -> str:
    """Return the rows at full precision, one a line."""
    buffer = io.StringIO()
    names = [field.name for field in fields(SunRow)]
    writer = csv.DictWriter(buffer, names, lineterminator="\n")
    writer.writeheader()
    writer.writerows(asdict(row) for row in rows)
    return buffer.getvalue()
