"""The classical noise models, and the likelihood of residuals under the noise that they predict."""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
import pytest
from scipy.stats import multivariate_normal, multivariate_t

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.noise import Fixed, NoiseModel, StereoNoise, StudentT
from probevo.noise.base import RefersTo, predicted_noise
from probevo.noise.fixed import OBSERVATION_SIGMA_PX
from probevo.noise.student_t import DOF, SIGMA_PX

COUNT = 6


def random_noise(rng: np.random.Generator, dof: FloatArray) -> StereoNoise:
    """A different scale matrix and bias for each feature."""
    factor = rng.normal(size=(len(dof), 4, 4))
    return StereoNoise(factor @ factor.mT + 0.1 * np.eye(4), dof, rng.normal(size=(len(dof), 4)))


def residuals_around(rng: np.random.Generator, noise: StereoNoise) -> FloatArray:
    """From well inside to far out: up to some 30 standard deviations."""
    return noise.bias + np.geomspace(0.01, 100.0, len(noise.dof))[:, None] * rng.normal(
        size=noise.bias.shape
    )


@pytest.mark.parametrize("dof", [1.0, 3.0, 5.0, 30.0])
def test_log_likelihood_is_that_of_scipy_student_t(dof: float) -> None:
    rng = np.random.default_rng(0)
    noise = random_noise(rng, np.full(COUNT, dof))
    residuals = residuals_around(rng, noise)
    expected = [
        multivariate_t(b, S, df=dof).logpdf(e)
        for b, S, e in zip(noise.bias, noise.scale, residuals, strict=True)
    ]
    np.testing.assert_allclose(noise.log_likelihood(residuals), expected, rtol=1e-10)


@pytest.mark.parametrize("dof", [1e16, np.inf])
def test_log_likelihood_of_nearly_or_wholly_gaussian_noise_is_that_of_scipy_normal(
    dof: float,
) -> None:
    rng = np.random.default_rng(1)
    noise = random_noise(rng, np.full(COUNT, dof))
    residuals = residuals_around(rng, noise)
    expected = [
        multivariate_normal(b, S).logpdf(e)
        for b, S, e in zip(noise.bias, noise.scale, residuals, strict=True)
    ]
    np.testing.assert_allclose(noise.log_likelihood(residuals), expected, rtol=1e-10)


@pytest.mark.parametrize("refers_to", ["observation", "residual"])
def test_a_common_error_adds_its_covariance_in_both_frames(
    refers_to: RefersTo,
) -> None:
    rng = np.random.default_rng(5)
    noise = replace(random_noise(rng, np.full(COUNT, 5.0)), refers_to=refers_to)
    error_px = rng.normal(size=(COUNT, 4))
    found = noise.with_correlated_error(error_px)
    added = found.scale - noise.scale
    frames = 2.0 if refers_to == "residual" else 1.0
    for k in range(COUNT):
        np.testing.assert_allclose(
            added[k], frames * np.outer(error_px[k], error_px[k]), rtol=1e-12, atol=1e-14
        )
    assert found.prev_scale is None


def test_a_common_error_adds_to_both_observations_of_different_noise() -> None:
    rng = np.random.default_rng(6)
    dof = np.full(COUNT, 5.0)
    noise = replace(random_noise(rng, dof), refers_to="observation")
    noise = replace(noise, prev_scale=random_noise(rng, dof).scale)
    found = noise.with_correlated_error(rng.normal(size=(COUNT, 4)))
    assert noise.prev_scale is not None
    assert found.prev_scale is not None
    np.testing.assert_allclose(
        found.prev_scale - noise.prev_scale, found.scale - noise.scale, atol=1e-15
    )


