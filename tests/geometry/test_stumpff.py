from __future__ import annotations

from fractions import Fraction
from math import factorial, pi

import numpy as np
import pytest

from probevo.geometry.stumpff import stumpff


@pytest.mark.parametrize("order", [0, 1, 2, 3])
def test_matches_the_exact_series(order: int) -> None:
    """Relative error below 1e-12 against a 40-term sum of exact fractions, on both sides of the
    switch at 1 rad."""
    for angle in [0.0, 1e-9, 1e-3, 0.5, 1.0 - 1e-12, 1.0, 1.0 + 1e-12, 1.4, 2.5, pi - 1e-9]:
        angle_sq = angle**2
        exact = sum((-Fraction(angle_sq)) ** k / factorial(2 * k + order) for k in range(40))
        assert stumpff((order,), np.array(angle_sq))[0] == pytest.approx(float(exact), rel=1e-12)


def test_several_orders_and_angles_at_once() -> None:
    """The same as one by one, small and large angles together."""
    angle_sq = np.array([[0.0, 0.3], [4.0, 9.0]])
    found = stumpff((3, 0, 2), angle_sq)
    assert found.shape == (3, 2, 2)
    for own, order in zip(found, (3, 0, 2), strict=True):
        one_by_one = [[stumpff((order,), each)[0] for each in row] for row in angle_sq]
        np.testing.assert_allclose(own, one_by_one, rtol=1e-13)
