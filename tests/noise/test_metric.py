"""The metric of a prediction space: standardised, with a place for what is undefined, and strict
about its input."""

from dataclasses import replace

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.noise.metric import FARTHEST, RARELY_UNDEFINED, UNDEFINED, Metric

COLUMNS = ("blur", "speed", "entropy")


@pytest.fixture
def data() -> FloatArray:
    """200 places of three columns of very different size, [200, 3]."""
    return np.random.default_rng(0).normal([0.3, -20.0, 1e6], [0.1, 5.0, 1e3], (200, 3))


def test_each_column_has_mean_0_and_spread_1(data: FloatArray) -> None:
    coordinates = Metric.fitted(data, COLUMNS).coordinates(data)
    np.testing.assert_allclose(coordinates.mean(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(coordinates.std(axis=0), 1.0, rtol=1e-9)


def test_a_mask_of_numpy_says_what_may_be_undefined(data: FloatArray) -> None:
    """The names that JSON has for truth are Python's."""
    metric = Metric.fitted(data, COLUMNS, np.array([False, True, False]))
    assert metric.may_be_undefined == (False, True, False)
    assert all(type(value) is bool for value in metric.may_be_undefined)


def test_units_do_not_matter(data: FloatArray) -> None:
    """A column in other units, with another zero, gives the same places."""
    factor = np.array([100.0, 3.6, -1.0])
    offset = np.array([7.0, 0.0, 273.15])
    scaled = factor * data + offset
    expected = np.sign(factor) * Metric.fitted(data).coordinates(data)
    np.testing.assert_allclose(Metric.fitted(scaled).coordinates(scaled), expected, atol=1e-9)


def test_new_data_are_measured_by_the_training_data(data: FloatArray) -> None:
    metric = Metric.fitted(data, COLUMNS)
    shifted = data.mean(axis=0) + 2.0 * data.std(axis=0)
    np.testing.assert_allclose(metric.coordinates(shifted[None]), [[2.0, 2.0, 2.0]], rtol=1e-9)


def test_a_weight_stretches_its_column(data: FloatArray) -> None:
    weight = np.array([1.0, 0.25, 3.0])
    plain = Metric.fitted(data, COLUMNS)
    weighted = replace(plain, weight=weight)
    np.testing.assert_allclose(weighted.coordinates(data), weight * plain.coordinates(data))


def test_what_is_undefined_lies_in_a_place_of_its_own(data: FloatArray) -> None:
    """It takes no part in mean and spread, and is no nearer to some defined value than to another's
    like."""
    data[50:60, 1] = np.nan
    metric = Metric.fitted(data, COLUMNS, (False, True, False))
    defined = np.delete(data[:, 1], np.s_[50:60])
    assert (metric.mean[1], metric.spread[1]) == pytest.approx((defined.mean(), defined.std()))
    coordinates = metric.coordinates(data)
    np.testing.assert_array_equal(coordinates[50:60, 1], UNDEFINED)
    assert (coordinates[:50, 1] > UNDEFINED).all()
    assert np.isfinite(coordinates).all()


@pytest.mark.parametrize(("num_undefined", "is_apart"), [(0, False), (9, False), (10, True)])
def test_what_training_has_hardly_seen_undefined_lies_at_the_mean(
    num_undefined: int, is_apart: bool
) -> None:
    """Less than 1 % of the values. Apart, it would be like the lowest of them."""
    places = np.random.default_rng(0).normal(size=(1000, 3))
    places[:num_undefined, 2] = np.nan
    metric = Metric.fitted(places, COLUMNS, (False, False, True))
    query = np.array([[0.3, 0.2, np.nan], [0.3, 0.2, 0.1]])
    expected = UNDEFINED if is_apart else 0.0
    assert metric.coordinates(query)[0, 2] == pytest.approx(expected, abs=1e-5)
    np.testing.assert_array_equal(metric.is_unknown(query), [not is_apart, False])
    # A column that does not contribute says nothing, defined or not.
    unweighted = replace(metric, weight=np.array([1.0, 1.0, 0.0]))
    assert not unweighted.is_unknown(query).any()


def test_a_subset_of_columns_keeps_where_undefined_values_lie(data: FloatArray) -> None:
    data[::4, 2] = np.nan
    metric = Metric.fitted(data, COLUMNS, (False, True, True)).subset(np.array([1, 2]))
    np.testing.assert_array_equal(metric.undefined_at, [RARELY_UNDEFINED, UNDEFINED])


def test_an_undefined_value_is_weighed_too(data: FloatArray) -> None:
    data[::4, 0] = np.nan
    metric = replace(
        Metric.fitted(data, COLUMNS, (True, False, False)), weight=np.array([0.3, 1.0, 1.0])
    )
    assert metric.coordinates(data)[4, 0] == pytest.approx(0.3 * UNDEFINED)


@pytest.mark.parametrize("value", [0.0, 0.1, -1e6 / 3.0])
def test_a_constant_column_counts_for_nothing(data: FloatArray, value: float) -> None:
    """Its spread is zero but for rounding: no division by that, neither now nor where the value is
    another."""
    data[:, 1] = value
    metric = Metric.fitted(data, COLUMNS)
    assert metric.spread[1] == 1.0
    np.testing.assert_allclose(metric.coordinates(data)[:, 1], 0.0, atol=1e-6)
    other = data[:1] + np.array([0.0, 2.0, 0.0])
    assert metric.coordinates(other)[0, 1] == pytest.approx(2.0, abs=1e-6)


@pytest.mark.parametrize("value", [1e9, -1e300])
def test_values_far_out_are_clipped(data: FloatArray, value: float) -> None:
    """Its square would overflow in single precision."""
    metric = Metric.fitted(data, COLUMNS)
    place = metric.coordinates(np.array([[value, -20.0, 1e6]]))
    assert place[0, 0] == np.sign(value) * FARTHEST
    assert np.abs(place[0, 1:]).max() < 1.0


def test_no_column_and_no_feature_are_fine(data: FloatArray) -> None:
    assert Metric.fitted(np.zeros((5, 0))).coordinates(np.zeros((3, 0))).shape == (3, 0)
    assert Metric.fitted(data, COLUMNS).coordinates(np.zeros((0, 3))).shape == (0, 3)


def test_columns_without_names_are_numbered(data: FloatArray) -> None:
    assert Metric.fitted(data).columns == ("column 0", "column 1", "column 2")


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("at", ["training", "prediction"])
def test_a_value_that_is_no_number_is_named(data: FloatArray, value: float, at: str) -> None:
    """Infinity is refused everywhere, NaN where nobody has said that a column may be undefined."""
    metric = Metric.fitted(data, COLUMNS)
    bad = data.copy()
    bad[17, 1] = value
    with pytest.raises(InputError) as caught:
        Metric.fitted(bad, COLUMNS) if at == "training" else metric.coordinates(bad)
    assert str(caught.value).startswith(
        f"predictor speed: feature 17 (from 0) has the value {value}."
    )


def test_infinity_is_refused_where_nan_is_not(data: FloatArray) -> None:
    data[5, 0] = np.nan
    data[6, 0] = -np.inf
    with pytest.raises(InputError, match=r"predictor blur: feature 6 .* -inf"):
        Metric.fitted(data, COLUMNS, (True, False, False))


@pytest.mark.parametrize("defined", [0, 1])
def test_a_column_that_is_undefined_nearly_everywhere_is_refused(
    data: FloatArray, defined: int
) -> None:
    data[defined:, 2] = np.nan
    with pytest.raises(InputError) as caught:
        Metric.fitted(data, COLUMNS, (False, False, True))
    assert f"predictor entropy: it is undefined for all but {defined} of 200 features." in str(
        caught.value
    )
    assert "Leave it out." in str(caught.value)


def test_a_single_feature_has_no_spread() -> None:
    metric = Metric.fitted(np.array([[3.0, -2.0, 0.0]]), COLUMNS)
    np.testing.assert_array_equal(
        metric.coordinates(np.array([[4.0, -2.0, 0.5]])), [[1.0, 0.0, 0.5]]
    )


def test_without_any_feature_there_is_no_metric() -> None:
    with pytest.raises(InputError, match="all but 0 of 0"):
        Metric.fitted(np.zeros((0, 3)), COLUMNS)


@pytest.mark.parametrize("shape", [(7,), (7, 2), (7, 4), (7, 3, 1), ()])
def test_other_shapes_are_refused(data: FloatArray, shape: tuple[int, ...]) -> None:
    metric = Metric.fitted(data, COLUMNS)
    with pytest.raises(
        InputError, match=r"predictors: their shape is .*\[N, 3\]: blur, speed, entropy"
    ):
        metric.coordinates(np.zeros(shape))
    with pytest.raises(InputError, match="predictors: their shape is"):
        Metric.fitted(np.zeros(shape), COLUMNS)
