"""``probevo compare``: that its tables hold what the runs say, and that mistakes are found before
the first run."""

import csv
import io
import json
import os
import re
import shutil
import sys
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any
from urllib.parse import unquote_to_bytes

import numpy as np
import pytest

from output.pages import Balance
from output.test_trial_table import tabular, width
from probevo.camera.stereo import StereoCamera
from probevo.cli.main import main
from probevo.errors import InputError
from probevo.noise import StudentT
from probevo.run_config import read_config
from probevo_sim.point_config import PointConfig
from probevo_sim.point_world import write_training_and_test

SHORT = PointConfig(train_s=0.5, test_s=1.0)
RUNS = [
    f"{sequence}-{estimator}"
    for sequence in ("a-test", "b-test")
    for estimator in ("fixed", "student-t", "city")
]


def compare_exit(*words: object) -> int:
    return main(["compare", *map(str, words)])


OF_BLIND = {"recordings": [{"name": "blind.npz", "frames": 11, "sha256": ""}]}
"""What a model's training says of its recordings."""


class Learned(StudentT):
    """A model that knows its camera: it refuses a wide baseline."""

    def check_camera(self, camera: StereoCamera) -> None:
        if camera.baseline_m > 0.6:
            raise InputError("city.safetensors", "was learned with another camera.")


