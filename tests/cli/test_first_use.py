"""The very first run: two processes compile, and the progress bar says so."""

import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import probevo as pv
from probevo.cli import first_use
from probevo.estimation import ransac
from probevo.sequences.frame import Frame


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[str]]:
    """The commands that would run in another process; none does."""
    commands: list[str] = []
    monkeypatch.setattr(subprocess, "Popen", lambda words, **_: commands.append(words[-1]))
    first_use.compile_solver.cache_clear()
    yield commands
    first_use.compile_solver.cache_clear()


def test_where_nothing_is_compiled_another_process_begins_with_the_solver(
    started: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_use, "solver_cache", lambda: tmp_path)
    monkeypatch.setattr("joblib.cpu_count", lambda: 2)
    assert [first_use.getting_ready() for _ in range(2)] == [
        "compiling, only this first time: 20 to 60 s"
    ] * 2
    assert started == ["from probevo.cli.first_use import solve_once; solve_once()"]


def test_one_core_compiles_in_one_process(
    started: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(first_use, "solver_cache", lambda: tmp_path)
    monkeypatch.setattr("joblib.cpu_count", lambda: 1)
    assert first_use.getting_ready().startswith("compiling")
    assert not started


def test_what_that_process_compiles_is_found_in_the_cache(started: list[str]) -> None:
    """It solves motions without RANSAC, which the other process compiles; after that, the solver
    counts as compiled."""
    step = pv.StereoOdometry.step
    motions = []

    def watched(odometry: pv.StereoOdometry, frame: Frame) -> pv.MotionEstimate:
        motions.append(step(odometry, frame))
        return motions[-1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(pv.StereoOdometry, "step", watched)
        patch.setattr(ransac, "_best_sample", None)
        first_use.solve_once()
    assert [motion.status for motion in motions[1:]] == [pv.Status.OK] * 3
    np.testing.assert_allclose(motions[-1].T_curr_prev[:3, 3], [0.0, 0.0, -1.0], atol=1e-3)
    assert first_use.is_solver_compiled()
    assert first_use.getting_ready() == "starting"
    assert not started
