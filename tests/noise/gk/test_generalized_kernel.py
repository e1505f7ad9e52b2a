"""The generalized kernel on data whose noise is known: accuracy, tails, outliers and files."""

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from probevo.arrays import AnyArray, FloatArray
from probevo.errors import InputError
from probevo.evaluation.consistency import feature_coverage
from probevo.noise import GeneralizedKernel, StereoNoise, StudentT
from probevo.noise.gk import folds
from probevo.noise.metric import Metric
from probevo.noise.model_file import ModelFile, write_model_file
from probevo.noise.model_io import load_model, save_model
from probevo.noise.named import noise_model
from worlds import CAMERA

TRAINING = {
    "settings": {"seed": 0},
    "recordings": [{"name": "06", "frames": 1101, "sha256": "0" * 64}],
}
GIVEN: dict[str, Any] = {
    "neighbors": 60,
    "prior_counts": 8.0,
    "dof_counts": 30.0,
    "bias_counts": np.inf,
}
"""Nothing to be searched for but the weights."""


@pytest.fixture(autouse=True)
def fewer_held_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare hyperparameters by two thirds of the errors, in two thirds of the time."""
    monkeypatch.setattr(folds, "MAX_HELD_OUT", 400)


def covariance_at(places: FloatArray) -> FloatArray:
    """σ from 0.2 to 1.8 px along the first column; correlation of left and right from −0.7 to 0.7
    along the second."""
    sigma = np.exp(1.1 * np.sin(1.2 * places[:, 0]) - 0.5)
    correlation = 0.7 * np.sin(places[:, 1])
    covariance = np.tile(np.eye(4), (len(places), 1, 1))
    covariance[:, 0, 2] = covariance[:, 2, 0] = covariance[:, 1, 3] = covariance[:, 3, 1] = (
        correlation
    )
    return sigma[:, None, None] ** 2 * covariance


def samples(count: int, seed: int = 0, *, dof: float = np.inf) -> tuple[FloatArray, FloatArray]:
    """Places in the square of side 3, and errors of scale ``covariance_at``."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(-1.5, 1.5, (count, 2))
    errors = np.einsum(
        "nij,nj->ni", np.linalg.cholesky(covariance_at(places)), rng.normal(size=(count, 4))
    )
    if np.isfinite(dof):
        errors /= np.sqrt(rng.chisquare(dof, count) / dof)[:, None]
    return places, errors


INSIDE = np.random.default_rng(99).uniform(-1.3, 1.3, (300, 2))
"""Queries, not at the edge."""


def covariance_of(noise: StereoNoise) -> FloatArray:
    return (noise.dof / (noise.dof - 2.0))[:, None, None] * noise.scale


def relative_error(noise: StereoNoise) -> float:
    """Mean over places, of the Frobenius norm."""
    true = covariance_at(INSIDE)
    return float(
        np.mean(
            np.linalg.norm(covariance_of(noise) - true, axis=(1, 2))
            / np.linalg.norm(true, axis=(1, 2))
        )
    )


def error_after(count: int) -> float:
    """With K as N^(2/3), which is best in two columns."""
    given = GIVEN | {"weights": np.ones(2), "dof_counts": 1.0, "prior_counts": 4.0}
    model = GeneralizedKernel(**given | {"neighbors": round(0.5 * count ** (2.0 / 3.0))})
    return relative_error(model.fit(*samples(count)).predict(INSIDE))


def trained(count: int = 1000, **options: Any) -> GeneralizedKernel:
    """Two columns, of which the second is undefined for every tenth sample."""
    phi, errors = samples(count)
    phi[::10, 1] = np.nan
    metric = Metric.fitted(phi, ("place", "blur"), (False, True))
    given = GIVEN | {"weights": np.ones(2), "camera": CAMERA, "training": TRAINING, "centers": 300}
    return GeneralizedKernel(**given | options).fit(phi, errors, metric=metric)


