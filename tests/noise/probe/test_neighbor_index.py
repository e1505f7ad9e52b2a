"""The quick mean over nearest neighbours against the exact one, which looks at every sample."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.noise.probe.neighbor_index import NeighborIndex
from probevo.noise.probe.neighbor_index_numba import MAX_VISITED_OF_CELL


def exact_means(
    samples: FloatArray, values: FloatArray, queries: FloatArray, neighbors: list[int]
) -> FloatArray:
    """Mean value over the K nearest, for several K, [n, J], by sorting the distances to all
    samples."""
    found = np.empty((len(queries), len(neighbors)))
    for query, row in zip(queries, found, strict=True):
        nearest = values[np.argsort(np.sum((samples - query) ** 2, axis=1), kind="stable")]
        row[:] = [nearest[:k].mean() for k in neighbors]
    return found


def means(
    samples: FloatArray, values: FloatArray, queries: FloatArray, neighbors: list[int]
) -> FloatArray:
    return NeighborIndex.build(samples, values).mean_of_nearest(queries, np.array(neighbors))


@pytest.mark.parametrize("dimension", [1, 2, 10])
@pytest.mark.parametrize("count", [1, 2, 9, 60])
def test_it_is_exact_where_every_cell_is_visited(count: int, dimension: int) -> None:
    """With K ≥ N/8, eight times K candidates are all samples; queries lie among them and far
    outside."""
    rng = np.random.default_rng([count, dimension])
    samples = rng.normal(size=(count, dimension))
    values = rng.normal(size=count)
    queries = np.geomspace(0.1, 30.0, 40)[:, None] * rng.normal(size=(40, dimension))
    neighbors = sorted({max(1, count // 8 + 1), (count + 1) // 2, count})
    expected = exact_means(samples, values, queries, neighbors)
    np.testing.assert_allclose(
        means(samples, values, queries, neighbors), expected, rtol=1e-5, atol=1e-6
    )


def test_the_nearest_of_all_is_the_sample_itself() -> None:
    rng = np.random.default_rng(0)
    samples = rng.normal(size=(300, 4))
    values = rng.normal(size=300)
    np.testing.assert_allclose(means(samples, values, samples, [1])[:, 0], values, rtol=1e-6)


Landscape = tuple[FloatArray, FloatArray, FloatArray]
"""Samples, a smooth function at them, and queries."""


def smooth(places: FloatArray) -> FloatArray:
    return 0.5 * np.sin(2.0 * places[:, 0]) + 0.3 * places[:, 1] * places[:, 2] + 0.5 * places[:, 3]


@pytest.fixture(scope="module")
def landscape() -> Landscape:
    """2·10⁴ samples in ten dimensions that are correlated, as predictors are; and 500 queries."""
    rng = np.random.default_rng(1)
    factors = rng.normal(size=(4, 10))
    places = rng.normal(size=(20_500, 4)) @ factors / 2.0 + 0.3 * rng.normal(size=(20_500, 10))
    return places[:20_000], smooth(places[:20_000]) + 0.5 * rng.normal(size=20_000), places[20_000:]


@pytest.mark.parametrize("k", [10, 100, 800])
def test_in_ten_dimensions_it_is_nearly_exact(landscape: Landscape, k: int) -> None:
    """Correlated over 0.97 (it is 0.99), as spread out, and off by no more than a hundredth of it
    on average."""
    quick = means(*landscape, [k])[:, 0]
    exact = exact_means(*landscape, [k])[:, 0]
    assert np.corrcoef(quick, exact)[0, 1] > 0.97
    assert abs(np.mean(quick - exact)) < 0.01 * exact.std()
    assert np.std(quick) == pytest.approx(np.std(exact), rel=0.02)


def test_where_all_ten_dimensions_are_independent_it_predicts_nearly_as_well() -> None:
    """The worst case, where it misses the most: the error against the truth is at most a tenth
    above the exact one's.

    With half as much noise as signal, and K = 100.
    """
    rng = np.random.default_rng(2)
    samples = rng.normal(size=(20_000, 10))
    queries = rng.normal(size=(500, 10))
    values = smooth(samples) + 0.5 * rng.normal(size=20_000)
    errors = [
        np.sqrt(np.mean((of(samples, values, queries, [100])[:, 0] - smooth(queries)) ** 2))
        for of in (means, exact_means)
    ]
    assert errors[0] < 1.1 * errors[1]


def test_several_k_at_once_equal_one_at_a_time(landscape: Landscape) -> None:
    """Where both visit all cells; otherwise the largest K decides how many are visited, for all."""
    samples = landscape[0][:1000]
    values = landscape[1][:1000]
    queries = landscape[2][:100]
    neighbors = [400, 130, 1000, 400]
    separate = np.column_stack([means(samples, values, queries, [k])[:, 0] for k in neighbors])
    np.testing.assert_array_equal(means(samples, values, queries, neighbors), separate)


def test_with_k_as_large_as_n_it_is_the_overall_mean(landscape: Landscape) -> None:
    samples, values, queries = landscape
    np.testing.assert_allclose(
        means(samples, values, queries, [len(values)]), values.mean(), atol=1e-4
    )


def test_samples_in_one_place_all_count() -> None:
    """A hundred samples in one place, and any K: all of them tie, and their mean is taken."""
    values = np.random.default_rng(2).normal(size=100)
    for query in ([[1.0, 2.0]], [[-5.0, 7.0]]):
        found = means(np.tile([1.0, 2.0], (100, 1)), values, np.array(query), [1, 50, 100])
        np.testing.assert_allclose(found, values.mean(), rtol=1e-5)


def test_ties_at_the_limit_all_count() -> None:
    """Four samples at a distance of 1, of which two are wanted, and others farther away."""
    samples = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0], [3.0, 0.0], [0.0, 4.0]])
    values = np.array([1.0, 2.0, 3.0, 6.0, 100.0, 200.0])
    np.testing.assert_allclose(
        means(samples, values, np.zeros((1, 2)), [2, 5]), [[3.0, 22.4]], rtol=1e-6
    )


def test_a_sample_far_out_does_not_hide_the_near_ones() -> None:
    """One sample a thousand standard deviations out, as many as the metric allows, among 2,000: a
    sample or two of 250 may be another."""
    rng = np.random.default_rng(3)
    samples = rng.normal(size=(2000, 3))
    values = rng.normal(size=2000)
    samples[7] = 1000.0
    queries = 0.3 * rng.normal(size=(50, 3))
    np.testing.assert_allclose(
        means(samples, values, queries, [250]),
        exact_means(samples, values, queries, [250]),
        atol=0.02,
    )


@pytest.mark.parametrize("query", [1e6, 1e19, 1e30, np.inf, np.nan])
def test_a_query_from_beyond_single_precision_does_no_harm(query: float) -> None:
    """Squares of distances overflow; no cell may be visited twice, as there is room for each
    sample once."""
    rng = np.random.default_rng(4)
    index = NeighborIndex.build(rng.normal(size=(2000, 3)), rng.normal(size=2000))
    first = index.mean_of_nearest(np.zeros((5, 3)), np.array([20]))
    assert index.mean_of_nearest(np.full((50, 3), query), np.array([20, 2000])).shape == (50, 2)
    np.testing.assert_array_equal(index.mean_of_nearest(np.zeros((5, 3)), np.array([20])), first)


def test_a_constant_column_is_no_matter() -> None:
    """With 5·10⁴ samples, it is as near to the exact mean as without that column."""
    rng = np.random.default_rng(6)
    places = rng.normal(size=(50_000, 3))
    queries = rng.normal(size=(200, 3))
    places[:, 1] = queries[:, 1] = 0.7
    values = np.sin(places[:, 0]) + 0.5 * places[:, 2] + 0.5 * rng.normal(size=50_000)
    quick, exact = (of(places, values, queries, [100])[:, 0] for of in (means, exact_means))
    assert np.corrcoef(quick, exact)[0, 1] > 0.99
    assert abs(np.mean(quick - exact)) < 0.01 * exact.std()


@pytest.mark.parametrize("away", [0, 500])
def test_of_many_samples_in_one_place_random_ones_are_visited(away: int) -> None:
    """5·10⁴ samples alike, whose value grows from first to last; beside them, some elsewhere: the
    mean is that of all of them, within four standard errors."""
    values = np.linspace(0.0, 1.0, 50_000)
    places = np.concatenate(
        [np.zeros((50_000, 2)), 9.0 + np.random.default_rng(7).normal(size=(away, 2))]
    )
    found = means(places, np.concatenate([values, np.full(away, 7.0)]), np.zeros((1, 2)), [10])
    assert abs(found[0, 0] - 0.5) < 4.0 * values.std() / np.sqrt(MAX_VISITED_OF_CELL)


def test_no_query_no_mean() -> None:
    assert means(np.zeros((3, 2)), np.ones(3), np.zeros((0, 2)), [1, 2]).shape == (0, 2)


def test_every_sample_is_in_the_cell_of_its_nearest_center(landscape: Landscape) -> None:
    samples, values, _ = landscape
    index = NeighborIndex.build(samples[:3000], values[:3000])
    cell = np.repeat(np.arange(index.centers.shape[1]), np.diff(index.first_of_cell))
    distance = np.linalg.norm(index.samples.T[:, None, :] - index.centers.T[None], axis=2)
    np.testing.assert_allclose(distance[np.arange(3000), cell], distance.min(axis=1), rtol=1e-5)
    np.testing.assert_array_equal(np.sort(index.values), np.sort(values[:3000].astype(np.float32)))


def test_the_order_of_the_samples_hardly_matters(landscape: Landscape) -> None:
    """Other centers, other cells; nearly the same means."""
    samples, values, queries = landscape
    order = np.random.default_rng(5).permutation(len(values))
    first = means(samples, values, queries, [100])
    second = means(samples[order], values[order], queries, [100])
    assert np.corrcoef(first[:, 0], second[:, 0])[0, 1] > 0.97
