"""Noise models by name or by path, and what is said of a name that is neither."""

import os
from pathlib import Path

import pytest

from probevo.errors import InputError
from probevo.noise import Fixed, NoiseModel, StudentT
from probevo.noise.named import noise_model, portable


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """In place of reading files: each file is a Student-t; the paths that were asked for are
    collected."""
    paths: list[Path] = []

    def load_model(path: Path) -> NoiseModel:
        paths.append(path)
        return StudentT(dof=4.0)

    monkeypatch.setattr("probevo.noise.named.load_model", load_model)
    return paths


def test_names_give_the_untrained_models() -> None:
    assert isinstance(noise_model("fixed"), Fixed)
    assert isinstance(noise_model("student-t"), StudentT)


def test_anything_else_is_a_path(loaded: list[Path], tmp_path: Path) -> None:
    path = tmp_path / "city.safetensors"
    path.touch()
    model = noise_model(str(path))
    assert isinstance(model, StudentT)
    assert (model.dof, loaded) == (4.0, [path])


def test_a_name_takes_precedence_over_a_file_of_that_name(
    loaded: list[Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("fixed").touch()
    assert isinstance(noise_model("fixed"), Fixed)
    assert portable("fixed") == "fixed"
    noise_model("./fixed")
    assert loaded == [Path("fixed")]
    assert portable("./fixed") == str(tmp_path / "fixed")


@pytest.mark.parametrize(
    ("spec", "fragments"),
    [
        ("student", ["'student' is not a known name", "Did you mean student-t?"]),
        ("Fixed", ["'Fixed' is not a known name", "Did you mean fixed?"]),
        ("agressive", ["Did you mean aggressive?"]),
        ("zzz", ["Known are fixed, student-t, aggressive; or give a model file"]),
        ("", ["Known are fixed"]),
        ("models", ["'models' is a folder."]),
        ("models/citty.safetensors", [f"Did you mean models{os.sep}city.safetensors?"]),
        ("models/city", [f"Did you mean models{os.sep}city.safetensors?"]),
        ("nowhere/city.safetensors", ["no such file exists."]),
        ("x" * 5000, ["no such file exists."]),
        ("a\0b", ["no such file exists."]),
        ("a\0b/c", ["no such file exists."]),
    ],
)
def test_what_is_neither_is_named_with_a_cure(
    spec: str, fragments: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("models").mkdir()
    Path("models/city.safetensors").touch()
    with pytest.raises(InputError) as caught:
        noise_model(spec, others=["aggressive"])
    assert caught.value.where == "noise"
    for fragment in fragments:
        assert fragment in str(caught.value)
