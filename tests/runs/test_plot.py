"""Figures for notebooks: what they draw, and what is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

import probevo as pv
from probevo.errors import InputError
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.geometry import se3
from probevo.output.motions_file import write_motions
from probevo.output.run_result import RunRecorder, RunResult
from probevo.sequences.frame import GroundTruth


def run(count: int, turn_rad: float = 0.02) -> RunResult:
    recorder = RunRecorder()
    for k in range(count):
        T = se3.exp(np.array([0.0, 0.0, -1.0, 0.0, turn_rad, 0.0]))
        cov = 1e-5 * np.eye(6)
        status = Status.OK if k else Status.FIRST
        recorder.add(k * 10**8, MotionEstimate(T, cov, status, num_tracks=9))
    return recorder.result()


def legend(figure: Figure) -> list[str]:
    shown = figure.axes[0].get_legend()
    assert shown is not None
    return [text.get_text() for text in shown.get_texts()]


def test_paths_are_drawn_with_their_names(tmp_path: Path) -> None:
    (tmp_path / "mine").mkdir()
    write_motions(tmp_path / "mine" / "motions.npz", run(30))
    figure = pv.plot(run(30, 0.01), str(tmp_path / "mine"))
    assert legend(figure)[:2] == ["run 1", "mine"]
    lines = [np.asarray(line.get_xydata()) for line in figure.axes[0].get_lines()]
    expected = run(30).T_world_cam[-1, [0, 2], 3]
    assert any(np.allclose(line[-1], expected) for line in lines if len(line) == 30)


def test_errors_against_the_truth_are_drawn(tmp_path: Path) -> None:
    good = run(30)
    figure = pv.plot(run(30, 0.021), truth=good.T_world_cam, names=("bad",), kind="error")
    assert legend(figure) == ["bad", "3σ claimed"]
    figure.savefig(tmp_path / "error.png")
    assert (tmp_path / "error.png").stat().st_size > 5_000
    assert "truth" in legend(pv.plot(good, truth=good.T_world_cam))
    truth = GroundTruth(np.arange(len(good)), good.T_world_cam)
    assert "truth" in legend(pv.plot(good, truth=truth))


REFUSED: dict[str, tuple[tuple[Any, ...], dict[str, Any], str]] = {
    "nothing": ((), {}, "runs: there is none"),
    "one frame": ((run(1),), {}, "run 1 has 1 frames"),
    "no folder": (("missing",), {}, "missing"),
    "another type": ((7,), {}, "runs: is 7"),
    "names": ((run(3),), {"names": ("a", "b")}, "names: 2 names for 1 runs"),
    "kind": ((run(3),), {"kind": "map"}, "kind: is 'map'"),
    "truth of another shape": ((run(3),), {"truth": np.eye(4)}, r"truth: has shape \(4, 4\)"),
    "truth of no numbers": ((run(3),), {"truth": ["a", "b"]}, "truth: is "),
    "truth too short": ((run(3),), {"truth": np.zeros((2, 4, 4))}, "2 poses for 3 frames"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_drawn_is_refused(case: str) -> None:
    runs, options, what = REFUSED[case]
    with pytest.raises(InputError, match=what):
        pv.plot(*runs, **options)
