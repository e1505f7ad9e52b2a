"""``probevo demo``: what it writes and prints, that it renders only once, and that its two scenes
are different."""

import io
import re
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import pytest

from cli.rendering import write_wall
from output.undrawn import figures_undrawn
from probevo.cli import demo
from probevo.cli.main import main
from probevo.noise import StudentT
from probevo.noise.model_io import save_model
from probevo.output.comparison.comparison import Entry
from probevo_sim.scene.config import Effects, RigConfig, SceneConfig
from probevo_sim.scene.writer import scene_folder

TINY = SceneConfig(distance_m=2, rig=RigConfig(width_px=320, height_px=96, focal_px=180))
SCENES = {"training": TINY, "test": TINY.model_copy(update={"seed": 1})}
CLASSICAL = ["fixed", "student-t"]
LEARNED = ["fitted student-t", "knn", "gk"]
RUNS = [
    *("training-fixed", "training-student-t"),
    *("test-fixed", "test-student-t", "test-fitted-student-t", "test-knn", "test-gk"),
]


def put_a_wall(_: SceneConfig, folder: Path) -> Path:
    """In place of rendering."""
    return write_wall(folder, 6)


@pytest.fixture(scope="module")
def out(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a demo on two recordings of a wall; its output is in "printed.txt" beside it."""
    out = tmp_path_factory.mktemp("demo") / "out"
    printed = io.StringIO()
    with pytest.MonkeyPatch.context() as patch, figures_undrawn(), redirect_stdout(printed):
        patch.setattr("probevo_sim.command.render_with_progress", put_a_wall)
        # Hyperparameters of the kernel are chosen by fewer features: no matter by which.
        patch.setattr("probevo.noise.gk.folds.MAX_HELD_OUT", 50)
        demo.demo(SCENES, out)
    out.with_name("printed.txt").write_text(printed.getvalue())
    return out


def test_one_table_and_one_report(out: Path) -> None:
    lines = out.with_name("printed.txt").read_text().splitlines()
    assert lines[1].split("  ")[0] == "estimator"
    assert [re.split(r"\s\s+", line.strip())[0] for line in lines[3:13]] == [
        *("training", *CLASSICAL),
        *("test", *CLASSICAL, *LEARNED),
        "",
    ]
    assert lines[-1] == f"report: {out / 'report.html'}"
    assert {path.name for path in out.iterdir()} == {
        "fitted-student-t.safetensors",
        "knn.safetensors",
        "gk.safetensors",
        "report.html",
        "runs",
        "scenes",
    }


def test_the_page_leads_to_the_report_of_each_run(out: Path) -> None:
    page = (out / "report.html").read_text()
    links = re.findall(r'<a href="(.*?)"', page)
    assert links == [f"runs/{name}/report.html" for name in RUNS]
    assert all((out / link).exists() for link in links)
    assert page.count("data:image/jpeg") == 9
    assert "city 1, 2 m" in page


def test_the_models_are_described_and_the_caution_is_given(out: Path) -> None:
    """The wall is too short to say who is better; that one drive says little holds all the same."""
    printed = out.with_name("printed.txt").read_text()
    page = (out / "report.html").read_text()
    assert "PROBE-GK: a covariance for each feature" in printed
    assert demo.CAUTION in printed
    assert demo.CAUTION in page
    assert set(demo.noise_summaries("training")) == {*CLASSICAL, *LEARNED}


@pytest.mark.slow
def test_a_second_demo_renders_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """What it learns does not matter here, nor what it reports."""
    monkeypatch.setattr(
        "probevo.cli.train.train_with_progress", lambda _, __, out: save_model(StudentT(), out)
    )
    monkeypatch.setattr(
        "probevo.output.report.report.write_report", lambda path, *_, **__: path.touch()
    )
    run = demo.run
    runs: dict[str, Entry] = {}

    def run_once(name: str, folder: Path, label: str, noise: str, out: Path) -> Entry:
        """In place of ``demo.run``: run a single model on each drive."""
        if name not in runs:
            runs[name] = run(name, folder, label, noise=noise, out=out)
        return replace(runs[name], estimator=label)

    monkeypatch.setattr(demo, "run", run_once)
    demo.demo(SCENES, tmp_path)
    assert "The first time takes three to five minutes" in capsys.readouterr().out
    written = {path: path.stat().st_mtime_ns for path in (tmp_path / "scenes").rglob("*.png")}
    assert written
    demo.demo(SCENES, tmp_path)
    assert "The first time" not in capsys.readouterr().out
    assert {
        path: path.stat().st_mtime_ns for path in (tmp_path / "scenes").rglob("*.png")
    } == written


def test_training_and_test_have_the_same_effects_but_other_streets() -> None:
    assert demo.TRAINING.effects == demo.TEST.effects
    assert demo.TRAINING.seed != demo.TEST.seed
    assert min(demo.TRAINING.distance_m or 0, demo.TEST.distance_m or 0) >= 100


def test_other_settings_go_to_another_folder() -> None:
    folders = {scene_folder("test", TINY.model_copy(update={"seed": seed})) for seed in (0, 1, 1)}
    assert len(folders) == 2
    assert all(re.fullmatch(r"test-[0-9a-f]{8}", folder) for folder in folders)


def test_a_scene_in_words() -> None:
    config = SceneConfig(preset="road", seed=3, distance_m=80, effects=Effects(blur=0.25))
    assert demo.scene_text(config) == "road 3, 80 m, blur 0.25"
    assert demo.scene_text(SceneConfig(preset="rover")) == "rover 0"


def test_a_file_in_the_way_is_named_before_anything_is_rendered(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    assert main(["demo", "--out", str(tmp_path / "file")]) == 2
    assert "--out: " in capsys.readouterr().err