@cache
def searched(dof: float) -> GeneralizedKernel:
    """All but a bias, from errors of these tails."""
    return GeneralizedKernel(bias_counts=np.inf).fit(*samples(4000, dof=dof))


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize("num_undefined", [0, 5])
def test_what_training_has_hardly_seen_undefined_is_out_of_domain(
    num_undefined: int, exact: bool
) -> None:
    """It has the noise of what is unlike all training data, not that of the lowest values."""
    phi, errors = samples(1000)
    phi[:num_undefined, 1] = np.nan
    metric = Metric.fitted(phi, ("place", "blur"), (False, True))
    model = GeneralizedKernel(**GIVEN | {"weights": np.ones(2)}).fit(phi, errors, metric=metric)
    query = np.array([phi[500], [phi[500, 0], np.nan]])
    noise = model.predict_exact(query) if exact else model.predict(query)
    np.testing.assert_array_equal(noise.out_of_domain, [False, True])
    prior = model.posterior_.prior if exact else model.prior_
    np.testing.assert_allclose(noise.scale[1], prior.scale[0])
    assert noise.dof[1] == pytest.approx(prior.dof[0])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "model.safetensors"


def test_the_covariances_come_out_as_they_went_in() -> None:
    """Within a tenth of their norm from 100,000 samples; more than twice that from a thousand."""
    few = error_after(1000)
    many = error_after(100_000)
    assert many < 0.1
    assert few > 2.0 * many


def test_the_covariances_are_found_where_the_static_ones_are_far_off() -> None:
    """From 10,000 samples: within a fifth, where one scale for all is off by about its size."""
    assert error_after(10_000) < 0.2
    static = StudentT().fit(*samples(10_000)).scale_
    true = covariance_at(INSIDE)
    assert (
        np.mean(np.linalg.norm(static - true, axis=(1, 2)) / np.linalg.norm(true, axis=(1, 2)))
        > 0.8
    )


@pytest.mark.parametrize("variant", ["robust", "published"])
def test_errors_held_out_are_likelier_than_under_one_noise_for_all(variant: Any) -> None:
    """By more than half a nat each, of 4 numbers whose σ ranges over a factor of 9."""
    model = GeneralizedKernel(variant).fit(*samples(1000))
    places, errors = samples(2000, seed=1)
    static = StudentT().fit(*samples(1000))
    gain = model.predict(places).log_likelihood(errors) - static.predict(places).log_likelihood(
        errors
    )
    assert gain.mean() > 0.5


def test_heavy_tails_are_learned_where_they_are() -> None:
    """Errors of 3 dof to the left, Gaussian ones of the same scale to the right."""
    rng = np.random.default_rng(6)
    places = rng.uniform(-1.0, 1.0, (6000, 1))
    errors = rng.normal(size=(6000, 4))
    heavy = places[:, 0] < 0.0
    errors[heavy] /= np.sqrt(rng.chisquare(3.0, int(heavy.sum())) / 3.0)[:, None]
    given = GIVEN | {"neighbors": 1500, "dof_counts": 5.0, "weights": np.ones(1), "centers": 100}
    dof = GeneralizedKernel(**given).fit(places, errors).predict(np.array([[-0.6], [0.6]])).dof
    assert dof[0] == pytest.approx(3.0, rel=0.25)
    assert dof[1] > 20.0


@pytest.mark.parametrize(("dof", "least", "most"), [(np.inf, 60.0, 200.0), (5.0, 4.0, 6.5)])
def test_tails_are_those_within_a_place_not_of_the_mixture_of_places(
    dof: float, least: float, most: float
) -> None:
    places, errors = samples(6000, dof=dof)
    assert StudentT().fit(places, errors).dof_ < 3.0
    noise = searched(dof).predict(INSIDE)
    assert least < np.median(noise.dof) < most


