"""How many cores there are for this process; in a container, fewer than the machine has."""

from __future__ import annotations

import math
import os
from pathlib import Path


def available_cores(cgroup: Path = Path("/sys/fs/cgroup")) -> int:
    """The cores that this process may run on, or, if fewer, what its share of their time is worth,
    rounded up.

    The share is what ``docker run --cpus`` sets; the number of cores that the operating system
    tells ignores it.

    Args:
        cgroup: where the kernel tells the share, of version 2 or 1.
    """
    cores = (
        len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    )
    return max(1, math.ceil(min(cores, _share(cgroup))))


def _share(cgroup: Path) -> float:
    """How many cores' time the process may use; infinite where there is no limit, or none that can
    be read."""
    try:
        if (cgroup / "cpu.max").exists():
            quota, period = (cgroup / "cpu.max").read_text().split()
        else:
            quota, period = (
                (cgroup / "cpu" / f"cpu.cfs_{name}_us").read_text() for name in ("quota", "period")
            )
        return float(quota) / float(period) if float(quota) > 0 else math.inf
    except (OSError, ValueError):  # no Linux, or quota "max"
        return math.inf
