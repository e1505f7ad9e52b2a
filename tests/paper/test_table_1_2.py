"""Thesis Table 1.2: its published rows, what is rendered and trained, and our rows beside them."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cli.rendering import write_wall
from output.pages import Balance
from output.test_trial_table import tabular, width
from paper.stand_ins import interrupt_run, stand_ins
from probevo.cli.main import main
from probevo.run_config import read_config
from probevo.sequences import open_sequence
from probevo.training.settings_check import check_settings
from probevo_paper.table_1_2 import ESTIMATORS, PUBLISHED, scenes
from probevo_paper.table_1_2_config import ROWS, Table12Config

FILES = {f"table_1_2.{suffix}" for suffix in ("html", "csv", "json", "tex", "txt")}


def run_table(out: Path, *words: str) -> int:
    return main(["paper", "table-1.2", "--out", str(out), *words])


def test_the_published_rows_are_those_of_the_paper() -> None:
    """Sums over the columns of the printed table."""
    assert tuple(PUBLISHED) == ROWS
    names = ("fixed", "student-t", "GK-GT", "GK-EM")
    sums = np.array([[row.errors[name] for name in names] for row in PUBLISHED.values()]).sum(
        axis=0
    )
    assert sums[:, 0] == pytest.approx([38.88, 24.23, 10.49, 22.20], abs=1e-9)
    assert sums[:, 1] == pytest.approx([0.340, 0.228, 0.1026, 0.159], abs=1e-9)
    assert sum(row.path_length_m for row in PUBLISHED.values()) == pytest.approx(1950.8)


def test_training_and_test_have_the_same_effects_but_other_streets() -> None:
    settings = Table12Config(street_m=30.0, road_m=50.0)
    assert scenes("synthetic", settings) is None
    for name, distance_m in (("city", 30.0), ("residential", 30.0), ("road", 50.0)):
        pair = scenes(name, settings)  # type: ignore[arg-type]
        assert pair is not None
        assert pair[0].model_copy(update={"seed": 2}) == pair[1]
        assert (pair[0].seed, pair[0].preset, pair[0].distance_m) == (1, name, distance_m)


@pytest.fixture(scope="module")
def repeated(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Repeat the synthetic row, a rendered one, and one of own recordings without truth."""
    root = tmp_path_factory.mktemp("table")
    train = write_wall(root / "a", truth=False)
    test = write_wall(root / "b")
    words = ["--rows", "synthetic", "city", "--train", str(train), "--test", str(test)]
    words += ["--max-frames", "4", "--gk.iterations", "3"]
    with stand_ins() as calls:
        assert run_table(root / "out", *words) == 0
    calls.out = root / "out"
    return calls


def test_each_row_is_trained_with_truth_and_without(repeated: Any) -> None:
    trained = [(c.out.stem, c.settings.kind, c.settings.supervision) for c in repeated.trainings]
    assert trained == [
        ("synthetic-student-t-fitted", "student-t", "gt"),
        ("synthetic-GK-GT", "gk", "gt"),
        ("synthetic-GK-EM", "gk", "none"),
        ("city-student-t-fitted", "student-t", "gt"),
        ("city-GK-GT", "gk", "gt"),
        ("city-GK-EM", "gk", "none"),
        ("own-student-t-fitted", "student-t", "none"),
        ("own-GK-EM", "gk", "none"),
    ]
    assert {(c.settings.kind, c.settings.gk.iterations) for c in repeated.trainings} == {
        ("gk", 3),
        ("student-t", 5),
    }
    for call in repeated.trainings:
        check_settings(call.settings)
    assert {c.settings.max_frames for c in repeated.trainings} == {4}
    calibrated = [c.settings.odometry.self_calibration for c in repeated.trainings]
    assert calibrated == [False] * 3 + [True] * 5
    assert [scene.seed for scene in repeated.scenes] == [1, 2]


def test_the_synthetic_world_is_that_of_the_paper(repeated: Any) -> None:
    test = open_sequence(repeated.out / "recordings" / "synthetic" / "test.npz")
    assert test.truth is not None
    steps_m = np.linalg.norm(np.diff(test.truth.T_world_cam[:, :3, 3], axis=0), axis=1)
    assert steps_m.sum() == pytest.approx(180.0, abs=0.1)


