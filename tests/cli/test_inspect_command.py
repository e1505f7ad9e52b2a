"""``probevo inspect``: the page and the pictures of a frame, of a model, and of both."""

import io
import re
import shutil
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest

from cli.rendering import HEIGHT_PX, WIDTH_PX, write_wall
from output.pages import Balance
from output.undrawn import figures_undrawn
from probevo.cli.main import main
from probevo.config.training import PROBE_PREDICTORS
from probevo.output.inspection.feature_pictures import enlargement, legend_height
from probevo.predictors import PREDICTORS
from sequences.damage import replace
from worlds import CAMERA, drive

DEFAULT_COLUMNS = [column for name in PROBE_PREDICTORS for column in PREDICTORS[name].columns]


@pytest.fixture(scope="session")
def wall_model(wall: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = tmp_path_factory.mktemp("model") / "wall.safetensors"
    assert main(["train", str(wall), "--out", str(model), "--iterations", "4"]) == 0
    return model


@pytest.fixture(scope="session")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive as a tracks file."""
    frames = drive(np.random.default_rng(0), 6, points=80)
    path = tmp_path_factory.mktemp("tracks") / "drive.npz"
    seen = [frame.features for frame in frames if frame.features is not None]
    np.savez(
        path,
        frame=np.repeat(np.arange(6), [len(features.ids) for features in seen]),
        track=np.concatenate([features.ids for features in seen]),
        uv=np.concatenate([features.pixels for features in seen]),
        t=np.array([1e-9 * frame.stamp_ns for frame in frames]),
        camera=np.array(
            [CAMERA.fu_px, CAMERA.fv_px, CAMERA.cu_px, CAMERA.cv_px, CAMERA.baseline_m]
        ),
    )
    return path


def inspect(*words: str | Path) -> int:
    return main(["inspect", *map(str, words)])


@dataclass(frozen=True)
class Inspected:
    """A frame of the wall as its model sees it, and what the command said."""

    out: Path
    printed: str


@pytest.fixture(scope="module")
def inspected(wall: Path, wall_model: Path, tmp_path_factory: pytest.TempPathFactory) -> Inspected:
    out = tmp_path_factory.mktemp("inspected")
    printed = io.StringIO()
    with figures_undrawn(), redirect_stdout(printed):
        assert inspect(wall, "--model", wall_model, "--out", out) == 0
    return Inspected(out, printed.getvalue())


def page_of(out: Path) -> str:
    """The page; checks that it is well formed and needs no other file."""
    html = (out / "inspection.html").read_text()
    page = Balance()
    page.feed(html)
    assert page.open == []
    assert len(set(page.ids)) == len(page.ids)
    assert all(link.startswith(("#", "data:")) for link in page.links)
    return html


def titles(html: str) -> list[str]:
    return re.findall(r"<h2[^>]*>([^<]*)", html)


def unexplained(html: str) -> set[str]:
    """The facts at the top of the page whose meaning it does not say."""
    facts, meanings = re.findall(r"<dl.*?</dl>", html, re.DOTALL)
    return set(re.findall(r"<dt>(.*?)</dt>", facts)) - set(re.findall(r"<dt>(.*?)</dt>", meanings))


def explained_heads(printed: str) -> set[str]:
    """The heads of the table in the terminal that are explained below it."""
    return {head.lower() for head in re.findall(r"^([A-Z][a-z ]+): ", printed, re.MULTILINE)}


def test_a_frame_as_a_model_sees_it(inspected: Inspected) -> None:
    out = inspected.out
    printed = inspected.printed
    assert str(out / "inspection.html") in printed
    rows = {line.split()[0]: line for line in printed.splitlines() if "±" in line}
    assert list(rows) == DEFAULT_COLUMNS
    pictures = {path.stem: path for path in (out / "frame-4").iterdir()}
    assert set(pictures) == {"weight", "distance", *DEFAULT_COLUMNS}
    factor = enlargement((WIDTH_PX, HEIGHT_PX))
    shape = (factor * HEIGHT_PX + legend_height(factor * WIDTH_PX), factor * WIDTH_PX, 3)
    assert {cv2.imread(str(path)).shape for path in pictures.values()} == {shape}
    html = page_of(out)
    shown = titles(html)
    for title in (
        "Weights in this frame",
        "Distance from the training data",
        "How K and γ were chosen",
        "Trained on",
    ):
        assert title in shown
    assert set(DEFAULT_COLUMNS) < set(shown)
    unknown = re.search(r"blur: undefined for (\d+) of (\d+)", html)
    assert unknown
    assert f"{100 * int(unknown[1]) / int(unknown[2]):.1f} %" in rows["blur"]
    assert unexplained(html) == {"Image"}
    assert explained_heads(printed) == {"training", "this frame", "undefined"}


def test_the_same_bytes_again(
    wall: Path, wall_model: Path, inspected: Inspected, tmp_path: Path
) -> None:
    """By default it is the frame in the middle."""
    out = inspected.out
    assert inspect(wall, "--model", wall_model, "--frame", "4", "--out", tmp_path) == 0
    files = sorted(path.relative_to(out) for path in out.rglob("*.*"))
    assert len(files) == 3 + len(DEFAULT_COLUMNS)
    assert all((tmp_path / file).read_bytes() == (out / file).read_bytes() for file in files)


def test_a_model_alone(
    wall_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert inspect("--model", wall_model, "--out", tmp_path) == 0
    printed = capsys.readouterr().out
    assert explained_heads(printed) == {"training", "undefined"}
    assert "this frame" not in printed
    html = page_of(tmp_path)
    assert "What wall.safetensors learned" in html
    assert "Trained on" in titles(html)
    assert "Its features" not in titles(html)
    assert [path.name for path in tmp_path.iterdir()] == ["inspection.html"]


def test_predictors_alone_replace_what_an_earlier_inspection_left(
    wall: Path, inspected: Inspected, tmp_path: Path
) -> None:
    out = shutil.copytree(inspected.out, tmp_path / "out")
    assert inspect(wall, "--predictors", "blur", "turn_rate", "--frame", "4", "--out", out) == 0
    names = {"blur", "turn_rate", "turn_rate_x", "turn_rate_y", "turn_rate_z"}
    assert {path.stem for path in (out / "frame-4").iterdir()} == names
    html = page_of(out)
    assert titles(html) == ["Its features", "The predictors in figures"]
    assert (
        "The same for all features, and so not drawn: turn_rate_x, turn_rate_y, turn_rate_z,"
        " turn_rate." in html
    )


def test_a_tracks_file_is_drawn_on_a_plain_ground(tracks: Path, tmp_path: Path) -> None:
    """By default, with the predictors that need no images."""
    assert inspect(tracks, "--out", tmp_path) == 0
    pictures = {path.stem: path for path in (tmp_path / "frame-3").iterdir()}
    assert set(pictures) == {
        "flow_variance",
        "x",
        "y",
        "disparity",
        "disparity_change",
        "residual_flow",
        "row_offset",
    }
    assert cv2.imread(str(pictures["x"])).shape[1] == pytest.approx(1226, abs=60)
    assert "none; area of" in page_of(tmp_path)


def test_bad_input_says_what_is_wrong(
    wall: Path, wall_model: Path, tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = write_wall(tmp_path / "other", 3)
    replace("calib.yaml", "baseline_m: 0.3", "baseline_m: 0.6")(other)
    model = ("--model", wall_model)
    for words, message in (
        ((), "neither a recording nor a model"),
        ((wall, "--frame", "8"), "--frame: is 8; the recording has frames 1 to 7."),
        ((wall, "--frame", "0"), "frames 1 to 7"),
        ((other, *model), "another camera: this one's baseline is 0.6 m, not 0.3 m"),
        ((tracks, "--predictors", "blur"), "it has no images, which the predictor blur needs."),
        ((wall, "--predictors", "blurr"), "blurr is not known"),
        ((wall, *model, "--predictors", "blur"), "the model says which"),
        ((*model, "--frame", "3"), "--frame: there is no recording"),
        ((wall, "--model", tmp_path / "none.safetensors"), "this file is missing"),
    ):
        assert inspect(*words, "--out", tmp_path / "out") == 2, words
        assert message in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert inspect(other, *model, "--any-camera", "--out", tmp_path / "out") == 0
