"""The example of CONTRIBUTING-predictors.md runs, and gives what it says."""

import re
from pathlib import Path
from typing import Any

import numpy as np

from probevo.predictors import Needs

PAGE = Path(__file__).parents[2] / "CONTRIBUTING-predictors.md"
PYTHON = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)


def test_the_example_of_a_predictor_that_looks_at_the_right_image() -> None:
    """The right image is the left one, shifted by the disparity and darker by 9 grey levels."""
    (code,) = PYTHON.findall(PAGE.read_text("utf-8"))
    names: dict[str, Any] = {}
    exec(compile(code, str(PAGE), "exec"), names)
    assert Needs.RIGHT in names["STEREO_CONTRAST"].needs
    phi = names["odometry"].phi
    assert len(phi) > 100
    np.testing.assert_allclose(phi, np.full((len(phi), 1), np.log(10.0)), rtol=1e-12)
