"""The example of "Add a noise model" in the CONTRIBUTING.md works as it is printed."""

import runpy
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from contributing import example as example_of
from probevo.noise import registry
from probevo.noise.named import noise_model
from probevo.noise.registry import kind_of
from worlds import CAMERA


@pytest.fixture
def example(tmp_path: Path) -> dict[str, Any]:
    """The names that the Python block of the section defines."""
    path = tmp_path / "example.py"
    path.write_text(example_of("Add a noise model"), "utf-8")
    return runpy.run_path(str(path))


def test_the_model_of_the_example_is_selected_by_its_name(
    example: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through an entry point, as the text says; its noise grows with the predictor."""
    monkeypatch.setitem(sys.modules, "my_module", SimpleNamespace(**example))
    point = EntryPoint(name="blurred", value="my_module:BLURRED", group="probevo.noise")
    monkeypatch.setattr(registry, "entry_points", lambda group: [point])
    model = noise_model("blurred")
    assert kind_of(model) is example["BLURRED"]
    assert model.columns == ("blur",)
    model.check_camera(CAMERA)
    noise = model.predict(np.array([[0.0], [1.0]]))
    np.testing.assert_allclose(noise.scale[:, 0, 0], [0.01, 0.25])
    assert np.isfinite(noise.log_likelihood(np.zeros((2, 4)))).all()