@pytest.fixture(scope="module", autouse=True)
def _loader() -> Any:
    """In place of reading model files."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "probevo.noise.named.load_model", lambda path: Learned(dof=4.0, training=OF_BLIND)
        )
        yield


@pytest.fixture(scope="module", autouse=True)
def _without_reports() -> Any:
    """Those of the single runs take most of the time; here they are empty."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "probevo.output.report.report.write_report", lambda path, *_, **__: path.touch()
        )
        yield


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of two recordings that are called alike, one without truth, and a model file; change
    none of them."""
    root = tmp_path_factory.mktemp("compare")
    for seed, name in enumerate("ab"):
        write_training_and_test(SHORT.model_copy(update={"seed": seed}), root / name)
    with np.load(root / "a" / "train.npz") as archive:
        np.savez(
            root / "blind.npz",
            **{key: archive[key] for key in archive.files if key != "T_world_cam"},
        )
    (root / "models").mkdir()
    (root / "models" / "city.safetensors").touch()
    return root


@pytest.fixture(scope="module")
def out(world: Path) -> Path:
    """Folder of a comparison of three estimators on two recordings; what it printed is in
    "printed.txt" beside it."""
    out = world / "out"
    printed = io.StringIO()
    noise = ["fixed", "student-t", world / "models" / "city.safetensors"]
    with redirect_stdout(printed):
        assert (
            compare_exit(
                world / "a/test.npz", world / "b/test.npz", "--out", out, "--noise", *noise
            )
            == 0
        )
    out.with_name("printed.txt").write_text(printed.getvalue())
    return out


def test_a_model_that_has_seen_a_recording_is_marked(
    world: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    noise = ["fixed", world / "models" / "city.safetensors"]
    assert (
        compare_exit(
            world / "blind.npz", world / "a/test.npz", "--out", world / "seen", "--noise", *noise
        )
        == 0
    )
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert next(line[:2] for line in lines if line and line[0] == "city") == ["city", "†"]
    assert sum("†" in line for line in lines) == 1


def test_what_is_written(out: Path) -> None:
    files = {"comparison.html", "comparison.csv", "comparison.json", "table.tex", "runs"}
    assert {path.name for path in out.iterdir()} == files
    assert {path.name for path in (out / "runs").iterdir()} == set(RUNS)


def test_csv_and_json_hold_the_metrics_of_the_runs(out: Path) -> None:
    document = json.loads((out / "comparison.json").read_text())
    assert set(document["rankings"]) == {"a-test", "b-test"}
    runs = document["runs"]
    with (out / "comparison.csv").open() as file:
        lines = list(csv.DictReader(file))
    assert [f"{run['sequence']}-{run['estimator']}" for run in runs] == RUNS
    assert [f"{line['sequence']}-{line['estimator']}" for line in lines] == RUNS
    for name, run, line in zip(RUNS, runs, lines, strict=True):
        metrics = json.loads((out / "runs" / name / "metrics.json").read_text())
        assert run["metrics"] == metrics
        for key, value in metrics.items():
            if not isinstance(value, dict):
                assert line[key] == ("" if value is None else repr(value))
        assert run["steps"]["ok"] == int(line["steps_ok"]) == 10
        assert (out / run["report"]).exists()


def test_the_page_leads_to_the_report_of_each_run(out: Path) -> None:
    parsed = Balance()
    page = (out / "comparison.html").read_text()
    parsed.feed(page)
    assert not parsed.open
    links = re.findall(r'<a href="(.*?)"', page)
    assert links == [f"runs/{name}/report.html" for name in RUNS]
    assert all((out / link).exists() for link in links)
    assert "In the form of PROBE Table I" in page
    assert str(out.parent / "models" / "city.safetensors") in page


def test_latex_has_a_row_a_recording(out: Path) -> None:
    columns, rows = tabular((out / "table.tex").read_text())
    assert columns == "lrrrrrrr"
    assert {width(row) for row in rows} == {8}
    assert [row[0] for row in rows[2:]] == ["a-test", "b-test"]


def test_the_table_is_printed(out: Path) -> None:
    lines = out.with_name("printed.txt").read_text().splitlines()
    names = [re.split(r"\s\s+", line.strip())[0] for line in lines[2:10]]
    assert names == ["a-test", "fixed", "student-t", "city", "b-test", "fixed", "student-t", "city"]
    assert lines[-1] == f"comparison: {out / 'comparison.html'}"


def test_the_config_of_a_run_repeats_it(out: Path, tmp_path: Path) -> None:
    run = out / "runs" / "b-test-city"
    assert read_config(run / "config.yaml").noise == str(out.parent / "models" / "city.safetensors")
    assert main(["run", "--config", str(run / "config.yaml"), "--out", str(tmp_path)]) == 0
    assert (tmp_path / "trajectory.tum").read_bytes() == (run / "trajectory.tum").read_bytes()


def test_settings_hold_for_all_runs_but_aggressive_has_its_own_confidence(
    world: Path, tmp_path: Path
) -> None:
    (tmp_path / "settings.yaml").write_text(
        "noise: nonsense\nsequence: nowhere\nsensor: [none]\nmax_frames: 9\nseed: 5\n"
    )
    words = ["--config", tmp_path / "settings.yaml", "--max-frames", 4, "--ransac.confidence", 0.95]
    noise = ["--noise", "fixed", "aggressive"]
    assert compare_exit(world / "a/test.npz", "--out", tmp_path / "out", *words, *noise) == 0
    runs = tmp_path / "out" / "runs"
    fixed, aggressive = (
        read_config(runs / f"test-{name}" / "config.yaml") for name in ("fixed", "aggressive")
    )
    assert (fixed.seed, fixed.max_frames, fixed.noise, fixed.sequence) == (
        5,
        4,
        "fixed",
        world / "a/test.npz",
    )
    assert (fixed.ransac.confidence, aggressive.ransac.confidence) == (0.95, 0.9999)
    same = {"ransac": fixed.ransac.model_copy(update={"confidence": 0.9999})}
    assert aggressive == fixed.model_copy(update=same)


def test_without_truth_there_are_dashes_and_that_is_said(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert compare_exit(world / "blind.npz", world / "a/train.npz", "--out", tmp_path / "out") == 0
    page = (tmp_path / "out" / "comparison.html").read_text()
    sentence = "blind: no truth is known, and so no error: nothing says which estimator is better."
    assert sentence in capsys.readouterr().out
    assert sentence in page
    note = "No truth is known, and so no error: blind."
    assert note in page
    source = (tmp_path / "out" / "table.tex").read_text()
    assert source.startswith(f"% {note}\n")
    assert tabular(source)[1][2] == ["blind", "--", "--", "--", "--", "--"]
    run = json.loads((tmp_path / "out" / "comparison.json").read_text())["runs"][0]
    assert run["metrics"] is None


def test_models_of_the_same_name_are_distinguished(world: Path, tmp_path: Path) -> None:
    files = [
        tmp_path / name
        for name in ("x/city.safetensors", "y/city.safetensors", "x/fixed.safetensors")
    ]
    for file in files:
        file.parent.mkdir(exist_ok=True)
        file.touch()
    assert (
        compare_exit(world / "a/train.npz", "--out", tmp_path / "out", "--noise", "fixed", *files)
        == 0
    )
    names = {path.name for path in (tmp_path / "out" / "runs").iterdir()}
    assert names == {"train-fixed", "train-x-city", "train-y-city", "train-x-fixed"}


def test_what_is_done_when_it_is_stopped_is_compared(
    world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from probevo.cli import run

    names: list[str] = []
    original = run.run_with_progress

    def stopping(*arguments: Any, **others: Any) -> Any:
        names.append(others["name"])
        if len(names) == 3:
            raise KeyboardInterrupt
        return original(*arguments, **others)

    monkeypatch.setattr(run, "run_with_progress", stopping)
    assert compare_exit(world / "a/test.npz", world / "b/test.npz", "--out", tmp_path) == 130
    assert f"2 of 4 runs were finished; they are compared in {tmp_path}." in capsys.readouterr().err
    assert names == ["1 of 4: a-test fixed", "2 of 4: a-test student-t", "3 of 4: b-test fixed"]
    runs = json.loads((tmp_path / "comparison.json").read_text())["runs"]
    assert [run["sequence"] for run in runs] == ["a-test", "a-test"]
    assert (tmp_path / "comparison.html").exists()


@pytest.mark.parametrize(
    ("words", "fragments"),
    [
        ([], ["SEQUENCE: no recording is named."]),
        (["W/a/test.npz", "W/nowhere"], ["nowhere: nothing is there."]),
        (["W/a/test.npz", "W/a/../a/test.npz"], ["test.npz is given twice."]),
        (
            ["W/a/test.npz", "W/b/test.npz", "--truth", "poses.tum"],
            ["--truth: poses.tum would be the truth of 2 recordings."],
        ),
        (["W/a/test.npz", "--noise"], ["--noise: no estimator is named."]),
        (
            ["W/a/test.npz", "--noise", "fixed", "student-t", "fixed"],
            ["--noise: fixed is given twice."],
        ),
        (
            ["W/a/test.npz", "--noise", "M", "W/models/../models/city.safetensors"],
            ["is given twice."],
        ),
        (
            ["W/a/test.npz", "--noise", "fixed", "agressive"],
            ["noise: 'agressive' is", "Did you mean aggressive?"],
        ),
        (["W/a/test.npz", "--noise", "W/none.safetensors"], ["noise: ", "no such file exists."]),
        (["W/a/test.npz", "W/wide/test.npz", "--noise", "M"], ["was learned with another camera."]),
        (["W/a/test.npz", "--gyro.prior"], ["--gyro.prior: the recording", "has no IMU."]),
        (
            ["W/a/test.npz", "--ransac.confidence", "2"],
            ["--ransac.confidence is 2.0; it should be less than 1."],
        ),
        (["W/a/test.npz", "--threads", "0"], ["--threads", "at least 1"]),
        (["W/a/test.npz", "--out", "W/blind.npz"], ["--out: ", "is a file."]),
        (["W/a/test.npz", "--config", "W/none.yaml"], ["none.yaml", "missing"]),
    ],
)
def test_mistakes_are_found_before_the_first_run(
    words: list[str],
    fragments: list[str],
    world: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    if any("wide" in word for word in words):
        wide = SHORT.camera.model_copy(update={"baseline_m": 0.7})
        write_training_and_test(SHORT.model_copy(update={"camera": wide}), world / "wide")
    model = str(world / "models" / "city.safetensors")
    given = [
        word.replace("W/", f"{world}/").replace("M", model) if word != "M" else model
        for word in words
    ]
    assert main(["compare", "--out", str(tmp_path / "out"), *given]) == 2
    shown = capsys.readouterr().err
    assert shown.startswith("probevo: ")
    for fragment in fragments:
        assert fragment in shown
    assert not (tmp_path / "out").exists()


def test_a_model_that_needs_images_is_refused_before_the_first_run(
    world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(Learned, "columns", ("blur",))
    model = world / "models" / "city.safetensors"
    assert (
        compare_exit(world / "a/test.npz", "--out", tmp_path / "out", "--noise", "fixed", model)
        == 2
    )
    assert "test.npz: it has no images, which the predictor blur needs." in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_recording_of_one_frame_is_refused(
    world: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with np.load(world / "a" / "train.npz") as archive:
        arrays = dict(archive)
    seen = arrays["frame"] == 0
    kept = {key: arrays[key][seen] for key in ("frame", "track", "uv")}
    kept |= {key: arrays[key][:1] for key in ("t", "T_world_cam")} | {"camera": arrays["camera"]}
    np.savez(tmp_path / "one.npz", **kept)
    assert compare_exit(tmp_path / "one.npz", "--out", tmp_path / "out") == 2
    assert "has only one frame" in capsys.readouterr().err


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no such names")
def test_a_name_that_is_no_text_is_linked_by_its_bytes(world: Path, tmp_path: Path) -> None:
    strange = tmp_path / os.fsdecode(b"dr\xe4ive.npz")
    shutil.copy(world / "a" / "test.npz", strange)
    out = tmp_path / "out"
    assert compare_exit(strange, "--out", out, "--noise", "fixed") == 0
    (link,) = re.findall(r'href="(runs/[^"]*)"', (out / "comparison.html").read_text())
    assert "dr%E4ive" in link
    assert (out / unquote_to_bytes(link).decode("utf-8", "surrogateescape")).exists()
