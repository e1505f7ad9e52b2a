"""The drift that stands for a run: the longest segments that fit."""

from __future__ import annotations

from probevo.evaluation.metrics import Metrics
from probevo.output.headline import HeadlineDrift, headline_drift


def test_long_segments_take_precedence() -> None:
    short = Metrics(5, short_t_percent=4.0, short_r_deg_per_m=0.02)
    both = Metrics(
        5, kitti_t_percent=6.5, kitti_r_deg_per_m=0.01, short_t_percent=4.0, short_r_deg_per_m=0.02
    )
    assert headline_drift(Metrics(5)) is None
    assert headline_drift(short) == HeadlineDrift(4.0, 0.02, "10 to 50")
    assert headline_drift(both) == HeadlineDrift(6.5, 0.01, "100 to 800")
