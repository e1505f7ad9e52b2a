"""Fabricated runs, shared by the tests of output."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.geometry import se3
from probevo.output import svg
from probevo.output.run_result import RunRecorder, RunResult

STEP_NS = 103_500_000


@pytest.fixture(autouse=True)
def not_laid_out(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out Matplotlib's constrained layout, which is half of the time of a page.

    A test that is marked ``layout`` has it.
    """
    if request.node.get_closest_marker("layout") is None:
        monkeypatch.setitem(svg._STYLE, "figure.constrained_layout.use", False)


@pytest.fixture(scope="session")
def make_run() -> Callable[..., RunResult]:
    """Makes a run of that many frames along a gentle curve; the same but for its times, whatever
    ``hurry``.

    Of the 100 features that each step used, ``outside`` are out of domain.
    """

    def make(
        count: int, speed: float = 1.0, hurry: float = 1.0, outside: int | None = None
    ) -> RunResult:
        rng = np.random.default_rng(0)
        recorder = RunRecorder()
        first = MotionEstimate(np.eye(4), np.zeros((6, 6)), Status.FIRST, num_tracks=0)
        for k in range(count):
            xi = speed * np.array([0.0, 0.0, -1.0, 0.0, 0.02, 0.0]) + rng.normal(0.0, 0.001, 6)
            stages = {"track": hurry * rng.uniform(4, 6), "solve": hurry * rng.uniform(0.5, 1)}
            status = Status.GAP if k % 40 == 39 else Status.OK
            tracks = int(rng.integers(200, 300))
            motion = MotionEstimate(
                se3.exp(xi),
                1e-5 * np.eye(6),
                status,
                num_tracks=tracks,
                stage_ms=stages,
                num_used=100,
                num_out_of_domain=outside,
            )
            recorder.add(
                10**18 + k * STEP_NS,
                motion if k else first,
                rejected={"row offset": 3, "flow": 5} if k else {},
            )
        return recorder.result()

    return make
