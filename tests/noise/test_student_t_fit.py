"""The static Student-t, fitted: the full scale matrix and the dof of all errors, whatever their
place; its file."""

from pathlib import Path

import numpy as np
import pytest
from scipy.stats import multivariate_t

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.noise import StudentT
from probevo.noise.model_file import ModelFile, write_model_file
from probevo.noise.model_io import load_model, save_model
from worlds import CAMERA

SCALE = 0.2 * np.array(
    [[1.0, 0.0, 0.9, 0.0], [0.0, 0.6, 0.0, 0.5], [0.9, 0.0, 1.1, 0.0], [0.0, 0.5, 0.0, 0.7]]
)
"""px²; a tracker that slips takes both images along."""
TRAINING = {"settings": {"seed": 0}, "iterations": [{"log_likelihood": -3.5}]}


def errors(count: int, seed: int = 0) -> FloatArray:
    return multivariate_t(np.zeros(4), SCALE, df=3.0).rvs(
        count, random_state=np.random.default_rng(seed)
    )


def fitted(count: int = 5000) -> StudentT:
    return StudentT(refers_to="residual", camera=CAMERA, training=TRAINING).fit(
        np.zeros((count, 0)), errors(count)
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "model.safetensors"


def test_scale_and_dof_are_those_of_the_errors() -> None:
    """Correlations too: standard errors are 2 % and 0.1."""
    model = fitted(20_000)
    assert np.linalg.norm(model.scale_ - SCALE) < 0.05 * np.linalg.norm(SCALE)
    assert model.dof_ == pytest.approx(3.0, abs=0.2)


@pytest.mark.parametrize(("given", "expected"), [(None, 0.0), (0.4, 0.4)])
def test_the_default_time_correlation_is_that_of_the_default_scale(
    given: float | None, expected: float
) -> None:
    """What is fitted has none but one that was given."""
    model = StudentT(time_correlation_ratio=given).fit(np.zeros((500, 0)), errors(500))
    assert model.time_correlation_ratio_ == expected


def test_every_feature_is_given_what_was_fitted() -> None:
    model = fitted()
    noise = model.predict(np.random.default_rng(1).normal(size=(3, 7)))
    np.testing.assert_array_equal(noise.scale, [model.scale_] * 3)
    np.testing.assert_array_equal(noise.dof, [model.dof_] * 3)
    np.testing.assert_array_equal(noise.bias, np.zeros((3, 4)))
    assert noise.refers_to == "residual"
    assert noise.out_of_domain is None


def test_it_is_likelier_than_the_unfitted() -> None:
    new = errors(2000, seed=2)
    own, unfitted = (
        model.predict(np.zeros((2000, 0))).log_likelihood(new).mean()
        for model in (fitted(), StudentT())
    )
    assert own > unfitted + 0.5


def test_what_the_model_was_made_with_is_kept() -> None:
    """``fit`` sets what ends in an underscore, and nothing else."""
    model = StudentT(dof=7.0)
    before = model.scale.copy()
    model.fit(np.zeros((100, 0)), errors(100))
    assert model.dof == 7.0
    np.testing.assert_array_equal(model.scale, before)
    assert model.dof_ != 7.0


def test_the_same_errors_give_the_same_bytes(path: Path) -> None:
    contents = set()
    for _ in range(3):
        save_model(fitted(), path)
        contents.add(path.read_bytes())
    assert len(contents) == 1


@pytest.mark.parametrize(
    "model", [fitted(500), StudentT(), StudentT(dof=3.0, scale=SCALE), StudentT(dof=np.inf)]
)
def test_a_model_comes_back_as_it_was(path: Path, model: StudentT) -> None:
    save_model(model, path)
    back = load_model(path)
    assert isinstance(back, StudentT)
    assert (back.dof_, back.refers_to, back.camera, back.columns) == (
        model.dof_,
        model.refers_to,
        model.camera,
        (),
    )
    assert back.training == model.training
    np.testing.assert_array_equal(back.scale_, model.scale_, strict=True)
    again = path.with_name("again.safetensors")
    save_model(back, again)
    assert again.read_bytes() == path.read_bytes()


def refuse(path: Path, model: ModelFile) -> None:
    """Its checksum is right, its content is not."""
    write_model_file(path, model)
    with pytest.raises(InputError, match="not a complete student-t model") as caught:
        load_model(path)
    assert "Train it again." in str(caught.value)


@pytest.mark.parametrize(
    "scale",
    [
        np.eye(3),
        np.eye(4)[None],
        np.eye(4, dtype=np.float32),
        -np.eye(4),
        np.zeros((4, 4)),
        np.diag([1.0, 1.0, 1.0, -1e-9]),
        np.full((4, 4), np.nan),
        np.diag([1.0, 1.0, 1.0, np.inf]),
        np.zeros((0, 4)),
    ],
)
def test_a_scale_that_is_no_covariance_is_refused(path: Path, scale: FloatArray) -> None:
    refuse(path, ModelFile("student-t", {"scale": scale}, fitted(50).to_file().facts))
