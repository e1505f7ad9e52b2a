"""``probevo train --kind gk`` and ``student-t``: what they learn and say, how far they are, and
what they refuse."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from probevo.cli.main import main
from probevo.config.training import KernelSettings, TrainSettings
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.model_io import load_model
from probevo.noise.student_t import StudentT
from probevo.output.motions_file import read_motions
from probevo.sequences import open_sequence
from probevo.training.api import train_model
from probevo_sim.point_world import write_points
from sequences.recordings import write_tracks
from training.supervised_drives import point_world

GK = ["--kind", "gk", "--predictors", "place", "--gk.iterations", "2"]
FRAMES = 12
GIVEN = ["--gk.neighbors", "60", "--gk.prior-counts", "8"]


@pytest.fixture(scope="module")
def tracks(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive whose noise grows from left to right."""
    path = tmp_path_factory.mktemp("tracks") / "drive.npz"
    write_points(point_world("column", frames=FRAMES, landmarks=400), path)
    return path


@pytest.fixture(scope="module")
def static(tracks: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The static model of the drive."""
    out = tmp_path_factory.mktemp("city") / "student-t.safetensors"
    assert main(["train", str(tracks), "--out", str(out), "--kind", "student-t"]) == 0
    return out


def test_gk_says_what_was_learned_and_how_it_came_about(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "m.safetensors"
    assert main(["train", str(tracks), "--out", str(out), *GK, *GIVEN[:2]]) == 0
    model = load_model(out)
    lines = capsys.readouterr().out.splitlines()
    assert isinstance(model, GeneralizedKernel)
    assert f"samples     {model.num_samples_:,} from {FRAMES} frames of 1 recording" in lines
    assert f"K           {model.shape_.neighbors}" in lines
    assert any(
        line.startswith(f"ν           {model.prior_.dof[0]:.3g} of the prior") for line in lines
    )
    (predictors,) = [line.split(maxsplit=1)[1] for line in lines if line.startswith("predictors")]
    assert predictors.split(", ")[0] == "x"
    gains = {
        line.split()[0]: line.split()[1:] for line in lines[lines.index("") + 3 :] if "+" in line
    }
    weight, gain = gains["x"]
    assert float(weight) == model.metric_.weight[0]
    assert float(gain) == pytest.approx(model.training["searches"]["weights"]["gains"][0], abs=6e-4)
    assert float(gain) > 0.1
    first = next(k for k, line in enumerate(lines) if line.startswith("0: the static model"))
    likelihoods = [float(line.split()[-2]) for line in lines[first : first + 3]]
    np.testing.assert_allclose(
        likelihoods, [t["log_likelihood"] for t in model.training["iterations"]], atol=1e-4
    )
    assert likelihoods[-1] > likelihoods[0]
    assert "kept        the model after 2 iterations, the last" in lines
    assert lines[first + 2].startswith("2: kept ")
    assert lines[-1] == f"model: {out}"


def test_what_is_given_is_not_searched_for(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "m.safetensors"
    assert main(["train", str(tracks), "--out", str(out), *GK, *GIVEN]) == 0
    model = load_model(out)
    assert isinstance(model, GeneralizedKernel)
    assert (model.shape_.neighbors, model.shape_.prior_counts) == (60, 8.0)
    assert not {"neighbors", "prior_counts"} & set(model.training["searches"])
    assert "K           60" in capsys.readouterr().out


def test_published_has_a_fixed_support(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "m.safetensors"
    words = ["--gk.variant", "published", "--gk.reach", "1.5", "--gk.iterations", "1"]
    assert main(["train", str(tracks), "--out", str(out), *GK[:-2], *words]) == 0
    shown = capsys.readouterr().out
    assert "K           all within ρ = 1.5" in shown
    assert "predictors  x, y" in shown
    assert "not used" not in shown


def test_student_t_says_its_scale_and_runs(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "s.safetensors"
    assert main(["train", str(tracks), "--out", str(out), "--kind", "student-t"]) == 0
    model = load_model(out)
    lines = capsys.readouterr().out.splitlines()
    assert isinstance(model, StudentT)
    assert f"ν           {model.dof_:.3g}" in lines
    sigma = {line.split()[0]: line.split()[1:] for line in lines if line.startswith(("u_", "v_"))}
    expected = np.sqrt(np.diag(model.scale_))
    np.testing.assert_allclose(
        [float(sigma[name][0]) for name in ("u_l", "v_l", "u_r", "v_r")], expected, atol=6e-4
    )
    kept = model.training["kept_iteration"]
    (said,) = [line for line in lines if line.startswith("kept ")]
    assert said.split(maxsplit=1)[1].startswith(f"the model after {kept} iterations")
    correlation = float(sigma["u_r"][1].replace("−", "-"))
    assert correlation == pytest.approx(model.scale_[0, 2] / (expected[0] * expected[2]), abs=6e-3)
    assert sum(line.startswith(("0: not trained", "1 ", "2 ", "3 ", "4 ")) for line in lines) == 5
    assert main(["run", str(tracks), "--out", str(tmp_path / "run"), "--noise", str(out)]) == 0
    assert np.isfinite(read_motions(tmp_path / "run" / "motions.npz").cov).all()


def test_without_truth_there_is_no_end_error(
    tracks: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blind = tmp_path / "blind.npz"
    np.savez(
        blind, **{name: array for name, array in np.load(tracks).items() if name != "T_world_cam"}
    )
    words = [
        "--kind",
        "student-t",
        "--supervision",
        "none",
        "--out",
        str(tmp_path / "s.safetensors"),
    ]
    assert main(["train", str(blind), *words]) == 0
    shown = capsys.readouterr().out
    assert "likelihood, nats a feature" in shown
    assert "nd error" not in shown


def test_the_bar_moves_within_a_search(tracks: Path, tmp_path: Path) -> None:
    """The search is most of the training."""
    seen: list[tuple[int, int]] = []
    settings = TrainSettings(
        kind="gk",
        predictors=("place",),
        gk=KernelSettings(iterations=1, neighbors=40, prior_counts=8.0),
    )
    sequence = open_sequence(tracks)
    train_model(
        [sequence],
        settings,
        tmp_path / "m.safetensors",
        on_progress=lambda done, total: seen.append((done, total)),
    )
    done = [number for number, _ in seen]
    assert {total for _, total in seen} == {FRAMES * 12}
    assert done == sorted(done)
    assert done[-1] == FRAMES * 12
    assert len({number for number in done if FRAMES * 11 < number < FRAMES * 12}) >= 2


MISTAKES: dict[str, tuple[list[str], list[str]]] = {
    "positions for gk": (
        ["--kind", "gk", "--supervision", "position"],
        [
            "--supervision: position is for --kind knn alone",
            "Take sparse if attitudes are known too",
        ],
    ),
    "positions for student-t": (
        ["--kind", "student-t", "--supervision", "position"],
        ["student-t takes the truth"],
    ),
    "K of the other kind": (
        ["--kind", "gk", "--neighbors", "9"],
        ["--neighbors: ", "Its K is --gk.neighbors."],
    ),
    "subsets for gk": (
        ["--kind", "gk", "--subset", "9"],
        ["--subset: --kind gk does not take it."],
    ),
    "centers for knn": (["--gk.centers", "9"], ["--gk.centers: --kind knn does not take it."]),
    "centers for student-t": (
        ["--kind", "student-t", "--gk.centers", "9"],
        ["--gk.centers: --kind student-t"],
    ),
    "predictors for student-t": (
        ["--kind", "student-t", "--predictors", "place"],
        ["--predictors: student-t takes"],
    ),
    "too light a prior as published": (
        ["--kind", "gk", "--gk.variant", "published", "--gk.prior-counts", "3"],
        ["--gk.prior-counts: 3 is too few", "needs more than 3"],
    ),
    "K as published": (
        ["--kind", "gk", "--gk.variant", "published", "--gk.neighbors", "9"],
        ["all within --gk.reach contribute"],
    ),
    "a bias as published": (
        ["--kind", "gk", "--gk.variant", "published", "--gk.bias"],
        ["--gk.bias: as published, the errors have no bias.", "--gk.variant robust"],
    ),
    "half a truth": (
        ["--kind", "gk", "--gk.truth-sigma-deg", "1"],
        ["--gk.truth-sigma-deg: it means nothing without --gk.truth-sigma-m."],
    ),
    "how good no truth is": (
        [
            "--kind",
            "gk",
            "--supervision",
            "none",
            "--gk.truth-sigma-m",
            "1",
            "--gk.truth-sigma-deg",
            "1",
        ],
        ["--gk.truth-sigma-m: --supervision none uses no truth.", "Leave it out."],
    ),
    "all truth, thinned": (
        ["--every-s", "1"],
        ["--every-s: --supervision gt does not take it.", "sparse or position"],
    ),
    "a loop, thinned": (
        ["--kind", "gk", "--supervision", "loop", "--every-s", "1"],
        ["--supervision loop does not"],
    ),
    "no truth, thinned": (
        ["--kind", "gk", "--supervision", "none", "--every-s", "1"],
        ["--supervision none does not"],
    ),
    "alignment by the noise of residuals": (
        ["--kind", "gk", "--gk.refers-to", "residual", "--odometry.solver.method", "alignment"],
        [
            "--gk.refers-to: residual has no noise of single observations",
            "--odometry.solver.method alignment",
        ],
    ),
    "the same of the static model": (
        [
            "--kind",
            "student-t",
            "--gk.refers-to",
            "residual",
            "--odometry.solver.method",
            "alignment",
        ],
        ["--gk.refers-to: residual has no noise"],
    ),
}


@pytest.mark.parametrize(("words", "fragments"), MISTAKES.values(), ids=MISTAKES.keys())
def test_what_does_not_go_together_is_refused_before_the_work(
    words: list[str],
    fragments: list[str],
    tracks: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert (
        main(["train", str(tracks), "--out", str(tmp_path / "out" / "m.safetensors"), *words]) == 2
    )
    shown = capsys.readouterr().err
    for fragment in fragments:
        assert fragment in shown
    assert not list(tmp_path.iterdir())


def test_the_model_of_another_camera_is_named(
    tmp_path: Path, static: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    other = write_tracks(tmp_path)
    capsys.readouterr()
    out = str(tmp_path / "out")
    for words in (["run", "--noise"], ["compare", "--noise"], ["inspect", "--model"]):
        assert main([words[0], str(other), "--out", out, words[1], str(static)]) == 2
        shown = capsys.readouterr().err
        assert shown.startswith(f"probevo: {static}: it was trained with another camera: ")
        assert "this one's focal length is 50 px" in shown
        assert "Train one with this camera." in shown
    assert not (tmp_path / "out").exists()


def test_trained_models_side_by_side(
    tracks: Path, static: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A file with the name of a classical model is distinguished from it. Reports of the runs are
    left out."""
    monkeypatch.setattr(
        "probevo.output.report.report.write_report", lambda path, *_, **__: path.touch()
    )
    city = tmp_path / "city"
    city.mkdir()
    static = Path(shutil.copy(static, city))
    kernel = city / "gk.safetensors"
    assert (
        main(["train", str(tracks), "--out", str(kernel), *GK[:-2], "--gk.iterations", "1", *GIVEN])
        == 0
    )
    out = tmp_path / "out"
    assert (
        main(
            [
                "compare",
                str(tracks),
                "--noise",
                "student-t",
                str(static),
                str(kernel),
                "--out",
                str(out),
            ]
        )
        == 0
    )
    runs = json.loads((out / "comparison.json").read_text())["runs"]
    assert [run["estimator"] for run in runs] == ["student-t", "city-student-t", "gk"]
    assert len({run["metrics"]["armse_m"] for run in runs}) == 3
