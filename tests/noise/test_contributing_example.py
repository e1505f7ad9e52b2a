"""The example of "Add a noise model" in the contributor's guide works as it is printed."""

import re
import runpy
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from probevo.noise import registry
from probevo.noise.named import noise_model
from probevo.noise.registry import kind_of
from worlds import CAMERA

ROOT = Path(__file__).parents[2]
GUIDES = ("CONTRIBUTING-noise.md", "CONTRIBUTING.md")
SECTION = "## Add a noise model"


@pytest.fixture
def example(tmp_path: Path) -> dict[str, Any]:
    """The names that the first Python block of the section defines."""
    texts = [(ROOT / name).read_text("utf-8") for name in GUIDES if (ROOT / name).exists()]
    section = next(text.split(SECTION)[1] for text in texts if SECTION in text)
    block = re.search(r"```python\n(.*?)```", section, re.DOTALL)
    assert block is not None
    path = tmp_path / "example.py"
    path.write_text(block[1], "utf-8")
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