@pytest.mark.parametrize("dof", [np.inf, 5.0])
def test_regions_hold_as_many_errors_held_out_as_they_should(dof: float) -> None:
    model = searched(dof)
    places, errors = samples(20_000, seed=1, dof=dof)
    for percent, share in feature_coverage(model.predict(places), errors).items():
        assert share == pytest.approx(float(percent) / 100.0, abs=0.02)


def test_a_bias_is_learned_where_it_is() -> None:
    """Half a pixel, of opposite sign on both sides; none if its prior is held at zero."""
    places, errors = samples(4000)
    errors = 0.2 * errors + 0.5 * np.sign(places[:, :1])
    queries = np.array([[-1.0, 0.0], [1.0, 0.0]])
    model = GeneralizedKernel(**GIVEN | {"bias_counts": 1.0}).fit(places, errors)
    np.testing.assert_allclose(model.predict(queries).bias, [[-0.5] * 4, [0.5] * 4], atol=0.15)
    np.testing.assert_array_equal(
        GeneralizedKernel(**GIVEN).fit(places, errors).predict(queries).bias, 0.0
    )


def test_a_column_that_says_nothing_gets_no_weight() -> None:
    """σ depends on the first of four columns only."""
    rng = np.random.default_rng(2)
    places = rng.normal(size=(3000, 4))
    errors = np.exp(places[:, :1]) * rng.normal(size=(3000, 4))
    weights = GeneralizedKernel(**GIVEN).fit(places, errors).weights_
    assert weights[0] > 0.0
    np.testing.assert_array_equal(weights[1:], np.zeros(3))


def test_where_no_column_says_anything_one_is_left() -> None:
    """Of six. With all of them, distances would be noise."""
    rng = np.random.default_rng(3)
    model = GeneralizedKernel(**GIVEN).fit(rng.normal(size=(300, 6)), rng.standard_t(4.0, (300, 4)))
    assert np.count_nonzero(model.weights_) == 1
    assert len(model.search_["weights"]["candidates"]) == 1


def contaminated(share: float) -> tuple[FloatArray, FloatArray]:
    """Some errors are gross: of 30 px."""
    places, errors = samples(6000, seed=3)
    rng = np.random.default_rng(4)
    gross = rng.random(len(errors)) < share
    errors[gross] += 30.0 * rng.normal(size=(int(gross.sum()), 4))
    return places, errors


def median_ratio(variant: Any, share: float) -> float:
    """Of the scale found, per axis, over the true covariance of what is not gross: σ², in the
    median of places."""
    given = GIVEN | {"weights": np.ones(2), "reach": 0.4 if variant == "published" else None}
    noise = GeneralizedKernel(variant, **given).fit(*contaminated(share)).predict(INSIDE)
    true = covariance_at(INSIDE)
    return float(
        np.median(np.trace(noise.scale, axis1=1, axis2=2) / np.trace(true, axis1=1, axis2=2))
    )


def test_gross_errors_hardly_change_the_robust_scale() -> None:
    """5 % of them, thirty times σ: it stays within a factor of 2."""
    assert 0.5 < median_ratio("robust", 0.05) < 2.0


def test_gross_errors_inflate_the_published_scale() -> None:
    """By a factor of more than ten, where without them it is right within a factor of 2: this is
    why ours is robust."""
    assert 0.5 < median_ratio("published", 0.0) < 2.0
    assert median_ratio("published", 0.05) > 10.0


@pytest.mark.parametrize("variant", ["robust", "published"])
def test_far_from_the_data_it_is_out_of_domain_and_the_prior(variant: Any) -> None:
    """Wider than where σ is low; and the farther, the nearer to the prior."""
    model = GeneralizedKernel(variant, **GIVEN | {"weights": np.ones(2), "reach": 0.4}).fit(
        *samples(3000)
    )
    line = np.column_stack([np.linspace(-1.4, -20.0, 100), np.zeros(100)])
    noise = model.predict(line)
    assert noise.out_of_domain is not None
    assert not noise.out_of_domain[0]
    assert noise.out_of_domain[-1]
    assert (np.diff(noise.out_of_domain.astype(int)) >= 0).all()
    beyond = noise.scale[noise.out_of_domain]
    np.testing.assert_allclose(
        beyond, np.repeat(model.prior_.scale, len(beyond), axis=0), rtol=1e-4, atol=1e-5
    )
    assert noise.scale[-1, 0, 0] > 2.0 * noise.scale[0, 0, 0]


