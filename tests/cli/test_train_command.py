"""``probevo train``: from a simulated recording to motions with the model, its refusals, and what
survives a kill."""

import io
import shutil
import time
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from cli.processes import started
from probevo.cli import train as command
from probevo.cli.main import main
from probevo.cli.train_summary import FEW_FRAMES, few_frames_warning, summary
from probevo.noise import NearestNeighbors
from probevo.noise.metric import Metric
from probevo.noise.model_io import load_model, save_model
from probevo.output.motions_file import read_motions
from probevo_sim.point_world import write_points
from sequences.recordings import write_tracks
from training.supervised_drives import point_world

FLAGS = ["--predictors", "place", "row_offset", "--iterations", "4", "--subset", "6"]


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive."""
    path = tmp_path_factory.mktemp("tracks") / "drive.npz"
    write_points(point_world("column", frames=16, landmarks=400), path)
    return path


@dataclass(frozen=True)
class Trained:
    """A model that the command has learned, and what it said."""

    path: Path
    out: str
    err: str


@pytest.fixture(scope="module")
def trained(tracks: Path, tmp_path_factory: pytest.TempPathFactory) -> Trained:
    path = tmp_path_factory.mktemp("model") / "city.safetensors"
    out, err = io.StringIO(), io.StringIO()
    with redirect_stdout(out), redirect_stderr(err):
        assert main(["train", str(tracks), "--out", str(path), *FLAGS]) == 0
    return Trained(path, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module")
def model(trained: Trained) -> Path:
    return trained.path


def test_simulate_train_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The whole way, on the command line only."""
    world = tmp_path / "world"
    out = tmp_path / "m.safetensors"
    words = [
        "--train-s",
        "1.5",
        "--test-s",
        "1.5",
        "--radius-m",
        "3",
        "--landmarks",
        "400",
        "--noise.law",
        "column",
    ]
    assert main(["simulate", "point", "--out", str(world), *words]) == 0
    assert main(["train", str(world / "train.npz"), "--out", str(out), *FLAGS]) == 0
    assert (
        main(["run", str(world / "test.npz"), "--out", str(tmp_path / "run"), "--noise", str(out)])
        == 0
    )
    result = read_motions(tmp_path / "run" / "motions.npz")
    assert len(result) == 16
    assert np.isfinite(result.cov).all()
    assert f"model: {out}" in capsys.readouterr().out


def test_a_model_of_few_frames_is_warned_of(trained: Trained) -> None:
    assert "learned from 16 frames of 1 recording" in trained.err


def test_a_model_of_enough_frames_is_not_warned_of(model: Path) -> None:
    loaded = load_model(model)
    enough = [{"frames": FEW_FRAMES - 1}, {"frames": 1}]
    object.__setattr__(loaded, "training", {**loaded.training, "recordings": enough})
    assert few_frames_warning(loaded) == ""


