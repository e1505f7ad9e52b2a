"""The one figure of drift that stands for a run, in the terminal and in its report."""

from __future__ import annotations

from typing import NamedTuple

from probevo.evaluation.metrics import Metrics


class HeadlineDrift(NamedTuple):
    """Drift over the longest segments that fit into the run."""

    translation_percent: float
    rotation_deg_per_m: float
    segments: str
    """Lengths of the segments, m."""


def headline_drift(metrics: Metrics) -> HeadlineDrift | None:
    """Return KITTI's drift over 100 to 800 m, or that over 10 to 50 m of a shorter run.

    Returns:
        None if the run is shorter than all of them.
    """
    if metrics.kitti_t_percent is not None and metrics.kitti_r_deg_per_m is not None:
        return HeadlineDrift(metrics.kitti_t_percent, metrics.kitti_r_deg_per_m, "100 to 800")
    if metrics.short_t_percent is not None and metrics.short_r_deg_per_m is not None:
        return HeadlineDrift(metrics.short_t_percent, metrics.short_r_deg_per_m, "10 to 50")
    return None
