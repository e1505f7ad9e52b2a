"""``probevo simulate``: what it writes and prints, and how it refuses mistakes."""

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
import yaml

from probevo.cli.main import main
from probevo.estimation.motion_estimate import Status
from probevo.output.motions_file import read_motions
from probevo.sequences import open_sequence
from probevo_sim.point_config import PointConfig
from probevo_sim.scene.config import SceneConfig
from sequences.recordings import write_folder_sequence

SHORT = ["--train-s", "0.5", "--test-s", "2"]


@pytest.mark.usefixtures("undrawn")
def test_run_follows_a_simulated_drive(tmp_path: Path) -> None:
    """Six metres with each noise model: every step is solved, and the end is known to a tenth of a
    metre."""
    assert main(["simulate", "point", "--out", str(tmp_path), *SHORT]) == 0
    for noise in ("fixed", "student-t"):
        out = tmp_path / noise
        assert main(["run", str(tmp_path / "test.npz"), "--out", str(out), "--noise", noise]) == 0
        assert set(read_motions(out / "motions.npz").status) == {Status.OK}
        assert json.loads((out / "metrics.json").read_text())["final_error_m"] < 0.1


def test_it_prints_what_was_written_and_the_next_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "a b"
    assert main(["simulate", "point", "--out", str(out), *SHORT, "--speed-m-s", "4"]) == 0
    train, test, following = capsys.readouterr().out.splitlines()
    assert train.startswith(f"{out}/train.npz: 6 frames, 2 m, ")
    assert test.startswith(f"{out}/test.npz: 21 frames, 8 m, ")
    assert following == f"next: probevo run '{out}/test.npz' --out '{out}/run'"


def test_flags_reach_the_world_and_are_kept_beside_it(tmp_path: Path) -> None:
    flags = [
        "--noise.law",
        "constant",
        "--noise.sigma-high-px",
        "0.35",
        "--outliers.fraction",
        "0",
        "--rate-hz",
        "5",
    ]
    assert main(["simulate", "point", "--out", str(tmp_path), *SHORT, *flags]) == 0
    with np.load(tmp_path / "test.npz") as archive:
        assert len(archive["t"]) == 11
        assert archive["inlier"].all()
        np.testing.assert_allclose(archive["covariance"][0], 0.04 * np.eye(4))
    config = PointConfig.model_validate(yaml.safe_load((tmp_path / "config.yaml").read_text()))
    assert config.noise.law == "constant"
    assert config.rate_hz == 5
    assert config.outliers.fraction == 0


def test_an_earlier_simulation_is_replaced(tmp_path: Path) -> None:
    out = str(tmp_path / "out")
    for seed in ("1", "2", "1"):
        assert main(["simulate", "point", "--out", out, *SHORT, "--seed", seed]) == 0
    assert main(["simulate", "point", "--out", str(tmp_path / "other"), *SHORT, "--seed", "1"]) == 0
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "config.yaml",
        "test.npz",
        "train.npz",
    }
    replaced = (tmp_path / "out" / "test.npz").read_bytes()
    assert replaced == (tmp_path / "other" / "test.npz").read_bytes()


