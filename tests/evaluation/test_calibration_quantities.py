"""Quantities of a calibration, and when they are far from zero."""

import numpy as np
import pytest

from probevo.cli.calibrate_check import _is_marked, _largest_z
from probevo.evaluation.calibration_quantities import Quantity
from probevo.evaluation.clustered_regression import two_sided_p


def quantity(value: float, dof: float) -> Quantity:
    return Quantity("roll", value, 0.5, "px", p_value=two_sided_p(value / 0.5, dof), cure="Turn.")


@pytest.mark.parametrize("dof", [3.0, 10.0, np.inf])
def test_what_is_marked_is_what_is_beyond_the_band(dof: float) -> None:
    """Whether σ is from few frames or many; the picture draws one band for all."""
    for value in np.linspace(-6.0, 6.0, 41):
        one = quantity(value, dof)
        assert _is_marked(one, 12) == (abs(one.z) > _largest_z(12))
        assert np.sign(one.z) == np.sign(value)


def test_with_a_known_sigma_z_is_the_value_in_sigma() -> None:
    assert quantity(-1.3, np.inf).z == pytest.approx(-2.6)
    assert quantity(500.0, np.inf).z == pytest.approx(1000.0)
    assert quantity(1.3, 4.0).z < 2.6
