"""The noise laws: their σ by place, and errors of the stated covariance and distribution."""

from typing import get_args

import numpy as np
import pytest
from scipy.stats import f, kstest

from probevo.arrays import FloatArray
from probevo_sim.noise_laws import DOF, PROFILES, NoiseLaw
from probevo_sim.point_config import LawName, PointConfig, PointNoise

DRAWS = 40_000
LAWS: tuple[LawName, ...] = get_args(LawName)
LOW = 0.5
HIGH = 2.0
RIGHT = 639.0
"""Last column of the default camera."""
BOTTOM = 479.0
"""Last row of the default camera."""
NEAREST_PX = 100.0
"""Disparity of its nearest landmarks."""


def law_of(law: LawName, *, correlation: float = 0.0, dof: float | None = None) -> NoiseLaw:
    noise = PointNoise(
        law=law, sigma_low_px=LOW, sigma_high_px=HIGH, correlation=correlation, dof=dof
    )
    return NoiseLaw.of(PointConfig(noise=noise))


def observation(u: float, v: float, disparity: float = 0.0) -> FloatArray:
    return np.array([[u, v, u - disparity, v]])


def moment_bound(covariance: FloatArray, dof: float) -> FloatArray:
    """Return five standard deviations of each entry of a sample covariance about a known mean.

    An entry is the mean of M products e_i e_j. For Gaussian errors Var(e_i e_j) = Σ_ii Σ_jj + Σ_ij²
    (Isserlis). A Student-t error is √(w) times a Gaussian one, with E[w] = 1 and E[w²] = κ = (ν −
    2)/(ν − 4), so that E[e_i² e_j²] = κ (Σ_ii Σ_jj + 2 Σ_ij²), and the variance is that less Σ_ij².
    """
    kappa = 1.0 if np.isinf(dof) else (dof - 2.0) / (dof - 4.0)
    variance = np.diagonal(covariance)
    product = kappa * (np.outer(variance, variance) + 2.0 * covariance**2) - covariance**2
    bound: FloatArray = 5.0 * np.sqrt(product / DRAWS)
    return bound


def test_every_name_has_a_law() -> None:
    assert set(PROFILES) == set(LAWS)


@pytest.mark.parametrize("correlation", [0.0, 0.8, -0.5])
@pytest.mark.parametrize("law", LAWS)
def test_sample_covariance_is_that_of_the_law(law: LawName, correlation: float) -> None:
    noise = law_of(law, correlation=correlation)
    observations = [observation(100.0, 50.0, 20.0), observation(600.0, 400.0, 80.0)]
    for seed, true_px in enumerate(observations):
        covariance = noise.covariance(true_px)[0]
        errors = noise.draw(np.repeat(true_px, DRAWS, axis=0), np.random.default_rng(seed))
        off = np.abs(errors.T @ errors / DRAWS - covariance)
        assert np.all(off < moment_bound(covariance, noise.dof))


@pytest.mark.parametrize("dof", [None, 8.0])
@pytest.mark.parametrize("law", LAWS)
def test_errors_are_zero_mean(law: LawName, dof: float | None) -> None:
    """The mean of M errors has the standard deviation σ/√M; five of them are allowed."""
    noise = law_of(law, dof=dof)
    true_px = np.repeat(observation(400.0, 100.0, 30.0), DRAWS, axis=0)
    mean = noise.draw(true_px, np.random.default_rng(0)).mean(axis=0)
    assert np.all(np.abs(mean) < 5.0 * noise.sigma(true_px[:1])[0] / np.sqrt(DRAWS))


@pytest.mark.parametrize("dof", [2.5, 5.0, 30.0])
def test_heavy_tails_are_student_t(dof: float) -> None:
    """With Σ the covariance, eᵀ Σ⁻¹ e ν/(ν − 2)/4 of a Student-t is F(4, ν): Kolmogorov-Smirnov at
    p = 1e-3."""
    noise = law_of("heavy-tailed", correlation=0.6, dof=dof)
    true_px = observation(200.0, 300.0, 10.0)
    errors = noise.draw(np.repeat(true_px, DRAWS, axis=0), np.random.default_rng(0))
    squared = np.sum(errors * np.linalg.solve(noise.covariance(true_px)[0], errors.T).T, axis=1)
    assert kstest(squared * dof / (dof - 2.0) / 4.0, f(4, dof).cdf).pvalue > 1e-3


def test_only_the_heavy_tailed_law_is_student_t_by_default() -> None:
    assert [law for law in LAWS if np.isfinite(law_of(law).dof)] == ["heavy-tailed"]
    assert law_of("heavy-tailed").dof == DOF["heavy-tailed"]
    assert law_of("row", dof=7.0).dof == law_of("heavy-tailed", dof=7.0).dof == 7.0


@pytest.mark.parametrize(
    ("law", "best", "worst"),
    [
        ("row", observation(300.0, BOTTOM), observation(300.0, 0.0)),
        ("column", observation(0.0, 100.0), observation(RIGHT, 100.0)),
        ("radius", observation(RIGHT / 2, BOTTOM / 2), observation(RIGHT, 0.0)),
        ("disparity", observation(300.0, 100.0, 0.0), observation(300.0, 100.0, NEAREST_PX)),
    ],
)
def test_sigma_goes_from_low_to_high(law: LawName, best: FloatArray, worst: FloatArray) -> None:
    noise = law_of(law)
    np.testing.assert_allclose(noise.sigma(best), LOW)
    np.testing.assert_allclose(noise.sigma(worst), HIGH)
    np.testing.assert_allclose(noise.sigma((best + worst) / 2), (LOW + HIGH) / 2)


@pytest.mark.parametrize("law", ["constant", "heavy-tailed"])
def test_sigma_without_a_profile_is_in_the_middle(law: LawName) -> None:
    pixels = np.vstack([observation(0.0, 0.0), observation(RIGHT, BOTTOM, NEAREST_PX)])
    np.testing.assert_allclose(law_of(law).sigma(pixels), (LOW + HIGH) / 2)


def test_each_image_has_its_own_sigma() -> None:
    """A near landmark lies further left in the right image, where the column law has a lower σ."""
    sigma = law_of("column").sigma(observation(RIGHT, 100.0, RIGHT / 2))
    np.testing.assert_allclose(sigma, [[HIGH, HIGH, (LOW + HIGH) / 2, (LOW + HIGH) / 2]])


@pytest.mark.parametrize("law", LAWS)
def test_beyond_the_image_it_is_as_at_the_edge(law: LawName) -> None:
    pixels = np.vstack([observation(-1e4, -1e4, -1e4), observation(1e4, 1e4, 1e4)])
    sigma = law_of(law).sigma(pixels)
    assert sigma.min() >= LOW
    assert sigma.max() <= HIGH


@pytest.mark.parametrize("correlation", [1.0, -1.0])
def test_full_correlation_moves_both_images_alike(correlation: float) -> None:
    true_px = np.repeat(observation(100.0, 100.0, 10.0), 100, axis=0)
    errors = law_of("row", correlation=correlation).draw(true_px, np.random.default_rng(0))
    np.testing.assert_allclose(errors[:, 2:], correlation * errors[:, :2], atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_no_observations(law: LawName) -> None:
    noise = law_of(law)
    nothing = np.zeros((0, 4))
    assert noise.covariance(nothing).shape == (0, 4, 4)
    assert noise.draw(nothing, np.random.default_rng(0)).shape == (0, 4)
