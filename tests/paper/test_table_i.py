"""PROBE Table I: published rows, the part that a KITTI folder allows, and our rows beside them."""

import csv
import json
import shutil
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from output.test_trial_table import tabular, width
from paper.stand_ins import interrupt_run
from probevo.cli.main import main
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.noise import StudentT
from probevo.run_config import read_config
from probevo_paper.table_i import (
    CITY,
    ESTIMATORS,
    OURS,
    PROBE,
    RESIDENTIAL,
    ROAD,
    TRAINING_DRIVES,
    TRIALS,
    KittiDrive,
    plan_table,
    training_settings,
)
from probevo_paper.table_i_config import TableIConfig
from sequences.recordings import write_kitti_raw

FILES = {f"table_i.{suffix}" for suffix in ("html", "csv", "json", "tex", "txt")}


def with_drives(root: Path, *drives: KittiDrive) -> Path:
    for drive in drives:
        (root / drive.folder).mkdir(parents=True)
    return root


def drive_named(name: str) -> KittiDrive:
    return next(trial.drive for trial in TRIALS if trial.drive.name == name)


def repeat_table(kitti: Path, out: Path, *words: str) -> int:
    """Run the command; return its exit code."""
    return main(["paper", "table-i", "--kitti", str(kitti), "--out", str(out), *words])


@pytest.fixture(autouse=True)
def _without_reports(monkeypatch: pytest.MonkeyPatch) -> None:
    """Leave out the reports of single runs, which take most of the time."""
    monkeypatch.setattr(
        "probevo.output.report.report.write_report", lambda path, *_, **__: path.touch()
    )


@pytest.fixture
def trained() -> Iterator[list[SimpleNamespace]]:
    """Replace training and reading of models; record the trainings that were asked for."""
    calls: list[SimpleNamespace] = []

    def train_model(
        paths: tuple[Path, ...],
        settings: Any,
        out: Path,
        on_progress: Callable[[int, int], None],
        **_: Any,
    ) -> Path:
        calls.append(SimpleNamespace(paths=list(paths), settings=settings, out=out))
        on_progress(1, 2)
        out.parent.mkdir(parents=True, exist_ok=True)
        out.touch()
        return out

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("probevo.training.api.train_model", train_model)
        for reader in ("model_io", "named"):
            patch.setattr(f"probevo.noise.{reader}.load_model", lambda path: StudentT(dof=4.0))
        yield calls


def test_the_published_rows_are_those_of_the_paper() -> None:
    """Sums over the columns of the printed table."""
    assert len({trial.drive for trial in TRIALS}) == len(TRIALS) == 10
    sums = [
        sum(trial.published[name][measure] for trial in TRIALS)
        for name in ("nominal", "aggressive", "PROBE")
        for measure in (0, 1)
    ]
    assert sums == pytest.approx([32.117, 125.94, 29.29, 112.86, 26.95, 85.92], abs=1e-9)
    assert sum(trial.path_length_m for trial in TRIALS) == pytest.approx(4169.0)
    trained_on = {
        place: [trial.drive.name for trial in TRIALS if trial.training == drive]
        for drive, place in TRAINING_DRIVES.items()
    }
    assert {place: len(names) for place, names in trained_on.items()} == {
        "City": 5,
        "Residential": 2,
        "Road": 3,
    }
    assert "30_drive_0027" in trained_on["City"]
    assert CITY.folder == Path("2011_09_26/2011_09_26_drive_0005_sync")


