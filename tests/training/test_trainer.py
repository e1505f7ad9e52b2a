"""The trainers behind one interface: found by the registry, and separate from what comes after."""

import subprocess
import sys
from dataclasses import replace

import pytest

from probevo.config.training import KernelSettings, TrainSettings
from probevo.errors import InputError
from probevo.noise.registry import noise_kinds
from probevo.predictors import prediction_space
from probevo.training import trainer as trainer_module
from probevo.training.trainer import Trainer, trainer_of

TRAINED = [name for name, kind in noise_kinds().items() if kind.trainer]


def test_every_kind_that_can_be_read_from_a_file_can_be_trained() -> None:
    readable = {name for name, kind in noise_kinds().items() if kind.from_file is not None}
    assert set(TRAINED) == readable >= {"knn", "gk", "student-t"}


@pytest.mark.parametrize("kind", TRAINED)
def test_the_trainer_of_a_kind_names_settings_that_exist(kind: str) -> None:
    """Its predictors are known, and each setting it does not use is one, with a cure."""
    trainer = trainer_of(kind)
    assert isinstance(trainer, Trainer)
    assert prediction_space(trainer.default_predictors).names == trainer.default_predictors
    fields = {*TrainSettings.model_fields, *(f"gk.{name}" for name in KernelSettings.model_fields)}
    assert set(trainer.unused_settings) <= fields
    assert all(trainer.unused_settings.values())
    assert trainer.num_iterations(TrainSettings()) > 0


@pytest.mark.parametrize("kind", ["fixed", "nonsense"])
def test_a_kind_without_a_trainer_is_refused(kind: str) -> None:
    with pytest.raises(InputError) as caught:
        trainer_of(kind)
    assert str(caught.value).startswith(f"--kind: {kind} cannot be trained.")
    assert all(name in caught.value.cure for name in TRAINED)


def test_a_kind_whose_trainer_is_a_function_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    kinds = dict(noise_kinds())
    kinds["gk"] = replace(kinds["gk"], trainer="probevo.training.gk.learn:learn_kernel")
    monkeypatch.setattr(trainer_module, "noise_kinds", lambda: kinds)
    with pytest.raises(InputError, match="learn_kernel, which learns gk, is not a Trainer"):
        trainer_of("gk")


def test_training_imports_neither_the_runner_nor_the_pages() -> None:
    """Whoever trains does not wait for Matplotlib."""
    code = (
        "import sys, probevo.training.api, probevo.training.gk.learn, probevo.training.probe.learn;"
        "found = [name for name in sys.modules"
        " if name.startswith(('probevo.runs.runner', 'probevo.output', 'matplotlib'))];"
        "sys.exit(', '.join(found) or 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