def test_recordings_are_opened_as_told(
    wall: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Pictures without times need a rate; processes of their own are told, too."""
    pictures = shutil.copytree(wall, tmp_path / "pictures")
    (pictures / "times.txt").unlink()
    words = ["train", str(pictures), "--kind", "student-t", "--supervision", "none"]
    words += ["--max-frames", "3"]
    out = tmp_path / "here.safetensors"
    assert main([*words, "--out", str(out)]) == 2
    assert "--rate-hz" in capsys.readouterr().err
    assert main([*words, "--out", str(out), "--rate-hz", "10"]) == 0
    there = tmp_path / "there.safetensors"
    assert main([*words, "--out", str(there), "--rate-hz", "10", "--jobs", "2"]) == 0
    assert there.read_bytes() == out.read_bytes()
    seen = ["inspect", str(pictures), "--rate-hz", "10", "--out", str(tmp_path / "seen")]
    assert main([*seen, "--frame", "1", "--model", str(out)]) == 0


def test_it_says_what_was_learned_and_how_k_and_gamma_came_about(trained: Trained) -> None:
    model = load_model(trained.path)
    assert isinstance(model, NearestNeighbors)
    lines = trained.out.splitlines()
    assert f"samples     {len(model.index_.values):,} from 16 frames of 1 recording" in lines
    assert "predictors  x, y, row_offset" in lines
    assert f"K           {model.neighbors}" in lines
    assert f"γ           {model.exponent:g}" in lines
    assert "kept        the samples of all 4 iterations, each of other subsets" in lines
    assert (
        sum(
            line.startswith(("squared error of left-out samples", "mean error on the training"))
            for line in lines
        )
        == 2
    )
    assert lines[-1] == f"model: {trained.path}"


def test_more_processes_give_the_same_model(tracks: Path, model: Path, tmp_path: Path) -> None:
    out = tmp_path / "m.safetensors"
    assert main(["train", str(tracks), "--out", str(out), *FLAGS, "--jobs", "2"]) == 0
    assert out.read_bytes() == model.read_bytes()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--jobs", "-1"], "--jobs: is -1."),
        (
            ["--jobs", "2", "--cluster", "tcp://127.0.0.1:9"],
            "--jobs: has no meaning with --cluster",
        ),
    ],
)
def test_impossible_workers_are_refused(
    tracks: Path, tmp_path: Path, words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", str(tracks), "--out", str(tmp_path / "m.safetensors"), *words]) == 2
    assert message in capsys.readouterr().err


def test_given_k_and_gamma_are_not_searched_for(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "m.safetensors"
    assert (
        main(
            [
                "train",
                str(tracks),
                "--out",
                str(out),
                *FLAGS,
                "--neighbors",
                "7",
                "--exponent",
                "2.5",
            ]
        )
        == 0
    )
    model = load_model(out)
    assert isinstance(model, NearestNeighbors)
    assert (model.neighbors, model.exponent) == (7, 2.5)
    assert "squared error" not in capsys.readouterr().out


def test_the_same_words_give_the_same_bytes(tracks: Path, model: Path, tmp_path: Path) -> None:
    """Elsewhere, and over an earlier model."""
    out = tmp_path / "other.safetensors"
    for _ in range(2):
        assert main(["train", str(tracks), "--out", str(out), *FLAGS]) == 0
        assert out.read_bytes() == model.read_bytes()
    assert list(tmp_path.iterdir()) == [out]


def test_a_terminal_shows_the_progress(
    tracks: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setenv("TTY_COMPATIBLE", "1")
    monkeypatch.setenv("FORCE_COLOR", "1")  # what Rich 13 looks at
    monkeypatch.setenv("COLUMNS", "120")
    assert main(["train", str(tracks), "--out", str(tmp_path / "m.safetensors"), *FLAGS]) == 0
    shown = capsys.readouterr()
    assert "training m.safetensors" in shown.err
    assert "80/80" in shown.err
    assert "80/80" not in shown.out


def test_ctrl_c_exits_with_130(
    tracks: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(command, "train_with_progress", interrupted)
    assert main(["train", str(tracks), "--out", str(tmp_path / "m.safetensors")]) == 130
    assert "stopped." in capsys.readouterr().err


def write_images_model(path: Path) -> Path:
    """Of a predictor that looks at images."""
    phi = np.random.default_rng(0).normal(size=(50, 1))
    save_model(
        NearestNeighbors(5).fit(phi, np.ones(50), metric=Metric.fitted(phi, ("blur",), (True,))),
        path,
    )
    return path


MISTAKES: dict[str, tuple[list[str], list[str]]] = {
    "no such recording": (["nowhere.npz"], ["nowhere.npz: nothing is there"]),
    "one frame": (["ONE"], ["one frame", "no motion to learn from", "Give a longer one."]),
    "no truth": (
        ["BLIND"],
        ["no ground truth, which --supervision gt needs", "--supervision none"],
    ),
    "other cameras": (
        ["TRACKS", "BLIND"],
        ["its camera is not that of", "Train one model for each camera."],
    ),
    "unknown predictor": (
        ["TRACKS", "--predictors", "blurr"],
        ["--predictors: blurr is not known.", "Did you mean blur?"],
    ),
    "no images": (
        ["TRACKS", "--predictors", "place", "blur"],
        ["drive.npz: it has no images, which the predictor blur needs.", "--predictors"],
    ),
    "no IMU": (
        ["TRACKS", "--predictors", "acceleration"],
        ["it has no accelerometer, which the predictor acceleration needs."],
    ),
    "K too large": (
        ["TRACKS", "--neighbors", "9999"],
        ["--neighbors: K is 9999, but there are only 360 samples"],
    ),
    "K of 0": (["TRACKS", "--neighbors", "0"], ["--neighbors is 0;", "greater than or equal to 1"]),
    "one iteration": (
        ["TRACKS", "--iterations", "1"],
        ["--iterations is 1;", "greater than or equal to 2"],
    ),
    "subset too large": (
        ["TRACKS", "--subset", "900"],
        ["no step has 900 features", "smaller --subset"],
    ),
    "truth too seldom": (
        ["TRACKS", "--supervision", "sparse", "--every-s", "9"],
        ["the truth of 1 frames is used; --supervision sparse needs 2.", "a smaller --every-s"],
    ),
    "twice": (
        ["TRACKS", "TRACKS"],
        ["drive.npz: this recording is named twice.", "it would count double"],
    ),
    "two frames": (
        ["TRACKS", "--max-frames", "2"],
        ["the drives are too short to choose K", "--neighbors and"],
    ),
    "loop cut short": (
        ["BLIND", "--supervision", "loop", "--max-frames", "3"],
        [
            "only 3 of its 4 frames are used, but the loop closes at the last one.",
            "Leave out --max-frames.",
        ],
    ),
    "no model file": (
        ["TRACKS", "--out", "OUT/model.npz"],
        ["--out: ", "model.npz", ".safetensors"],
    ),
    "a file in the way": (["TRACKS", "--out", "TRACKS/m.safetensors"], ["--out: ", "is a file."]),
}


@pytest.mark.parametrize(("words", "fragments"), MISTAKES.values(), ids=MISTAKES.keys())
def test_mistakes_exit_with_2_and_name_the_cure(
    words: list[str],
    fragments: list[str],
    tracks: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    for name in ("one", "blind"):
        (tmp_path / name).mkdir()
    one = write_tracks(tmp_path / "one", 1, omega=None, C_cam_imu=None)
    blind = write_tracks(tmp_path / "blind", T_world_cam=None)
    names = {"TRACKS": tracks, "ONE": one, "BLIND": blind, "OUT": tmp_path}
    for name, path in names.items():
        words = [word.replace(name, str(path)) for word in words]
    out = ["--out", str(tmp_path / "out" / "m.safetensors")]
    assert main(["train", *([] if "--out" in words else out), *without(words), *words]) == 2
    shown = capsys.readouterr().err
    assert shown.startswith("probevo: ")
    for fragment in fragments:
        assert fragment in shown
    assert not list(tmp_path.rglob("*.safetensors"))


def without(words: list[str]) -> list[str]:
    """The usual flags but for those given."""
    pairs = {"--predictors": FLAGS[:3], "--iterations": FLAGS[3:5], "--subset": FLAGS[5:]}
    return [word for flag, usual in pairs.items() if flag not in words for word in usual]


@pytest.mark.parametrize(
    "words", [[], ["TRACKS"], ["TRACKS", "--out", "m.safetensors", "--supervision", "some"]]
)
def test_words_that_cannot_be_read_exit_with_2(
    words: list[str], tracks: Path, tmp_path: Path
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["train", *(str(tracks) if word == "TRACKS" else word for word in words)])
    assert caught.value.code == 2


def test_no_recording_is_a_mistake(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["train", "--out", str(tmp_path / "m.safetensors")]) == 2
    assert "SEQUENCE: no recording is named." in capsys.readouterr().err


def test_unfinished_work_with_other_settings_names_its_folder(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "m.safetensors"
    assert main(["train", str(tracks), "--out", str(out), *FLAGS[:-1], "900"]) == 2
    capsys.readouterr()
    assert main(["train", str(tracks), "--out", str(out), *FLAGS, "--max-frames", "9"]) == 2
    shown = capsys.readouterr().err
    what = "a training that was stopped here had other recordings, predictors or odometry."
    assert f"probevo: {out}.work: {what}" in shown
    assert "delete this folder" in shown
    assert main(["train", str(tracks), "--out", str(out), *FLAGS]) == 0


@pytest.mark.parametrize("name", ["drive-0-0.npz", "drive-0.json", "iteration-0.npz", "plan.json"])
def test_damaged_work_is_named(
    tracks: Path, tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "m.safetensors"
    assert main(["train", str(tracks), "--out", str(out), *FLAGS, "--neighbors", "9999"]) == 2
    damaged = tmp_path / "m.safetensors.work" / name
    damaged.write_bytes(damaged.read_bytes()[:-20])
    capsys.readouterr()
    assert main(["train", str(tracks), "--out", str(out), *FLAGS]) == 2
    shown = capsys.readouterr().err
    assert f"probevo: {damaged}: this is damaged" in shown
    assert f"Delete the folder {damaged.parent}." in shown


@pytest.mark.parametrize(
    ("supervision", "hint"), [("gt", True), ("sparse", True), ("none", False), ("loop", False)]
)
def test_where_gamma_is_0_it_is_said_what_that_means(supervision: str, hint: bool) -> None:
    """Only a truth at single frames can jump from one to the next."""
    training = {
        "recordings": [{"frames": 3}],
        "searches": {},
        "settings": {"supervision": supervision},
    }
    phi = np.random.default_rng(0).normal(size=(50, 1))
    model = NearestNeighbors(5, 0.0, training=training).fit(
        phi, np.ones(50), metric=Metric.fitted(phi, ("age",))
    )
    lines = summary(model, Path("m.safetensors"))
    meaning = (
        "γ is 0: nothing shows that any feature is better than another; the model is the static"
        " one."
    )
    assert meaning in lines
    assert (
        "A truth that jumps from frame to frame hides it: try --supervision none." in lines
    ) == hint


def test_the_model_of_another_camera_is_refused(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = write_tracks(tmp_path)
    assert main(["run", str(other), "--out", str(tmp_path / "run"), "--noise", str(model)]) == 2
    shown = capsys.readouterr().err
    assert "trained with another camera: this one's focal length is 50 px, not 400 px" in shown
    assert "Train one with this camera." in shown
    assert not (tmp_path / "run").exists()


def test_a_model_that_needs_images_is_refused_where_there_are_none(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = write_images_model(tmp_path / "m.safetensors")
    assert main(["run", str(tracks), "--out", str(tmp_path / "run"), "--noise", str(path)]) == 2
    shown = capsys.readouterr().err
    assert f"{tracks}: it has no images, which the predictor blur needs." in shown
    assert "Train a model without it" in shown
    assert not (tmp_path / "run").exists()


def test_a_damaged_model_is_refused(
    tracks: Path, model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content = bytearray(model.read_bytes())
    content[-20] ^= 1
    (tmp_path / "m.safetensors").write_bytes(bytes(content))
    assert (
        main(
            [
                "run",
                str(tracks),
                "--out",
                str(tmp_path / "run"),
                "--noise",
                str(tmp_path / "m.safetensors"),
            ]
        )
        == 2
    )
    assert "damaged" in capsys.readouterr().err


KILLS = 4


@pytest.mark.slow
def test_killed_four_times_and_resumed_it_gives_the_same_bytes(tmp_path: Path) -> None:
    """At random moments of the training, with SIGKILL: nothing can be tidied up.

    Where a run is through before its moment has come, its bytes are right too, and the next one
    starts anew.
    """
    for seed in range(3):
        write_points(
            point_world("column", seed=seed, frames=16, landmarks=400), tmp_path / f"{seed}.npz"
        )
    words = [
        *(str(tmp_path / f"{seed}.npz") for seed in range(3)),
        "--predictors",
        "place",
        "row_offset",
    ]
    words += ["--iterations", "30", "--neighbors", "50", "--exponent", "2"]
    whole = tmp_path / "whole.safetensors"
    out = tmp_path / "killed.safetensors"
    # This compiles, too, if that has not been done yet.
    assert main(["train", *words, "--out", str(whole)]) == 0
    training_s = Training(words, out).until_done()
    assert out.read_bytes() == whole.read_bytes()
    out.unlink()
    rng = np.random.default_rng(0)
    kills = 0
    for _ in range(3 * KILLS):
        training = Training(words, out)
        if training.killed_after(rng.uniform(0.0, 2.0 * training_s / KILLS)):
            kills += 1
        else:
            assert out.read_bytes() == whole.read_bytes()
            training_s *= 0.5
        if kills == KILLS:
            break
    assert kills == KILLS
    Training(words, out).until_done()
    assert out.read_bytes() == whole.read_bytes()
    assert not out.with_name(out.name + ".work").exists()


class Training:
    """``probevo train`` as a process of its own."""

    def __init__(self, words: list[str], out: Path) -> None:
        self.plan = out.with_name(out.name + ".work") / "plan.json"
        before = self.written()
        self.process = started(["train", *words, "--out", str(out)])
        # It writes its plan before all else.
        while self.process.is_alive() and self.written() in (before, 0):
            time.sleep(0.002)
        self.begun_s = time.monotonic()

    def written(self) -> int:
        """When the plan was, ns; 0 if it is not there."""
        try:
            return self.plan.stat().st_mtime_ns
        except OSError:
            return 0

    def until_done(self) -> float:
        """How long the training took, without the start of Python, s."""
        self.process.join()
        assert self.process.exitcode == 0
        return time.monotonic() - self.begun_s

    def killed_after(self, delay_s: float) -> bool:
        """Whether it was still at work then."""
        self.process.join(delay_s)
        was_at_work = self.process.exitcode is None
        self.process.kill()
        self.process.join()
        assert was_at_work or self.process.exitcode == 0
        return self.process.exitcode != 0
