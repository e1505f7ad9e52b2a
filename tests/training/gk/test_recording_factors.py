"""The size of the errors of each recording, also where there are none."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.noise import GeneralizedKernel, StudentT
from probevo.noise.metric import Metric
from probevo.noise.student_t_numba import MIN_SIGMA_PX
from probevo.training.gk.error_samples import BLOCKS_A_DRIVE, ErrorSamples
from probevo.training.gk.recording_factors import fit_kernel_with_factors, fit_with_factors

COUNT = 500
SIGMAS = {"no noise": np.zeros(4), "rows alone": np.array([0.0, 0.1, 0.0, 0.1])}


def samples_of(*sigmas_px: FloatArray) -> ErrorSamples:
    """Return Gaussian errors of that σ of each coordinate, one drive each."""
    rng = np.random.default_rng(0)
    errors = np.concatenate([sigma_px * rng.normal(size=(COUNT, 4)) for sigma_px in sigmas_px])
    count = len(errors)
    return ErrorSamples(
        features=np.arange(count),
        phi=np.zeros((count, 1)),
        errors=errors,
        error_cov=np.zeros((count, 4, 4)),
        groups=BLOCKS_A_DRIVE * np.repeat(np.arange(len(sigmas_px)), COUNT),
        log_likelihood=np.zeros(count),
        profile=np.zeros((count, 4)),
        jitter_moments=np.zeros((0, 3, 3)),
        gaps_m=np.zeros(0),
    )


@pytest.mark.parametrize("sigma_px", SIGMAS.values(), ids=SIGMAS.keys())
def test_a_drive_without_noise_leaves_that_of_others_alone(sigma_px: FloatArray) -> None:
    """Its factor fell without end, and ν = 1 and σ of 990 px were learned of the others."""
    samples = samples_of(sigma_px, np.full(4, 0.2), np.full(4, 0.4)).with_noise()
    assert np.unique(samples.drives).tolist() == [1, 2]
    model = StudentT()
    factors = np.ones(3)
    for _ in range(5):
        factors = fit_with_factors(model, samples, factors)
    variances = factors * np.diagonal(model.scale_).mean() * model.dof_ / (model.dof_ - 2.0)
    np.testing.assert_allclose(np.sqrt(variances[1:]), [0.2, 0.4], rtol=0.05)
    assert model.dof_ > 20.0


def test_drives_that_are_all_without_noise_have_that_of_the_floor() -> None:
    samples = samples_of(np.zeros(4), np.zeros(4))
    assert samples.with_noise() is samples
    model = StudentT()
    factors = fit_with_factors(model, samples, np.ones(2))
    np.testing.assert_allclose(factors, 1.0)
    np.testing.assert_allclose(np.sqrt(np.diagonal(model.scale_)), MIN_SIGMA_PX, rtol=0.5)


KERNEL: dict[str, Any] = {
    "neighbors": 100,
    "reach": 100.0,
    "prior_counts": 1.0,
    "dof_counts": np.inf,
    "bias_counts": np.inf,
    "weights": np.ones(1),
    "centers": 200,
}
SIZES_PX = (0.1, 0.4)


def kernel_of(places: FloatArray, **changed: Any) -> tuple[GeneralizedKernel, FloatArray]:
    """Learn from two drives of ``SIZES_PX``.

    Args:
        places: where their features are in the prediction space, [2, COUNT].
        changed: arguments of the kernel other than ``KERNEL``.

    Returns:
        the kernel, and the factors of the drives.
    """
    samples = samples_of(*(np.full(4, sigma_px) for sigma_px in SIZES_PX))
    phi = places.reshape(-1, 1)
    # Several blocks of time in each drive, so that ν can be chosen
    block = np.arange(len(phi)) % COUNT * BLOCKS_A_DRIVE // COUNT
    samples = replace(samples, phi=phi, groups=samples.groups + block)
    model = GeneralizedKernel(**KERNEL | changed)
    factors = fit_kernel_with_factors(
        model, samples, 2, metric=Metric.fitted(phi), on_progress=lambda done, total: None
    )
    return model, factors


def sigma_px(model: GeneralizedKernel, places: FloatArray) -> FloatArray:
    """Return the σ that is predicted at places [n], without any factor, [n], px."""
    scale = model.predict(places[:, None]).scale
    size: FloatArray = np.exp(np.linalg.slogdet(scale)[1] / 8.0)
    return size


def test_a_kernel_does_not_take_sizes_that_nothing_predicts_for_heavy_tails() -> None:
    """ν was 1.5, and is that of Gaussian errors, 30 or more."""
    places = np.random.default_rng(1).normal(size=(2, COUNT))
    model, factors = kernel_of(places)
    assert model.search_["dof"]["chosen"] > 30.0
    found = np.sqrt(factors) * np.median(sigma_px(model, np.linspace(-1.0, 1.0, 50)))
    np.testing.assert_allclose(found, SIZES_PX, rtol=0.1)


def test_what_the_predictors_tell_of_the_sizes_is_left_to_the_kernel() -> None:
    """The drives are at different places: factors could explain all of it."""
    places = np.random.default_rng(1).normal(size=(2, COUNT)) + np.array([[-3.0], [3.0]])
    model, factors = kernel_of(places)
    assert model.search_["dof"]["chosen"] > 15.0
    np.testing.assert_allclose(factors, 1.0, rtol=0.1)
    np.testing.assert_allclose(sigma_px(model, np.array([-3.0, 3.0])), SIZES_PX, rtol=0.1)


@pytest.mark.parametrize(
    "case", [{"variant": "published", "prior_counts": 5.0}, {"bias_counts": 100.0}], ids=str
)
def test_there_are_no_factors_as_published_and_beside_a_bias(case: dict[str, Any]) -> None:
    _, factors = kernel_of(np.random.default_rng(1).normal(size=(2, COUNT)), **case)
    np.testing.assert_array_equal(factors, 1.0)