def test_each_feature_has_its_own_dof() -> None:
    rng = np.random.default_rng(2)
    dof = np.array([3.0, np.inf, 5.0])
    mixed = random_noise(rng, dof)
    residuals = residuals_around(rng, mixed)
    separate = [
        StereoNoise(mixed.scale[[n]], dof[[n]], mixed.bias[[n]]).log_likelihood(residuals[[n]])[0]
        for n in range(3)
    ]
    np.testing.assert_allclose(mixed.log_likelihood(residuals), separate, rtol=1e-14)


def test_student_t_tends_to_the_normal() -> None:
    rng = np.random.default_rng(3)
    normal = random_noise(rng, np.full(COUNT, np.inf))
    residuals = normal.bias + rng.normal(size=(COUNT, 4))
    student = StereoNoise(normal.scale, np.full(COUNT, 1e7), normal.bias)
    np.testing.assert_allclose(
        student.log_likelihood(residuals), normal.log_likelihood(residuals), rtol=1e-5
    )


def test_scaled_noise_keeps_all_but_its_scale() -> None:
    noise = random_noise(np.random.default_rng(9), np.array([3.0, np.inf]))
    noise = replace(noise, out_of_domain=np.array([True, False]))
    scaled = noise.scaled(np.array([4.0, 0.25]))
    np.testing.assert_array_equal(scaled.scale, np.array([4.0, 0.25])[:, None, None] * noise.scale)
    for name in ("dof", "bias", "refers_to", "out_of_domain"):
        np.testing.assert_array_equal(getattr(scaled, name), getattr(noise, name))


def observation_noise() -> StereoNoise:
    """Of four features, with every field given and different for each."""
    rng = np.random.default_rng(10)
    noise = random_noise(rng, np.array([3.0, np.inf, 5.0, 7.0]))
    return replace(
        noise,
        refers_to="observation",
        out_of_domain=np.array([True, False, False, True]),
        time_correlated=np.array([0.1, 0.2, 0.3, 0.4]),
        prev_scale=random_noise(rng, noise.dof).scale,
    )


def test_a_subset_takes_the_rows_of_every_field() -> None:
    noise = observation_noise()
    chosen = np.array([2, 0])
    noise = replace(noise, jitter_cov=1e-8 * np.eye(3))
    subset = noise.subset(chosen)
    assert subset.refers_to == noise.refers_to
    assert subset.jitter_cov is noise.jitter_cov  # of all features alike
    for field in fields(StereoNoise):
        if field.name not in ("refers_to", "jitter_cov"):
            expected = getattr(noise, field.name)[chosen]
            np.testing.assert_array_equal(getattr(subset, field.name), expected)


def test_a_subset_has_no_field_that_the_noise_has_not() -> None:
    subset = random_noise(np.random.default_rng(11), np.full(3, 5.0)).subset(np.array([1]))
    assert subset.out_of_domain is None
    assert subset.time_correlated is None
    assert subset.prev_scale is None


def test_scaling_applies_to_both_observations_and_to_the_common_error() -> None:
    noise = observation_noise()
    factors = np.array([4.0, 0.25, 1.0, 2.0])
    scaled = noise.scaled(factors)
    assert noise.prev_scale is not None
    assert noise.time_correlated is not None
    np.testing.assert_array_equal(scaled.scale, factors[:, None, None] * noise.scale)
    np.testing.assert_array_equal(scaled.prev_scale, factors[:, None, None] * noise.prev_scale)
    np.testing.assert_array_equal(scaled.time_correlated, factors * noise.time_correlated)


def test_no_features_have_no_likelihood() -> None:
    assert StudentT().predict(np.zeros((0, 0))).log_likelihood(np.zeros((0, 4))).shape == (0,)