def test_the_runs_differ_in_their_noise_alone(repeated: Any) -> None:
    runs = repeated.out / "runs"
    assert len(list(runs.iterdir())) == 5 + 5 + 4
    for row, calibrates in (("synthetic", False), ("city", True)):
        configs = {name: read_config(runs / f"{row}-{name}" / "config.yaml") for name in ESTIMATORS}
        assert {config.self_calibration for config in configs.values()} == {calibrates}
        without_noise = {
            config.model_copy(update={"noise": ""}).model_dump_json() for config in configs.values()
        }
        assert len(without_noise) == 1
        assert configs["GK-EM"].noise == str(repeated.out / "models" / f"{row}-GK-EM.safetensors")
        assert [configs[name].noise for name in ("fixed", "student-t")] == ["fixed", "student-t"]


def test_ours_stand_beside_what_was_published(repeated: Any) -> None:
    out = repeated.out
    assert {path.name for path in out.iterdir()} == FILES | {"runs", "models", "recordings"}
    with (out / "table_1_2.csv").open() as file:
        lines = {(line["sequence"], line["estimator"]): line for line in csv.DictReader(file)}
    assert len(lines) == 14
    line = lines["city", "GK-EM"]
    assert (line["published_armse_m"], line["published_rot_armse_rad"]) == ("2.87", "0.018")
    assert lines["own", "GK-EM"]["published_armse_m"] == ""
    assert lines["city", "student-t fitted"]["published_armse_m"] == ""
    metrics = json.loads((out / "runs" / "city-GK-EM" / "metrics.json").read_text())
    assert [line[key] for key in ("armse_m", "rot_armse_rad")] == [
        repr(metrics[key]) for key in ("armse_m", "rot_armse_rad")
    ]
    assert len(json.loads((out / "table_1_2.json").read_text())["runs"]) == 14
    columns, rows = tabular((out / "table_1_2.tex").read_text())
    assert columns == "lr" + "rr" * 5
    assert {width(row) for row in rows} == {12}
    assert rows[1][2:4] == ["Trans. [m]", "Rot. [rad]"]
    published = [r"\quad published", "332.9", "3.84", "0.0320", "2.99", "0.0210", "--", "--"]
    assert rows[5] == [*published, r"\textbf{1.69}", r"\textbf{0.00460}", "2.87", "0.0180"]
    page = Balance()
    page.feed((out / "table_1_2.html").read_text())
    assert not page.open
    text = (out / "table_1_2.txt").read_text()
    assert (
        "No GK-GT where no truth is known to train with, and student-t fitted without it: own."
        in text
    )
    assert "5% outliers of up to 20 px" in text


def test_where_it_is_stopped_what_is_done_is_in_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupt_run(monkeypatch, 3)
    with stand_ins():
        assert run_table(tmp_path / "out", "--rows", "city", "--max-frames", "3") == 130
    assert "2 of 5 runs were finished; they are compared in" in capsys.readouterr().err
    assert "Stopped before all was run of city." in (tmp_path / "out" / "table_1_2.txt").read_text()


def test_mistakes_are_named_before_anything_is_rendered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wall = write_wall(tmp_path / "wall")
    other = write_wall(tmp_path / "other")
    calibration = other / "calib.yaml"
    calibration.write_text(calibration.read_text().replace("baseline_m: 0.3", "baseline_m: 0.6"))
    for words, fragment in (
        (["--train", str(wall)], "--train: is given without --test."),
        (["--test", str(wall)], "--test: is given without --train."),
        (["--train", str(wall), "--test", str(wall)], "is given twice"),
        (
            ["--train", str(wall), "--test", str(other)],
            f"--test: the camera of {other} is not that of {wall}: its baseline",
        ),
        (["--rows"], "--rows: no row is named."),
        (["--street-m", "0"], "--street-m is 0.0"),
    ):
        with stand_ins() as calls:
            assert run_table(tmp_path / "out", *words) == 2
        assert fragment in capsys.readouterr().err
        assert not calls.scenes
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
@pytest.mark.usefixtures("undrawn")
def test_in_the_point_world_the_whole_way(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is replaced, except that the reports of single runs are left out."""
    monkeypatch.setattr(
        "probevo.output.report.report.write_report", lambda path, *_, **__: path.touch()
    )
    words = [
        "--rows",
        "synthetic",
        "--max-frames",
        "8",
        "--gk.iterations",
        "1",
        "--gk.centers",
        "100",
    ]
    words += ["--gk.neighbors", "100", "--gk.prior-counts", "10", "--gk.reach", "1"]
    assert run_table(tmp_path, *words) == 0
    runs = json.loads((tmp_path / "table_1_2.json").read_text())["runs"]
    assert [run["estimator"] for run in runs] == list(ESTIMATORS)
    assert all(run["metrics"]["armse_m"] < 0.5 for run in runs)