@pytest.mark.parametrize(
    ("words", "command"),
    [
        (["simulate", "spoil", "drive", "--out", "x", "--topics.lefft", "/x"], "simulate spoil"),
        (["simulate", "point", "--out", "x", "--landmark", "9"], "simulate point"),
        (["simulate", "swamp"], "simulate"),
        (["paper", "sun", "--out", "x", "--seeed", "9"], "paper sun"),
    ],
)
def test_the_help_of_a_subcommand_is_named_in_full(
    words: list[str],
    command: str,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("COLUMNS", "200")
    with pytest.raises(SystemExit):
        main(words)
    named = re.findall(r"(probevo .*) --help", capsys.readouterr().err)
    assert set(named) == {f"probevo {command}"}


def test_scene_settings_reach_the_renderer(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    calls: list[SimpleNamespace] = []

    def write_scene(
        config: SceneConfig,
        out: Path,
        *,
        pixel_truth: bool,
        jobs: int,
        on_frame: Callable[[int, int], None],
    ) -> Path:
        calls.append(SimpleNamespace(config=config, pixel_truth=pixel_truth, jobs=jobs))
        write_folder_sequence(out)
        for done in range(1, 5):
            on_frame(done, 4)
        return out

    writer = ModuleType("probevo_sim.scene.writer")
    writer.write_scene = write_scene  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, writer.__name__, writer)
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("FORCE_COLOR", "1")  # what Rich 13 looks at
    out = tmp_path / "scene"
    flags = [
        "--preset",
        "road",
        "--effects.blur",
        "0.5",
        "--rig.width-px",
        "320",
        "--pixel-truth",
        "--jobs",
        "2",
    ]
    assert main(["simulate", "scene", "--out", str(out), *flags]) == 0
    (call,) = calls
    assert call.config.preset == "road"
    assert call.config.effects.blur == 0.5
    assert call.config.rig.width_px == 320
    assert call.pixel_truth is True
    assert call.jobs == 2
    shown = capsys.readouterr()
    assert shown.out.splitlines() == [
        f"{out}: 4 frames",
        f"next: probevo run {out} --out {out}-run",
    ]
    assert "4/4" in shown.err
    assert len(open_sequence(out)) == 4


@pytest.mark.parametrize(
    ("words", "fragments"),
    [
        (["point", "--landmarks", "0"], ["--landmarks is 0; it should be", "PROBE-GK has 2,000."]),
        (["point", "--noise.dof", "2"], ["--noise.dof is 2.0; it should be greater than 2."]),
        (["point", "--outliers.range-px", "nan"], ["--outliers.range-px is nan;"]),
        (
            ["point", "--landmarks", "100000"],
            ["30,000,000 are possible", "Simulate fewer landmarks"],
        ),
        (["scene", "--effects.blur", "2"], ["--effects.blur is 2.0;", "Motion blur"]),
        (["scene", "--jobs", "-1"], ["--jobs: is -1."]),
    ],
)
def test_mistakes_exit_with_2_and_name_the_flag(
    words: list[str], fragments: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", *words, "--out", str(tmp_path / "out")]) == 2
    shown = capsys.readouterr().err
    assert shown.startswith("probevo: ")
    for fragment in fragments:
        assert fragment in shown
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("world", ["point", "scene"])
def test_a_file_in_the_way_is_left_alone(
    world: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    assert main(["simulate", world, "--out", str(tmp_path / "file")]) == 2
    assert f"--out: {tmp_path / 'file'} is a file." in capsys.readouterr().err
    assert (tmp_path / "file").read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "fragment"),
    [
        ([], "point, scene"),
        (["fly"], "point, scene"),
        (["point"], "--out"),
        (["point", "--out", "x", "--noise.law", "diagonal"], "--noise.law"),
        (["scene", "--out", "x", "--noise.law", "row"], "--noise.law"),
    ],
)
def test_words_that_cannot_be_read_exit_with_2(
    words: list[str], fragment: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["simulate", *words])
    assert caught.value.code == 2
    assert fragment in capsys.readouterr().err


@pytest.mark.parametrize(
    ("flags", "fragment"),
    [(["--camera.focal-px", "90000"], "no landmark"), (["--train-s", "0.001"], "two frames")],
)
def test_a_point_world_without_anything_to_see_is_refused(
    flags: list[str], fragment: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["simulate", "point", "--out", str(tmp_path / "points"), *flags]) == 2
    assert fragment in capsys.readouterr().err
    assert not (tmp_path / "points").exists()


def test_a_spoiled_recording_is_written_and_counted(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    original = write_folder_sequence(tmp_path / "original", 12)
    out = tmp_path / "spoiled"
    words = ["simulate", "spoil", str(original), "--preset", "jpeg", "--seed", "2"]
    assert main([*words, "--out", str(out)]) == 0
    said = capsys.readouterr().out
    record = json.loads((out / "spoiled.json").read_text())
    num_jpeg = sum(entry.get("effect") == "jpeg" for entry in record["frames"])
    assert f"{out}: 12 of 12 frames" in said
    assert f"{num_jpeg} jpeg" in said
    assert f"next: probevo run {out} --out {out}-run" in said
    assert record["settings"]["preset"] == "jpeg"
    assert len(open_sequence(out)) == 12
    # What is there already is not written over.
    assert main([*words, "--out", str(out)]) == 2


@pytest.mark.parametrize("stop", ["damaged image", "Ctrl-C", "kill"])
def test_a_spoiled_recording_appears_when_it_is_complete(
    stop: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whatever stops it, the same command then succeeds."""
    original = write_folder_sequence(tmp_path / "original", 12)
    out = tmp_path / "spoiled"
    words = ["simulate", "spoil", str(original), "--preset", "jpeg", "--out", str(out)]
    image = original / "left" / "000005.png"
    content = image.read_bytes()
    if stop == "damaged image":
        image.write_bytes(content[:-99])
        assert main(words) == 2
        image.write_bytes(content)
    elif stop == "Ctrl-C":
        with monkeypatch.context() as patch:
            patch.setattr("probevo_sim.spoiling.recording.RECORD", _Interrupt())
            assert main(words) == 130
    else:
        (tmp_path / "spoiled.work" / "recording" / "left").mkdir(parents=True)
    assert not out.exists()
    assert main(words) == 0
    assert len(open_sequence(out)) == 12
    assert not (tmp_path / "spoiled.work").exists()


class _Interrupt:
    """A name of a file that nobody gets to write."""

    def __rtruediv__(self, folder: Path) -> Path:
        raise KeyboardInterrupt