@pytest.mark.parametrize("count", [0, 1, 5])
@pytest.mark.parametrize(
    ("model", "dof", "sigma_px"),
    [
        (Fixed(), np.inf, OBSERVATION_SIGMA_PX),
        (StudentT(), DOF, SIGMA_PX),
        (StudentT(dof=3.0), 3.0, SIGMA_PX),
    ],
)
def test_classical_models_say_the_same_of_every_feature(
    model: NoiseModel, dof: float, sigma_px: float, count: int
) -> None:
    noise = model.predict(np.random.default_rng(4).normal(size=(count, 2)))
    expected = np.square(sigma_px) * np.eye(4)
    np.testing.assert_array_equal(noise.scale, np.broadcast_to(expected, (count, 4, 4)))
    np.testing.assert_array_equal(noise.dof, np.full(count, dof))
    np.testing.assert_array_equal(noise.bias, np.zeros((count, 4)))
    assert noise.refers_to == "observation"


@pytest.mark.parametrize(
    "make", [lambda scale: Fixed(covariance=scale), lambda scale: StudentT(scale=scale)]
)
def test_a_given_matrix_is_used(make: type[NoiseModel]) -> None:
    scale = np.diag([0.1, 0.2, 0.3, 0.4])
    np.testing.assert_array_equal(make(scale).predict(np.zeros((2, 0))).scale, [scale, scale])  # type: ignore[call-arg]


def test_predicting_leaves_the_model_as_it_was() -> None:
    """The same input gives the same noise, before and after other input."""
    model = StudentT()
    first = model.predict(np.zeros((3, 0)))
    model.predict(np.ones((50, 0)))
    again = model.predict(np.zeros((3, 0)))
    np.testing.assert_array_equal(first.scale, again.scale)
    np.testing.assert_array_equal(first.dof, again.dof)


INDEFINITE = np.diag([1.0, 1.0, -1.0, 1.0])


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: StudentT(refers_to="residuals"), "refers_to is 'residuals'"),  # type: ignore[arg-type]
        (lambda: StudentT(dof=-1.0), "its dof is -1"),
        (lambda: StudentT(dof=np.nan), "its dof is nan"),
        (lambda: StudentT(dof="5"), "its dof is '5'"),  # type: ignore[arg-type]
        (lambda: StudentT(np.inf, scale_is_relative=True), "its scale_is_relative is True where"),
        (lambda: StudentT(scale=np.full((4, 4), np.nan)), "its scale is"),
        (lambda: StudentT(scale=INDEFINITE), "its scale is"),
        (lambda: StudentT(scale=np.eye(3)), "its scale is"),
        (lambda: Fixed(-np.eye(4)), "its covariance is"),
        (lambda: Fixed(np.triu(np.ones((4, 4))) + np.eye(4)), "its covariance is"),
    ],
)
def test_values_of_no_distribution_are_refused(make: Callable[[], NoiseModel], said: str) -> None:
    with pytest.raises(InputError, match=said):
        make()


@dataclass(frozen=True)
class Own:
    """A noise model of one's own, with some fields of its noise replaced."""

    changes: dict[str, Any]
    columns: tuple[str, ...] = ()

    def predict(self, predictors: FloatArray) -> StereoNoise:
        return replace(StudentT().predict(predictors), **self.changes)

    def check_camera(self, camera: StereoCamera) -> None:
        """Accept any."""


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({}, ""),
        ({"refers_to": "observations"}, "refers_to is 'observations'"),
        ({"dof": np.array([3.0, 0.0])}, "a dof that is not positive"),
        ({"dof": np.array([3.0, np.nan])}, "a dof that is not positive"),
        ({"bias": np.full((2, 4), np.inf)}, "a bias that is not finite"),
        ({"scale": np.full((2, 4, 4), np.nan)}, "a scale that is not finite"),
        ({"scale": np.stack([np.eye(4), INDEFINITE])}, "a negative variance"),
    ],
)
def test_a_prediction_of_no_distribution_is_refused(changes: dict[str, Any], said: str) -> None:
    """Of ``refers_to``, one module took a typing error for a residual and the next for none."""
    model = Own(changes)
    if not said:
        assert len(predicted_noise(model, np.zeros((2, 0))).dof) == 2
        return
    with pytest.raises(InputError, match=said):
        predicted_noise(model, np.zeros((2, 0)))