def test_amidst_the_data_next_to_nothing_is_out_of_domain() -> None:
    """With a reach that was chosen."""
    noise = GeneralizedKernel(**GIVEN).fit(*samples(3000)).predict(INSIDE)
    assert noise.out_of_domain is not None
    assert noise.out_of_domain.mean() < 0.01


def test_predicting_from_the_centers_is_nearly_as_from_all_samples() -> None:
    model = GeneralizedKernel(**GIVEN).fit(*samples(8000))
    one = model.predict(INSIDE)
    other = model.predict_exact(INSIDE)
    ratio = np.log(np.trace(one.scale, axis1=1, axis2=2) / np.trace(other.scale, axis1=1, axis2=2))
    assert np.abs(np.mean(ratio)) < 0.03
    assert np.std(ratio) < 0.2


def test_each_feature_is_predicted_on_its_own() -> None:
    model = trained()
    together = model.predict(INSIDE[:20])
    for n in range(20):
        np.testing.assert_array_equal(model.predict(INSIDE[[n]]).scale[0], together.scale[n])


def test_groups_are_left_out_together() -> None:
    """Of 40 groups with a σ of its own each, which the first column identifies: useless for other
    groups; held out singly, samples are predicted from their own group."""
    rng = np.random.default_rng(5)
    groups = np.repeat(np.arange(40), 50)
    places = np.column_stack(
        [rng.permutation(40)[groups] + 0.01 * rng.normal(size=2000), rng.normal(size=2000)]
    )
    errors = np.exp(rng.normal(size=40))[groups, None] * rng.normal(size=(2000, 4))
    apart, together = (
        GeneralizedKernel(neighbors=30).fit(places, errors, g).search_["weights"]["gains"]
        for g in (np.arange(2000) % 50, groups)
    )
    assert max(apart, default=0.0) > 0.3
    assert max(together, default=0.0) < 0.1


def test_columns_without_weight_may_be_left_out() -> None:
    """The same predictions, without having to look at them; one that contributes may not."""
    model = trained(weights=np.array([2.0, 0.0]))
    kept = model.subset(np.array([0]))
    assert kept.columns == ("place",)
    np.testing.assert_array_equal(kept.predict(INSIDE[:, :1]).scale, model.predict(INSIDE).scale)
    with pytest.raises(ValueError, match="contributes"):
        model.subset(np.array([1]))


def test_a_model_of_a_file_can_be_made_smaller_as_well() -> None:
    """It has neither samples nor the weights that were given."""
    model = trained(weights=np.array([2.0, 0.0]))
    loaded = GeneralizedKernel.from_file(model.to_file())
    expected = model.predict(INSIDE).scale
    np.testing.assert_array_equal(loaded.without_samples().predict(INSIDE).scale, expected)
    kept = loaded.subset(np.array([0]))
    np.testing.assert_array_equal(kept.predict(INSIDE[:, :1]).scale, expected)


def test_given_hyperparameters_are_not_searched_for() -> None:
    model = trained()
    assert model.search_.keys() == {"dof"}  # which is estimated at each EM iteration
    assert (model.shape_.neighbors, model.shape_.prior_counts, model.shape_.dof_counts) == (
        60,
        8.0,
        30.0,
    )
    assert set(GeneralizedKernel().fit(*samples(500)).search_) == {
        "weights",
        "dof",
        "neighbors",
        "bias_counts",
        "prior_counts",
        "dof_counts",
    }


