"""``probevo inspect`` with models of full covariances: generalized kernels, and the static
Student-t."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from cli.test_inspect_command import explained_heads, inspect, page_of, titles, unexplained
from probevo.noise.gk.generalized_kernel import GeneralizedKernel
from probevo.noise.metric import Metric
from probevo.noise.model_io import save_model
from probevo.noise.student_t import StudentT


@pytest.fixture(scope="module")
def kernel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A kernel of three columns, two of them used, trained on the left part of the wall."""
    rng = np.random.default_rng(0)
    phi = np.column_stack(
        [rng.uniform(-0.9, 0.5, 2000), rng.uniform(-0.5, 0.5, 2000), rng.normal(3.0, 0.5, 2000)]
    )
    errors = 0.1 * np.exp(phi[:, :1]) * rng.normal(size=(2000, 4))
    model = GeneralizedKernel(
        neighbors=60,
        reach=0.2,
        prior_counts=4.0,
        dof_counts=100.0,
        bias_counts=math.inf,
        weights=np.array([1.0, 1.0, 0.0]),
    )
    model.fit(phi, errors, metric=Metric.fitted(phi, ("x", "y", "disparity"), (False,) * 3))
    path = tmp_path_factory.mktemp("kernel") / "left.safetensors"
    save_model(model, path)
    return path


@pytest.fixture(scope="module")
def student(tmp_path_factory: pytest.TempPathFactory) -> Path:
    scale = np.diag([0.04, 0.01, 0.04, 0.01])
    scale[0, 2] = scale[2, 0] = 0.02
    path = tmp_path_factory.mktemp("student") / "static.safetensors"
    save_model(StudentT(4.0, scale), path)
    return path


def test_a_frame_as_a_kernel_sees_it(
    wall: Path, kernel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of the features, those at the right are out of domain, and marked."""
    stale = tmp_path / "frame-4" / "weight.jpg"
    stale.parent.mkdir()
    stale.write_bytes(b"of an earlier model")
    assert inspect(wall, "--model", kernel, "--out", tmp_path) == 0
    printed = capsys.readouterr().out
    assert {path.stem for path in (tmp_path / "frame-4").iterdir()} == {"sigma", "dof", "x", "y"}
    share = re.search(r"out of domain: ([\d.]+) % of the features", printed)
    assert share
    assert 10.0 < float(share[1]) < 90.0
    html = page_of(tmp_path)
    assert f"<dt>Out of domain</dt><dd>{share[1]} %</dd>" in html
    assert "wall" in html
    shown = titles(html)
    assert shown[0] == "What the model learned"
    first = shown.index("In this frame")
    assert shown[first + 1 : first + 4] == [
        "Its features",
        "Predicted σ in this frame",
        "Predicted ν in this frame",
    ]
    rows = {line.split()[0]: line for line in printed.splitlines() if "±" in line}
    assert list(rows) == ["x", "y", "disparity"]
    assert unexplained(html) == {"Image"}
    heads = {"weight", "gain", "training", "this frame", "undefined"}
    assert explained_heads(printed) == heads


def test_a_kernel_alone(kernel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert inspect("--model", kernel, "--out", tmp_path) == 0
    html = page_of(tmp_path)
    assert "What left.safetensors learned" in html
    assert titles(html) == [
        "What the model learned",
        "x",
        "y",
        "The predictors in figures",
        "How it was trained",
        "The prior",
        "Where the centers lie, over the most telling predictors",
    ]
    assert "out of domain" not in capsys.readouterr().out
    assert [path.name for path in tmp_path.iterdir()] == ["inspection.html"]


def test_a_static_model_alone(
    student: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert inspect("--model", student, "--out", tmp_path) == 0
    printed = capsys.readouterr().out
    assert re.search(r"u_l +0.200\n", printed)
    assert re.search(r"u_r +0.200 +\+0.50 +\+0.00\n", printed)
    assert re.search(r"disparity, u_l − u_r +0.200\n", printed)
    assert "ν = 4" in printed
    assert "u_l, v_l, u_r, v_r: column and row" in printed
    html = page_of(tmp_path)
    assert unexplained(html) == {"Trained on"}
    assert titles(html) == ["The scale matrix"]
    assert "outliers included, is 1.41 times σ" in html
    assert "<td>+0.50</td>" in html


def test_a_frame_with_a_static_model_shows_predictors_that_it_does_not_take(
    wall: Path, student: Path, tmp_path: Path
) -> None:
    words = ("--model", student, "--predictors", "place", "blur", "--frame", "2")
    assert inspect(wall, *words, "--out", tmp_path) == 0
    assert {path.stem for path in (tmp_path / "frame-2").iterdir()} == {"x", "y", "blur"}
    html = page_of(tmp_path)
    assert titles(html) == ["The scale matrix", "Its features", "The predictors in figures"]
    assert "all features are alike" in html


def test_predictors_beside_a_kernel_are_refused(
    wall: Path, kernel: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert inspect(wall, "--model", kernel, "--predictors", "blur", "--out", tmp_path / "out") == 2
    assert "the model says which predictors it takes" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
