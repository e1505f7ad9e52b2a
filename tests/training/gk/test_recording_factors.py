"""The size of the errors of each recording, also where there are none."""

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.noise import StudentT
from probevo.noise.student_t_numba import MIN_SIGMA_PX
from probevo.training.gk.error_samples import BLOCKS_A_DRIVE, ErrorSamples
from probevo.training.gk.recording_factors import fit_with_factors

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
