import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from probevo.noise.gk.center_search import Leaves
from probevo.noise.gk.center_search_numba import LEAF, NEAREST


@settings(deadline=None)
@given(
    count=st.one_of(st.integers(1, 9), st.integers(LEAF - 1, 5 * LEAF)),
    width=st.integers(1, 20),
    seed=st.integers(0, 999),
    flat=st.booleans(),
)
def test_the_nearest_centers_are_those_of_an_exhaustive_search(
    count: int, width: int, seed: int, flat: bool
) -> None:
    rng = np.random.default_rng(seed)
    places = rng.normal(size=(count, width)) * np.where(flat & (np.arange(width) > 0), 0.0, 1.0)
    queries = 2.0 * rng.normal(size=(30, width))
    index, squared = Leaves.of(places).nearest(queries)
    distance = np.sum((queries[:, None] - places) ** 2, axis=2)
    expected = np.sort(distance, axis=1)[:, :NEAREST]
    np.testing.assert_allclose(squared, expected, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(
        np.take_along_axis(distance, index, 1), expected, rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("width", [3, 12])
@pytest.mark.parametrize("place", [0.0, 1.0])
def test_centers_all_alike_are_all_as_near(width: int, place: float) -> None:
    index, squared = Leaves.of(np.ones((200, width))).nearest(np.full((1, width), place))
    np.testing.assert_allclose(squared, width * (1.0 - place), rtol=1e-6)
    assert len(np.unique(index)) == NEAREST


@pytest.mark.parametrize("far", [1e20, 1e38, 1e300])
def test_what_is_beyond_single_precision_is_infinitely_far(far: float) -> None:
    index, squared = Leaves.of(np.random.default_rng(0).normal(size=(70, 2))).nearest(
        np.array([[far, 0.0]])
    )
    assert (squared == np.inf).all()
    assert (index < 70).all()
