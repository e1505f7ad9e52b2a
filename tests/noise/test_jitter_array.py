"""The covariance of the rig's jitter in the files of learned models."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from probevo.arrays import AnyArray
from probevo.errors import InputError
from probevo.noise import Fixed, StudentT
from probevo.noise.jitter_array import NAME, learned_jitter_cov
from probevo.noise.model_file import ModelFile, write_model_file
from probevo.noise.model_io import load_model, save_model

COV = np.array([[2.0, 0.5, 0.0], [0.5, 4.0, 0.1], [0.0, 0.1, 1.0]]) * 1e-8


def test_it_is_read_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    save_model(StudentT(jitter_cov=COV), path)
    model = load_model(path)
    np.testing.assert_array_equal(learned_jitter_cov(model), COV)
    np.testing.assert_array_equal(model.predict(np.zeros((3, 0))).jitter_cov, COV)


def test_a_model_need_not_have_one(tmp_path: Path) -> None:
    path = tmp_path / "model.safetensors"
    save_model(StudentT(), path)
    assert learned_jitter_cov(load_model(path)) is None
    assert learned_jitter_cov(Fixed()) is None


CHANGES: dict[str, Callable[[AnyArray], AnyArray]] = {
    "another shape": lambda cov: cov[:2],
    "another type": lambda cov: cov.astype(np.float32),
    "not a number": lambda cov: np.where(cov > 3e-8, np.nan, cov),
    "lopsided": lambda cov: np.triu(cov),
    "indefinite": lambda cov: -cov,
    "a turn of a right angle": lambda cov: cov + np.eye(3),
}


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES.keys())
def test_what_is_no_covariance_of_small_angles_is_refused(
    tmp_path: Path, change: Callable[[AnyArray], AnyArray]
) -> None:
    path = tmp_path / "model.safetensors"
    file = StudentT().to_file()
    write_model_file(path, ModelFile(file.kind, {**file.arrays, NAME: change(COV)}, file.facts))
    with pytest.raises(InputError, match="not a complete student-t model"):
        load_model(path)