def test_all_there_is_nothing_missing(tmp_path: Path) -> None:
    plan = plan_table(with_drives(tmp_path, *TRAINING_DRIVES, *(trial.drive for trial in TRIALS)))
    assert plan.trials == TRIALS
    assert plan.missing == ()
    assert plan.training_drives == (CITY, RESIDENTIAL, ROAD)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    present = [
        drive_named("26_drive_0051"),
        drive_named("26_drive_0022"),
        drive_named("30_drive_0016"),
    ]
    plan = plan_table(with_drives(tmp_path, CITY, ROAD, *present))
    assert [trial.drive.name for trial in plan.trials] == ["26_drive_0051", "30_drive_0016"]
    assert plan.training_drives == (CITY, ROAD)
    absent, untrained, blocked = plan.missing
    assert absent.startswith(
        "Absent trials: 26_drive_0104, 29_drive_0071, 26_drive_0117, 30_drive_0027,"
    )
    assert untrained == "Absent training drives: 26_drive_0046 (residential)."
    assert (
        blocked
        == "Not run, for want of the drive to train on: 26_drive_0022 (needs 26_drive_0046)."
    )


@pytest.mark.parametrize(
    ("present", "fragments"),
    [
        (
            [],
            [
                "holds none of the drives",
                "City: 2011_09_26/2011_09_26_drive_0005_sync, and one of 26_drive_0051",
            ],
        ),
        (
            [CITY, ROAD],
            [
                "has drives to train on, 26_drive_0005, 26_drive_0015, but no trial.",
                "26_drive_0104",
            ],
        ),
        (
            [drive_named("26_drive_0051")],
            ["has trials, 26_drive_0051, but none of the drives to train on for them."],
        ),
        (
            [CITY, drive_named("26_drive_0022")],
            ["has trials, 26_drive_0022, but none", "2011_09_26_drive_0046_sync"],
        ),
    ],
)
def test_nothing_to_run_is_an_error_that_says_what_is_needed(
    present: list[KittiDrive],
    fragments: list[str],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    root = with_drives(tmp_path / "kitti", *present)
    root.mkdir(exist_ok=True)
    assert repeat_table(root, tmp_path / "out") == 2
    shown = capsys.readouterr().err
    assert shown.startswith(f"probevo: --kitti: {root} ")
    for fragment in fragments:
        assert fragment in shown
    assert not (tmp_path / "out").exists()


def test_a_folder_that_is_none_or_too_deep(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for name, what in (("file", "is a file."), ("none", "is missing.")):
        with pytest.raises(InputError, match=what):
            plan_table(tmp_path / name)
    with_drives(tmp_path, CITY)
    with pytest.raises(InputError, match=f"Perhaps it is {tmp_path} that you mean"):
        plan_table(tmp_path / CITY.date)


def test_ours_stand_beside_what_was_published(
    tmp_path: Path, trained: list[SimpleNamespace], capsys: pytest.CaptureFixture[str]
) -> None:
    drive = write_kitti_raw(tmp_path / "kitti")
    for copy in (CITY, drive_named("26_drive_0051"), drive_named("26_drive_0104")):
        shutil.copytree(drive, tmp_path / "kitti" / copy.folder)
    out = tmp_path / "out"
    assert repeat_table(tmp_path / "kitti", out, "--seed", "4") == 0
    assert {path.name for path in out.iterdir()} == FILES | {"runs", "models"}
    as_published, ours = trained
    assert as_published.paths == ours.paths == [tmp_path / "kitti" / CITY.folder]
    assert (as_published.settings.contrast, ours.settings.supervision) == (0.0, "none")
    check_table(out, ["26_drive_0051", "26_drive_0104"])
    shown = capsys.readouterr().out
    assert shown.startswith("2 of 10 trials can be run.\n")
    text = (out / "table_i.txt").read_text()
    assert text in shown
    assert "Absent training drives: 26_drive_0046 (residential), 26_drive_0015 (road)." in text
    probe = read_config(out / "runs" / "26_drive_0104-PROBE" / "config.yaml")
    assert (probe.ransac.mode, probe.gyro.prefilter_deg, probe.seed) == ("off", 5.0, 4)
    assert probe.noise == str(out / "models" / "26_drive_0005-PROBE.safetensors")
    nominal, aggressive, student_t = (
        read_config(out / "runs" / f"26_drive_0051-{name}" / "config.yaml")
        for name in ESTIMATORS[:3]
    )
    assert [nominal.noise, aggressive.noise, student_t.noise] == ["fixed", "fixed", "student-t"]
    assert [nominal.ransac.confidence, aggressive.ransac.confidence] == [0.99, 0.9999]


def check_table(out: Path, trials: list[str]) -> None:
    """Check CSV and JSON against the metrics of the runs and the published figures, and LaTeX."""
    runs = json.loads((out / "table_i.json").read_text())["runs"]
    with (out / "table_i.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [(run["sequence"], run["estimator"]) for run in runs] == [
        (t, e) for t in trials for e in ESTIMATORS
    ]
    for run, line in zip(runs, lines, strict=True):
        metrics = json.loads(
            (out / "runs" / f"{run['sequence']}-{run['estimator']}" / "metrics.json").read_text()
        )
        assert run["metrics"] == metrics
        assert [line[key] for key in ("armse_m", "final_error_m")] == [
            repr(metrics[key]) for key in ("armse_m", "final_error_m")
        ]
    by_name = {(line["sequence"], line["estimator"]): line for line in lines}
    line = by_name["26_drive_0051", "PROBE"]
    assert line["published_armse_m"] == "3.48"
    assert line["published_final_error_m"] == "8.07"
    assert line["trained_on"] == "26_drive_0005"
    assert by_name["26_drive_0051", "student-t"]["published_armse_m"] == ""
    columns, rows = tabular((out / "table_i.tex").read_text())
    assert columns == "llr" + "rr" * 5
    assert {width(row) for row in rows} == {13}
    assert rows[3] == [
        *(r"\quad published", "", "251.1", "4.84", "12.6"),
        *(r"\textbf{3.30}", "8.62", "--", "--", "3.48", r"\textbf{8.07}", "--", "--"),
    ]


def test_where_it_is_stopped_what_is_done_is_in_the_table(
    tmp_path: Path,
    trained: list[SimpleNamespace],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    drive = write_kitti_raw(tmp_path / "kitti")
    for copy in (CITY, drive_named("26_drive_0051")):
        shutil.copytree(drive, tmp_path / "kitti" / copy.folder)
    interrupt_run(monkeypatch, 2)
    assert repeat_table(tmp_path / "kitti", tmp_path / "out", "--max-frames", "3") == 130
    assert "1 of 5 runs were finished; they are compared in" in capsys.readouterr().err
    text = (tmp_path / "out" / "table_i.txt").read_text()
    assert "Stopped before all was run of 26_drive_0051." in text
    assert "Only the first 3 frames of each trial" in text


@pytest.mark.data
def test_a_real_drive_under_the_names_of_a_trial_and_its_training(
    tmp_path: Path, trained: list[SimpleNamespace], data_root: Path
) -> None:
    date = data_root / "kitti_raw" / CITY.date
    (tmp_path / "kitti" / CITY.date).mkdir(parents=True)
    for drive in (CITY, drive_named("26_drive_0051")):
        (tmp_path / "kitti" / drive.folder).symlink_to(date / CITY.folder.name)
    assert repeat_table(tmp_path / "kitti", tmp_path / "out", "--max-frames", "6") == 0
    check_table(tmp_path / "out", ["26_drive_0051"])
    for estimator in ESTIMATORS:
        metrics = json.loads(
            (tmp_path / "out" / "runs" / f"26_drive_0051-{estimator}" / "metrics.json").read_text()
        )
        assert metrics["final_error_m"] < 0.5


def test_models_are_trained_for_the_settings_of_the_runs() -> None:
    given = TableIConfig.model_validate(
        {"seed": 7, "self_calibration": False, "tracking": {"window_px": 21}}
    )
    published, ours = training_settings(given).values()
    for training in (published, ours):
        assert training.odometry.seed == 7
        assert not training.odometry.self_calibration
        assert training.odometry.tracking.window_px == 21
    assert (published.odometry.ransac.mode, published.odometry.gyro.prefilter_deg) == ("off", 5.0)
    assert ours.odometry.ransac.mode != "off"
    assert training_settings(TableIConfig())[PROBE] == TrainSettings.published()
    assert training_settings(TableIConfig())[OURS] == TrainSettings(supervision="none")
