"""PROBE-GK with data that are poor, or none: refused in clear words, or answered by something
sound."""

import warnings
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.noise import GeneralizedKernel, StereoNoise
from probevo.noise.metric import FARTHEST, UNDEFINED, Metric

VARIANTS = ["robust", "published"]
COUNT = 60


@pytest.fixture(autouse=True)
def no_warning_of_numpy() -> Iterator[None]:
    """Whatever comes in, nothing is divided by zero, and nothing overflows."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


def places(count: int = COUNT, columns: int = 2, seed: int = 0) -> FloatArray:
    return np.random.default_rng([seed, 0]).normal(size=(count, columns))


def errors(count: int = COUNT, seed: int = 0) -> FloatArray:
    return np.random.default_rng([seed, 1]).normal(size=(count, 4))


def queries(columns: int = 2) -> FloatArray:
    """From within the data to very far away."""
    factor = np.geomspace(1e-9, 1e12, 22)[:, None]
    return np.concatenate([np.zeros((1, columns)), factor * places(22, columns, seed=7)])


def is_sound(noise: StereoNoise) -> bool:
    """Every scale is symmetric and positive definite, every dof positive, every bias a number, as
    is the likelihood."""
    inverse_sigma = 1.0 / np.sqrt(np.diagonal(noise.scale, axis1=1, axis2=2))
    correlation = inverse_sigma[:, :, None] * noise.scale * inverse_sigma[:, None, :]
    return (
        np.array_equal(noise.scale, noise.scale.mT)
        and bool((np.linalg.eigvalsh(correlation) > 0.0).all())
        and bool((np.isfinite(noise.dof) & (noise.dof > 0.0)).all())
        and bool(np.isfinite(noise.bias).all())
        and bool(np.isfinite(noise.log_likelihood(np.ones((len(noise.dof), 4)))).all())
    )


def check(
    phi: FloatArray, residuals: FloatArray, groups: IntArray | None = None, **options: Any
) -> GeneralizedKernel:
    """It is fitted and says something sound of everywhere, from its centers as from all samples;
    and can be written."""
    model = GeneralizedKernel(**options).fit(phi, residuals, groups)
    asked = np.concatenate([queries(phi.shape[1]), phi])
    assert is_sound(model.predict(asked))
    assert is_sound(model.predict_exact(asked))
    file = model.to_file()
    back = GeneralizedKernel.from_file(file)
    assert back.predict(asked).scale.tobytes() == model.predict(asked).scale.tobytes()
    return model


SOUND: dict[str, tuple[Any, ...]] = {
    "residuals all zero": (places(), np.zeros((COUNT, 4))),
    "residuals all alike": (places(), np.ones((COUNT, 4))),
    "residuals of one axis": (places(), errors() * [1.0, 0.0, 0.0, 0.0]),
    "residuals along one line": (places(), np.outer(errors()[:, 0], [1.0, 2.0, -1.0, 0.5])),
    "the same along one line of a million pixels": (
        places(),
        1e6 * np.outer(errors()[:, 0], [1.0, 2.0, -1.0, 0.5]),
    ),
    "one sample": (places(1), errors(1)),
    "one sample of zero": (np.zeros((1, 2)), np.zeros((1, 4))),
    "two samples": (places(2), errors(2)),
    "two samples in one place": (np.ones((2, 2)), errors(2)),
    "collinear predictors": (places(columns=1) * [1.0, 2.0, -3.0], errors()),
    "equal predictors": (np.repeat(places(columns=1), 3, axis=1), errors()),
    "fewer samples than columns": (places(3, 6), errors(3)),
    "a constant predictor": (np.column_stack([places(columns=1), np.full(COUNT, 3.7)]), errors()),
    "constant predictors only": (np.full((COUNT, 2), -1e6 / 3.0), errors()),
    "every sample twice": (np.repeat(places(30), 2, axis=0), np.repeat(errors(30), 2, axis=0)),
    "three samples twenty times": (
        np.repeat(places(3), 20, axis=0),
        np.repeat(errors(3), 20, axis=0),
    ),
    "one sample far out": (np.concatenate([places(), [[1e12, 0.0]]]), errors(COUNT + 1)),
    "groups of one sample each": (places(), errors(), np.arange(COUNT)),
    "one group only": (places(), errors(), np.zeros(COUNT, np.int64)),
    "two groups, of which one has a single sample": (
        places(),
        errors(),
        np.arange(COUNT) // (COUNT - 1),
    ),
    "groups of any numbers": (places(), errors(), np.arange(COUNT) % 3 * 1_000_000 - 5),
    "a single error of a million pixels": (
        places(),
        np.where(np.arange(COUNT)[:, None] == 7, 1e6, errors()),
    ),
}


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("name", SOUND)
def test_poor_data_give_something_sound(name: str, variant: str) -> None:
    check(*SOUND[name], variant=variant)


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize(
    "options",
    [
        {"neighbors": 1},
        {"neighbors": 1000},
        {"centers": 1},
        {"centers": 3},
        {"centers": 10**6},
        {"reach": 1e-9},
        {"reach": 1e6},
        {"reach": np.inf},
        {"prior_counts": 3.01},
        {"prior_counts": 1e9},
        {"bias_counts": 1e-3},
        {"bias_counts": np.inf, "dof_counts": np.inf},
        {"weights": np.array([0.0, 1.0])},
        {"weights": np.array([1e-9, 1e6])},
    ],
)
def test_extreme_hyperparameters_are_accepted(options: dict[str, Any], variant: str) -> None:
    """As K larger than N, or a reach that nothing is within."""
    check(places(), errors(), variant=variant, **options)


def test_one_sample_says_next_to_nothing_elsewhere() -> None:
    """Beyond its reach the prior holds, and it is out of domain."""
    model = check(places(1), errors(1))
    noise = model.predict(queries()[-5:])
    assert noise.out_of_domain is not None
    assert noise.out_of_domain.all()
    np.testing.assert_allclose(noise.scale, np.repeat(model.prior_.scale, 5, axis=0), rtol=1e-4)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("count", [1, COUNT])
def test_a_predictor_that_is_no_number_is_refused(value: float, count: int) -> None:
    bad = places(count)
    bad[count // 2, 1] = value
    with pytest.raises(InputError, match=rf"predictor column 1: feature {count // 2} "):
        GeneralizedKernel().fit(bad, errors(count))


def test_what_may_be_undefined_may_be_so() -> None:
    """In training and after; it then lies in a place of its own."""
    phi = places()
    phi[::3, 1] = np.nan
    model = GeneralizedKernel().fit(
        phi, errors(), metric=Metric.fitted(phi, ("a", "b"), (False, True))
    )
    assert is_sound(model.predict(np.array([[0.0, np.nan], [0.0, 0.0], [1e9, np.nan]])))
    assert model.metric_.coordinates(phi)[0, 1] == pytest.approx(
        UNDEFINED * model.metric_.weight[1]
    )


def test_a_metric_of_weights_0_is_fine() -> None:
    """Those columns do not contribute, whatever the search would give them."""
    metric = replace(Metric.fitted(places(), ("a", "b")), weight=np.array([1.0, 0.0]))
    model = GeneralizedKernel().fit(places(), errors(), metric=metric)
    one = model.predict(np.array([[0.3, 0.0]]))
    other = model.predict(np.array([[0.3, FARTHEST]]))
    np.testing.assert_array_equal(one.scale, other.scale)
    assert np.isfinite(model.weights_).all()


def test_a_metric_in_which_no_column_counts_is_refused() -> None:
    """By itself, or together with the weights that are given."""
    for of_metric, given_weights in (
        (np.zeros(2), None),
        (np.array([1.0, 0.0]), np.array([0.0, 1.0])),
    ):
        metric = replace(Metric.fitted(places(), ("a", "b")), weight=of_metric)
        with pytest.raises(InputError, match="predictors: no column"):
            GeneralizedKernel(weights=given_weights).fit(places(), errors(), metric=metric)


@pytest.mark.parametrize(
    ("phi", "residuals", "message"),
    [
        (places(59), errors(), "training data: 59 points, 60 residuals"),
        (places(), errors(59), "training data: 60 points, 59 residuals"),
        (places(0), errors(0), "residuals: there is none"),
        (places(), np.zeros((COUNT, 3)), r"residuals: their shape is \(60, 3\), where \[N, 4\]"),
        (places(), np.zeros(COUNT), r"residuals: their shape is \(60,\)"),
        (places(), np.zeros((COUNT, 4, 1)), "residuals: their shape is"),
        (places()[:, 0], errors(), r"predictors: their shape is \(60,\)"),
        (places()[..., None], errors(), "predictors: their shape is"),
        (np.zeros((COUNT, 0)), errors(), "predictors: there is no column"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(
    phi: FloatArray, residuals: FloatArray, message: str
) -> None:
    with pytest.raises(InputError, match=message):
        GeneralizedKernel().fit(phi, residuals)


def test_groups_of_another_number_are_refused() -> None:
    with pytest.raises(InputError, match="60 points, 60 residuals and 59 groups"):
        GeneralizedKernel().fit(places(), errors(), np.arange(59))


def test_no_query_no_noise() -> None:
    noise = GeneralizedKernel().fit(places(), errors()).predict(np.zeros((0, 2)))
    assert (noise.scale.shape, noise.dof.shape, noise.bias.shape) == ((0, 4, 4), (0,), (0, 4))


@pytest.mark.parametrize(
    ("variant", "options"),
    [
        ("robust", {"neighbors": 0}),
        ("robust", {"neighbors": -5}),
        ("robust", {"reach": 0.0}),
        ("robust", {"reach": -1.0}),
        ("robust", {"reach": np.nan}),
        ("robust", {"prior_counts": 0.0}),
        ("robust", {"prior_counts": np.inf}),
        ("published", {"prior_counts": 3.0}),
        ("robust", {"dof_counts": -1.0}),
        ("robust", {"bias_counts": np.nan}),
        ("robust", {"neighbors": 8.5}),
        ("robust", {"centers": 0}),
        ("robust", {"centers": 8.5}),
        ("robust", {"centers": np.inf}),
        ("robust", {"weights": np.ones(3)}),
        ("robust", {"weights": np.zeros(2)}),
        ("robust", {"weights": np.array([1.0, -1.0])}),
        ("robust", {"weights": np.array([1.0, np.nan])}),
        ("robust", {"weights": np.array([1.0, 1e30])}),
    ],
)
def test_an_invalid_hyperparameter_is_refused(variant: Any, options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match=f"generalized kernel: {next(iter(options))}") as caught:
        GeneralizedKernel(variant, **options).fit(places(), errors())
    assert caught.value.cure


def test_whole_numbers_may_be_written_as_floats() -> None:
    model = check(places(), errors(), neighbors=8.0, centers=30.0)
    assert (model.shape_.neighbors, len(model.centers_.parameters)) == (8, 30)


@st.composite
def nasty(draw: st.DrawFn) -> tuple[FloatArray, FloatArray]:
    """Samples of any scales, ranks and duplicates, [N, M] and [N, 4]."""
    count = draw(st.integers(1, 40))
    columns = draw(st.integers(1, 4))
    rng = np.random.default_rng(draw(st.integers(0, 10_000)))
    scales = st.floats(-9.0, 9.0).map(lambda exponent: 10.0**exponent)
    phi = rng.normal(size=(count, 1)) @ rng.normal(size=(1, columns))
    if draw(st.booleans()):
        phi = rng.normal(size=(count, columns)) * np.array([draw(scales) for _ in range(columns)])
    rank = draw(st.integers(0, 4))
    residuals = rng.normal(size=(count, rank)) @ rng.normal(size=(rank, 4)) * draw(scales)
    if draw(st.booleans()):
        residuals = residuals * np.array([draw(scales) / 1e9 for _ in range(4)])
    if draw(st.booleans()):  # each of another size
        residuals = residuals * 10.0 ** rng.uniform(-9.0, 0.0, (count, 1))
    distinct = draw(st.integers(1, count))
    of_place = rng.integers(0, distinct, count)
    of_error = rng.integers(0, draw(st.integers(1, count)), count)
    return phi[of_place], residuals[of_error]


NASTY_SHAPE = {"neighbors": 8, "bias_counts": 5.0, "dof_counts": 5.0, "prior_counts": 5.0}


@settings(max_examples=60, deadline=None, derandomize=True)
@given(data=nasty(), variant=st.sampled_from(VARIANTS))
def test_whatever_comes_in_what_comes_out_is_sound(
    data: tuple[FloatArray, FloatArray], variant: Any
) -> None:
    """Errors of 1e-9 to 1e9 px, of any rank, many of them the same, at places of 1e-9 to 1e9 or all
    in a line."""
    phi, residuals = data
    check(phi, residuals, variant=variant, weights=np.ones(phi.shape[1]), **NASTY_SHAPE)
