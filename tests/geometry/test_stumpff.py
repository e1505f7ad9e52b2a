from __future__ import annotations

from fractions import Fraction
from math import factorial, pi

import numpy as np
import pytest

from probevo.geometry.stumpff import stumpff


@pytest.mark.parametrize("order", [0, 1, 2, 3, 4, 5])
def test_matches_the_exact_series(order: int) -> None:
    """Relative error below 1e-12 against a 40-term sum of exact fractions, on both sides of the switch at 1 rad."""
    for angle in [0.0, 1e-9, 1e-3, 0.5, 1.0 - 1e-12, 1.0, 1.0 + 1e-12, 1.4, 2.5, pi - 1e-9]:
        angle_sq = angle**2
        exact = sum((-Fraction(angle_sq)) ** k / factorial(2 * k + order) for k in range(40))
        assert stumpff(order, np.array(angle_sq)) == pytest.approx(float(exact), rel=1e-12)
