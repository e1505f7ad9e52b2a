"""Warnings to the reader of a run, in words."""

from __future__ import annotations

import numpy as np

from probevo.arrays import IntArray
from probevo.estimation.motion_estimate import Status
from probevo.output.domain import domain_warning
from probevo.output.run_result import RunResult

FEWEST_OK = 0.5
"""Share of steps that have to be OK for a run to be usable."""
_CAUSES = {
    Status.DEGENERATE: "features that are all far away or few, or a wrong baseline or focal length",
    Status.TOO_FEW_TRACKS: (
        "dark, blurred or bare pictures, or left and right not rectified or of different times"
    ),
    Status.NOT_CONVERGED: (
        "stamps or an IMU in wrong units, a wrong calibration, or frames out of order"
    ),
    Status.GAP: "missing frames, or wrong stamps",
}


def run_warnings(result: RunResult) -> dict[str, str]:
    """Return heading and text of each warning."""
    stopped = None
    if result.stopped:
        stopped = f"After {len(result):,} frames: {result.stopped}"
    warnings = {
        "Stopped before the end": stopped,
        "Hardly a step is OK": status_warning(result.status),
        "Out of domain": domain_warning(result.out_of_domain),
    }
    return {heading: text for heading, text in warnings.items() if text}


def status_warning(status: IntArray) -> str | None:
    """Warn if less than half of the steps, [N-1], are OK, and name the usual cause; else None."""
    num_ok = int(np.sum(status == Status.OK))
    if num_ok >= FEWEST_OK * len(status):
        return None
    found, counts = np.unique(status[status != Status.OK], return_counts=True)
    prevailing = Status(found[counts.argmax()])
    name = prevailing.name.replace("_", " ").lower()
    return (
        f"Only {num_ok:,} of {len(status):,} steps are OK, and the path is not reliable. Most"
        f" others are {name}, which usually comes of {_CAUSES[prevailing]}: see `probevo info"
        " SEQUENCE`."
    )
