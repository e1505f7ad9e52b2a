"""Moments gathered part by part are those of the whole, also where values are undefined or parts
are empty."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from probevo.arrays import FloatArray
from probevo.noise.moments import Moments


def data(rows: int = 60) -> FloatArray:
    """Far from zero and of small spread, one value in five undefined; the last column always."""
    rng = np.random.default_rng(3)
    found = rng.normal(size=(rows, 4)) * [1.0, 1e-3, 1e3, 1.0] + [0.0, 5e3, -1.0, 0.0]
    found[rng.random((rows, 4)) < 0.2] = np.nan
    found[:, 3] = np.nan
    return found


@given(st.lists(st.integers(0, 60), max_size=6))
def test_parts_add_up_to_the_whole(cuts: list[int]) -> None:
    whole = Moments.of(data())
    parts = np.split(data(), sorted(cuts))
    added = sum(map(Moments.of, parts), Moments.none(4))
    np.testing.assert_array_equal(added.count, whole.count)
    assert added.rows == 60
    np.testing.assert_allclose(added.mean, whole.mean, rtol=1e-12)
    np.testing.assert_allclose(added.spread, whole.spread, rtol=1e-9)


def test_they_are_mean_and_standard_deviation() -> None:
    found = Moments.of(data())
    defined = data()[:, :3]
    np.testing.assert_allclose(found.mean[:3], np.nanmean(defined, axis=0), rtol=1e-13)
    np.testing.assert_allclose(found.spread[:3], np.nanstd(defined, axis=0), rtol=1e-9)
    assert (found.mean[3], found.spread[3], found.count[3]) == (0.0, 0.0, 0)


@pytest.mark.parametrize("columns", [0, 2])
def test_of_nothing_there_are_none(columns: int) -> None:
    found = Moments.of(np.zeros((0, columns))) + Moments.none(columns)
    assert found.rows == 0
    np.testing.assert_array_equal(found.mean, np.zeros(columns))
    np.testing.assert_array_equal(found.spread, np.zeros(columns))
