"""Thesis Table 1.3: loop closure errors, iterations of EM, and our rows beside the published."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.rendering import write_wall
from output.pages import Balance
from output.test_trial_table import tabular
from paper.stand_ins import ITERATIONS, interrupt_run, stand_ins
from probevo.arrays import FloatArray
from probevo.cli.main import main
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.geometry import se3
from probevo.output.comparison.comparison import Entry
from probevo.output.run_result import RunRecorder
from probevo_paper.table_1_3 import ESTIMATORS, PUBLISHED, knows_ends, loop_error_m, loops
from probevo_paper.table_1_3_config import Table13Config
from probevo_paper.table_1_3_page import progress_figure

FILES = {f"table_1_3.{suffix}" for suffix in ("html", "csv", "json", "tex", "txt")}


def entry(*forward_m: float, truth: FloatArray | None = None) -> Entry:
    """Return a run that drives straight ahead in such steps."""
    recorder = RunRecorder()
    recorder.add(0, MotionEstimate(np.eye(4), np.zeros((6, 6)), Status.FIRST, num_tracks=0))
    for k, step_m in enumerate(forward_m, start=1):
        T_curr_prev = se3.exp(np.array([0.0, 0.0, -step_m, 0.0, 0.0, 0.0]))
        recorder.add(k, MotionEstimate(T_curr_prev, np.eye(6), Status.OK, num_tracks=9))
    return Entry("trial 2", "student-t", recorder.result(), truth=truth)


def test_the_published_rows_are_those_of_the_paper() -> None:
    """Sums over the columns of the printed table."""
    assert sum(row.path_length_m for row in PUBLISHED.values()) == pytest.approx(956.1)
    assert sum(row.errors_m["GK-EM"] for row in PUBLISHED.values()) == pytest.approx(12.10)
    assert sum(row.errors_m["student-t"] for row in PUBLISHED.values()) == pytest.approx(30.03)
    assert list(PUBLISHED) == list(loops(Table13Config()))[1:]


def test_the_loops_are_of_one_field() -> None:
    scenes = loops(Table13Config(trials=3, distance_m=20.0))
    assert [scene.drive for scene in scenes.values()] == [0, 1, 2]
    assert {scene.truth for scene in scenes.values()} == {"loop"}
    fields = {scene.model_copy(update={"drive": 0}).model_dump_json() for scene in scenes.values()}
    assert len(fields) == 1


def test_the_error_of_a_loop_is_the_distance_from_its_true_end() -> None:
    assert loop_error_m(entry(3.0, -2.5)) == pytest.approx(0.5, abs=1e-12)
    world = se3.exp(np.array([4.0, -5.0, 6.0, 0.3, -0.2, 0.9]))
    end = se3.exp(np.array([0.3, 0.4, 0.5, 0.1, 0.0, 0.0]))
    truth = np.stack([world, np.full((4, 4), np.nan), world @ end])
    known = entry(3.0, -2.5, truth=truth)
    assert knows_ends(known)
    assert loop_error_m(known) == pytest.approx(
        np.linalg.norm(end[:3, 3] - [0.0, 0.0, 0.5]), abs=1e-12
    )


def test_a_truth_that_does_not_know_the_end_says_nothing() -> None:
    truth = np.stack([np.eye(4), np.eye(4), np.full((4, 4), np.nan)])
    assert not knows_ends(entry(3.0, -2.5, truth=truth))
    assert loop_error_m(entry(3.0, -2.5, truth=truth)) == pytest.approx(0.5, abs=1e-12)


def test_the_iterations_of_em_are_drawn_beside_the_static_model() -> None:
    likelihood, gap = progress_figure(ITERATIONS, 0.75).axes
    assert np.asarray(likelihood.lines[0].get_ydata()).tolist() == [-3.0, -2.5]
    static, em = gap.lines
    assert np.asarray(static.get_ydata()).tolist() == [0.75, 0.75]
    assert np.asarray(em.get_ydata()).tolist() == [0.5, 0.25]
    assert gap.get_ylim()[1] > 0.75
    assert len(progress_figure(ITERATIONS, None).axes[1].lines) == 1
    assert len(progress_figure([{"log_likelihood": -1.0}] * 3, 0.75).axes) == 1


def test_ours_stand_beside_what_was_published(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with stand_ins() as calls:
        assert main(["paper", "table-1.3", "--out", str(tmp_path), "--trials", "3"]) == 0
    assert {path.name for path in tmp_path.iterdir()} == FILES | {"runs", "models", "recordings"}
    assert len(calls.scenes) == 3
    trained = [(call.settings.kind, call.settings.supervision) for call in calls.trainings]
    assert trained == [("student-t", "none"), ("gk", "none")]
    with (tmp_path / "table_1_3.csv").open() as file:
        lines = list(csv.DictReader(file))
    names = [(line["sequence"], line["estimator"]) for line in lines]
    assert names == [
        ("trial 1", "student-t"),
        *((f"trial {k}", name) for k in (2, 3) for name in ESTIMATORS),
    ]
    published = [line["published_loop_error_m"] for line in lines]
    assert published == ["", "8.07", "", "3.88", "6.64", "", "3.07"]
    document = json.loads((tmp_path / "table_1_3.json").read_text())
    assert (document["trained_on"], document["iterations"]) == ("trial 1", ITERATIONS)
    assert [run["loop_error_m"] for run in document["runs"]] == [
        float(line["loop_error_m"]) for line in lines
    ]
    columns, rows = tabular((tmp_path / "table_1_3.tex").read_text())
    assert columns == "lrrrr"
    assert rows[3] == [r"\quad published", "250.3", "8.07", "--", r"\textbf{3.88}"]
    assert (tmp_path / "table_1_3.txt").read_text() in capsys.readouterr().out
    check_page(tmp_path, ["trial 2", "trial 3"])


def check_page(out: Path, shown: list[str]) -> None:
    """Check that the page is whole, fetches nothing, and leads to the reports of the runs."""
    page = Balance()
    page.feed((out / "table_1_3.html").read_text())
    assert not page.open
    assert len(page.ids) == len(set(page.ids))
    reports = [link for link in page.links if not link.startswith(("#", "data:"))]
    wanted = [f"runs/{name}-{estimator}/report.html" for name in shown for estimator in ESTIMATORS]
    assert [link.replace("%20", " ") for link in reports] == wanted
    assert all((out / link).exists() for link in wanted)


def test_own_loops_are_taken_to_close(tmp_path: Path) -> None:
    paths = [write_wall(tmp_path / name, truth=name == "b") for name in "abc"]
    out = tmp_path / "out"
    with stand_ins([{"log_likelihood": -1.0}, {"log_likelihood": -0.5}]) as calls:
        assert main(["paper", "table-1.3", "--out", str(out), "--loops", *map(str, paths)]) == 0
    assert not calls.scenes
    assert {c.recordings for c in calls.trainings} == {(paths[0],)}
    text = (out / "table_1_3.txt").read_text()
    assert "Taken to end where it began, as no truth says otherwise: a, c." in text
    assert "published" not in text.splitlines()[3]
    errors_m = {(r["sequence"], r["estimator"]): r["loop_error_m"] for r in runs_of(out)}
    assert errors_m["b", "student-t"] < 0.1 < 0.9 < errors_m["c", "student-t"]
    check_page(out, ["b", "c"])
    assert "No truth says where the loop ends" in (out / "table_1_3.html").read_text()


def runs_of(out: Path) -> list[dict[str, Any]]:
    runs: list[dict[str, Any]] = json.loads((out / "table_1_3.json").read_text())["runs"]
    return runs


def test_where_it_is_stopped_what_is_done_is_in_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupt_run(monkeypatch, 2)
    with stand_ins():
        assert main(["paper", "table-1.3", "--out", str(tmp_path), "--trials", "2"]) == 130
    assert [run["sequence"] for run in runs_of(tmp_path)] == ["trial 1"]
    assert "Stopped before all was run of trial 2." in (tmp_path / "table_1_3.txt").read_text()


def test_loops_that_will_not_do_are_refused_before_the_training(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_wall(tmp_path / "a")
    other = write_wall(tmp_path / "b")
    calibration = other / "calib.yaml"
    calibration.write_text(calibration.read_text().replace("baseline_m: 0.3", "baseline_m: 0.6"))
    for words, fragment in (
        ([path], "--loops: only one recording is named."),
        ([path, path], "is given twice"),
        ([path, other], f"--loops: the camera of {other} is not that of {path}: its baseline"),
    ):
        command = ["paper", "table-1.3", "--out", str(tmp_path / "out"), "--loops"]
        with stand_ins() as calls:
            assert main([*command, *map(str, words)]) == 2
        assert fragment in capsys.readouterr().err
        assert not calls.trainings
    assert not (tmp_path / "out").exists()
