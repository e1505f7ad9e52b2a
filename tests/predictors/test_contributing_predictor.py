"""The example of "Add a predictor" in CONTRIBUTING.md runs, and gives what it says."""

from typing import Any

import numpy as np

from contributing import example
from probevo.predictors import Needs


def test_the_example_of_a_predictor_that_looks_at_the_right_image() -> None:
    """The right image is the left one, shifted by the disparity and darker by 9 grey levels."""
    names: dict[str, Any] = {}
    exec(compile(example("Add a predictor"), "CONTRIBUTING.md", "exec"), names)
    assert Needs.RIGHT in names["STEREO_CONTRAST"].needs
    phi = names["odometry"].phi
    assert len(phi) > 50
    np.testing.assert_allclose(phi, np.full((len(phi), 1), np.log(10.0)), rtol=1e-12)
