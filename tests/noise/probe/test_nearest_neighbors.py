"""PROBE's noise model: β by hand, what it does to the base, what it refuses."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.noise import Fixed, NoiseModel, StudentT
from probevo.noise.metric import UNDEFINED, Metric
from probevo.noise.probe.nearest_neighbors import MAX_BETA, NearestNeighbors

PLACES = np.array([[0.0], [1.0], [10.0], [11.0]])
ALPHAS = np.array([1.0, 3.0, 8.0, 4.0])
"""Their mean is 4, that of the first two 2, and that of the last two 6."""
QUERIES = np.array([[0.4], [10.6], [-50.0]])


def fitted(alphas: FloatArray = ALPHAS, neighbors: int = 2, **options: Any) -> NearestNeighbors:
    return NearestNeighbors(neighbors, **options).fit(PLACES, alphas)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 2.0, 7.0])
def test_beta_is_that_of_probe(exponent: float) -> None:
    """(mean of the K nearest α over the mean of all)^γ, PROBE Fig. 3."""
    model = fitted(exponent=exponent, average="arithmetic")
    np.testing.assert_allclose(
        model.weights(QUERIES), np.array([0.5, 1.5, 0.5]) ** exponent, rtol=1e-5
    )
    assert np.exp(model.log_mean_alpha_) == pytest.approx(4.0)


def test_the_geometric_average_is_that_of_logarithms() -> None:
    overall = (1.0 * 3.0 * 8.0 * 4.0) ** 0.25
    expected = np.array([np.sqrt(3.0), np.sqrt(32.0), np.sqrt(3.0)]) / overall
    np.testing.assert_allclose(fitted(exponent=3.0).weights(QUERIES), expected**3.0, rtol=1e-5)


@pytest.mark.parametrize("average", ["arithmetic", "geometric"])
def test_with_all_as_neighbours_beta_is_one(average: str) -> None:
    model = fitted(neighbors=4, exponent=20.0, average=average)
    np.testing.assert_allclose(model.weights(QUERIES), 1.0, rtol=1e-4)


@pytest.mark.parametrize("average", ["arithmetic", "geometric"])
def test_the_unit_of_alpha_does_not_matter(average: str) -> None:
    in_m, in_mm = (fitted(unit * ALPHAS, exponent=4.0, average=average) for unit in (1.0, 1e3))
    np.testing.assert_allclose(in_m.weights(QUERIES), in_mm.weights(QUERIES), rtol=1e-4)


@pytest.mark.parametrize(
    "base", [Fixed(), StudentT(), StudentT(dof=3.0), Fixed(np.diag([1.0, 2.0, 3.0, 4.0]))]
)
def test_an_exponent_of_0_gives_the_base(base: Fixed | StudentT) -> None:
    noise = fitted(exponent=0.0, base=base).predict(QUERIES)
    expected = base.predict(QUERIES)
    np.testing.assert_array_equal(noise.scale, expected.scale)
    np.testing.assert_array_equal(noise.dof, expected.dof)
    np.testing.assert_array_equal(noise.bias, expected.bias)
    assert noise.refers_to == "observation"


@pytest.mark.parametrize("base", [Fixed(), StudentT()])
def test_the_noise_is_beta_times_that_of_the_base(base: Fixed | StudentT) -> None:
    """The covariance of a feature grows by β; how heavy its tails are stays."""
    model = fitted(exponent=2.0, average="arithmetic", base=base)
    noise = model.predict(QUERIES)
    R = base.predict(QUERIES).scale
    np.testing.assert_allclose(
        noise.scale, np.array([0.25, 2.25, 0.25])[:, None, None] * R, rtol=1e-4
    )
    np.testing.assert_array_equal(noise.dof, base.predict(QUERIES).dof)


def test_beta_is_bounded() -> None:
    """To four orders of magnitude: neither overflow nor zero."""
    model = NearestNeighbors(1, exponent=300.0).fit(PLACES, np.array([1e-6, 1.0, 1.0, 1e6]))
    np.testing.assert_allclose(
        model.weights(PLACES[[0, 3]]),
        [1.0 / MAX_BETA, MAX_BETA],
        rtol=1e-9,
    )


def test_the_nearest_are_those_of_the_standardised_columns() -> None:
    """A column in millimetres does not dominate the informative one: 2,000 samples, α 1 or 3 by the
    sign of the first."""
    rng = np.random.default_rng(0)
    places = rng.normal(size=(2000, 2)) * [1.0, 1e3]
    model = NearestNeighbors(20, exponent=1.0).fit(places, np.where(places[:, 0] > 0.0, 3.0, 1.0))
    beta = model.weights(np.array([[1.0, 0.0], [-1.0, 0.0]]))
    assert beta[0] / beta[1] == pytest.approx(3.0, rel=1e-3)


def test_lists_will_do() -> None:
    model = NearestNeighbors(2).fit(PLACES.tolist(), ALPHAS.tolist())
    np.testing.assert_array_equal(
        model.weights(QUERIES), NearestNeighbors(2).fit(PLACES, ALPHAS).weights(QUERIES)
    )


def test_a_single_sample_is_all_alike() -> None:
    np.testing.assert_allclose(
        NearestNeighbors(1).fit(PLACES[:1], ALPHAS[:1]).weights(QUERIES), 1.0
    )


def test_a_given_metric_is_used() -> None:
    """One in which the first column counts for nothing, and the second may be undefined."""
    places = np.array([[0.0, 5.0], [9.0, 5.1], [0.1, np.nan], [9.1, np.nan]])
    metric = replace(
        Metric.fitted(places, ("speed", "blur"), (False, True)), weight=np.array([0.0, 1.0])
    )
    model = NearestNeighbors(2, exponent=1.0, average="arithmetic").fit(
        places, ALPHAS, metric=metric
    )
    assert model.columns == ("speed", "blur")
    np.testing.assert_allclose(
        model.weights(np.array([[4.0, 5.05], [4.0, np.nan]])), [0.5, 1.5], rtol=1e-5
    )


def test_it_is_a_noise_model_whose_predictions_are_pure() -> None:
    model: NoiseModel = fitted()
    first = model.predict(QUERIES).scale
    model.predict(100.0 * QUERIES)
    np.testing.assert_array_equal(model.predict(QUERIES).scale, first)
    np.testing.assert_array_equal(model.predict(QUERIES[1:]).scale, first[1:])
    assert model.predict(np.zeros((0, 1))).scale.shape == (0, 4, 4)
    assert model.columns == ("column 0",)


@pytest.mark.parametrize("average", ["arithmetic", "geometric"])
@pytest.mark.parametrize("weight", [(1.0, 1.0, 1.0), (1.1, 0.3, 7.0)])
def test_the_samples_come_back(average: str, weight: tuple[float, ...]) -> None:
    """In another order, NaN where they were undefined, to single precision."""
    rng = np.random.default_rng(1)
    places = rng.normal([0.0, 30.0, -5.0], [1.0, 9.0, 0.1], (400, 3))
    alphas = np.exp(rng.normal(size=400))
    places[rng.random(400) < 0.2, 1] = np.nan
    metric = replace(
        Metric.fitted(places, ("a", "b", "c"), (False, True, False)), weight=np.array(weight)
    )
    model = NearestNeighbors(5, average=average).fit(places, alphas, metric=metric)  # type: ignore[arg-type]
    found, log_relative = model.samples()
    order = np.argsort(found[:, 0])
    expected = np.argsort(places[:, 0])
    np.testing.assert_allclose(found[order], places[expected], rtol=1e-5, atol=1e-5)
    mean = np.exp(np.mean(np.log(alphas))) if average == "geometric" else np.mean(alphas)
    np.testing.assert_allclose(
        log_relative[order], np.log(alphas / mean)[expected], rtol=1e-4, atol=1e-5
    )


@pytest.mark.parametrize("num_undefined", [0, 4, 24])
def test_what_training_has_hardly_seen_undefined_is_not_like_the_lowest(num_undefined: int) -> None:
    """Fewer than half of K: where α grows with a column, an undefined value made it the least."""
    rng = np.random.default_rng(3)
    places = rng.normal(size=(1000, 2))
    alphas = np.exp(places[:, 0] + places[:, 1])
    places[:num_undefined, 1] = np.nan
    metric = Metric.fitted(places, ("a", "b"), (False, True))
    model = NearestNeighbors(50).fit(places, alphas, metric=metric)
    mean, undefined, lowest = model.log_relative_alpha(
        np.array([[0.0, metric.mean[1]], [0.0, np.nan], [0.0, -2.5]])
    )
    assert undefined == pytest.approx(mean, abs=1e-3)
    assert lowest < mean - 1.0
    found, _ = model.samples()
    assert np.isnan(found[:, 1]).sum() == num_undefined


def test_what_is_often_undefined_has_neighbors_of_its_own() -> None:
    rng = np.random.default_rng(3)
    places = rng.normal(size=(1000, 2))
    places[:100, 1] = np.nan
    alphas = np.where(np.isnan(places[:, 1]), 10.0, 1.0)
    metric = Metric.fitted(places, ("a", "b"), (False, True))
    model = NearestNeighbors(50).fit(places, alphas, metric=metric)
    undefined, defined = model.log_relative_alpha(np.array([[0.0, np.nan], [0.0, 0.0]]))
    assert undefined - defined == pytest.approx(np.log(10.0), abs=1e-6)


def test_a_defined_value_where_the_undefined_lie_stays_defined() -> None:
    """Four standard deviations below the mean, in a column that is never undefined."""
    places = np.array([[-4.0], [0.0], [4.0]])
    metric = Metric(
        ("a",),
        (False,),
        np.zeros(1),
        spread=np.ones(1),
        weight=np.ones(1),
        undefined_at=np.full(1, UNDEFINED),
    )
    found, _ = NearestNeighbors(1).fit(places, np.ones(3), metric=metric).samples()
    np.testing.assert_allclose(np.sort(found[:, 0]), [-4.0, 0.0, 4.0])


@pytest.mark.parametrize("count", [0, 1, 99])
def test_k_larger_than_the_data_is_refused(count: int) -> None:
    with pytest.raises(InputError) as caught:
        NearestNeighbors(100).fit(np.zeros((count, 2)), np.ones(count))
    assert caught.value.where == "--neighbors"
    assert f"K is 100, but there are only {count} samples." in str(caught.value)
    assert caught.value.cure == "Choose a smaller K, or train on more."


@pytest.mark.parametrize("k", [0, -3])
def test_k_below_1_is_refused(k: int) -> None:
    with pytest.raises(InputError, match=f"--neighbors: K is {k}"):
        fitted(neighbors=k)


@pytest.mark.parametrize("alpha", [0.0, -1.0, np.nan, np.inf])
def test_an_alpha_that_is_no_positive_number_is_refused(alpha: float) -> None:
    with pytest.raises(InputError, match="training data: an error α is not a positive number"):
        fitted(np.array([1.0, 2.0, alpha, 3.0]))


def test_places_and_alphas_of_different_number_are_refused() -> None:
    with pytest.raises(InputError, match="4 points, but 3 errors"):
        NearestNeighbors(1).fit(PLACES, np.ones(3))