def test_progress_goes_up_to_its_total() -> None:
    shown: list[tuple[int, int]] = []
    GeneralizedKernel().fit(
        *samples(500), on_progress=lambda done, total: shown.append((done, total))
    )
    assert len({total for _, total in shown}) == 1
    assert [done for done, _ in shown] == sorted(done for done, _ in shown)
    assert shown[-1][0] <= shown[-1][1]


@pytest.mark.parametrize("variant", ["robust", "published"])
def test_the_same_data_give_the_same_bytes(path: Path, variant: Any) -> None:
    """Although folds are evaluated in parallel."""
    contents = set()
    for _ in range(2):
        save_model(GeneralizedKernel(variant).fit(*samples(600)), path)
        contents.add(path.read_bytes())
    assert len(contents) == 1


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"variant": "published", "reach": 0.5},
        {"camera": None},
        {"training": None},
        {"refers_to": "observation"},
        {"bias_counts": 5.0},
        {"dof_counts": np.inf},
        {"centers": 1},
        {"weights": np.array([0.0, 2.0])},
    ],
)
def test_a_model_comes_back_as_it_was(path: Path, options: dict[str, Any]) -> None:
    """It predicts the same bytes, and gives the same file again."""
    model = trained(**options)
    save_model(model, path)
    back = load_model(path)
    assert isinstance(back, GeneralizedKernel)
    queries = np.concatenate([INSIDE, [[0.3, np.nan], [50.0, 0.0]]])
    one = model.predict(queries)
    other = back.predict(queries)
    for name in ("scale", "dof", "bias", "out_of_domain"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes()
    for name in ("variant", "refers_to", "camera", "training", "columns", "num_samples_"):
        assert getattr(back, name) == getattr(model, name)
    assert one.refers_to == other.refers_to == model.refers_to
    again = path.with_name("again.safetensors")
    save_model(back, again)
    assert again.read_bytes() == path.read_bytes()


def test_it_is_found_by_its_path(path: Path) -> None:
    save_model(trained(), path)
    model = noise_model(str(path))
    assert isinstance(model, GeneralizedKernel)
    assert model.columns == ("place", "blur")


def test_a_searched_model_can_be_written(path: Path) -> None:
    """What was searched holds infinities and numbers of NumPy, which JSON has none of."""
    model = GeneralizedKernel().fit(*samples(500))
    model.training = {"searches": model.search_}
    save_model(model, path)
    assert load_model(path).training == model.training


def refuse(path: Path, model: ModelFile) -> None:
    """Its checksum is right, its content is not."""
    write_model_file(path, model)
    with pytest.raises(InputError) as caught:
        load_model(path)
    assert caught.value.where == str(path)
    assert "not a complete gk model" in str(caught.value)
    assert "Train it again." in str(caught.value)


@cache
def file() -> ModelFile:
    return trained(200, centers=30).to_file()


def with_array(name: str, array: AnyArray) -> ModelFile:
    return ModelFile("gk", {**file().arrays, name: array}, file().facts)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("spread", 0.0),
        ("spread", -1.0),
        ("weight", -1.0),
        ("weight", 1e30),
        ("prior_dof", 0.0),
        ("prior_dof", -5.0),
    ],
)
def test_a_number_out_of_its_bounds_is_refused(path: Path, name: str, value: float) -> None:
    array = np.asarray(file().arrays[name]).copy()
    array[0] = value
    refuse(path, with_array(name, array))


@pytest.mark.parametrize(
    ("column", "value"), [(4, 1e3), (6, -1e3), (9, 1e30), (13, 200.0), (14, 800.0)]
)
def test_a_center_that_no_fit_gives_is_refused(path: Path, column: int, value: float) -> None:
    """Logarithms whose exponentials are none."""
    values = np.asarray(file().arrays["values"]).copy()
    values[3, column] = value
    refuse(path, with_array("values", values))


def test_a_prior_that_is_no_covariance_is_refused(path: Path) -> None:
    refuse(path, with_array("prior_scale", -np.asarray(file().arrays["prior_scale"])))
    refuse(path, with_array("prior_scale", np.zeros((1, 4, 4))))
