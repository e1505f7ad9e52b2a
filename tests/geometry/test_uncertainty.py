from __future__ import annotations

import numpy as np
import pytest

from geometry.samples import sample_poses
from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.geometry import se3, uncertainty


def random_covariance(rng: np.random.Generator, sigma_m: float, sigma_rad: float) -> FloatArray:
    """A covariance with all its correlations, [6, 6]."""
    root = rng.normal(size=(6, 6)) * np.repeat([sigma_m, sigma_rad], 3)[:, None] / np.sqrt(6.0)
    return root @ root.T


def left_errors(T: FloatArray, T_mean: FloatArray) -> FloatArray:
    return se3.log(T @ se3.inverse(T_mean))


def relative_error(actual: FloatArray, expected: FloatArray) -> float:
    return float(np.linalg.norm(actual - expected) / np.linalg.norm(expected))


def test_samples_have_the_given_covariance() -> None:
    """The left errors of the samples are Gaussian: their mean NEES lies in the 99.9 % interval of
    χ²(6)."""
    rng = np.random.default_rng(0)
    T_mean = se3.exp(rng.normal(size=6))
    cov = random_covariance(rng, 0.5, 0.1)
    T = sample_poses(T_mean, cov, 20_000, rng)
    assert relative_error(np.cov(left_errors(T, T_mean).T), cov) < 0.03
    nees = uncertainty.normalized_error_squared(T, T_mean, cov)
    low, high = chi2_interval(6, len(T))
    assert low < np.mean(nees) < high


def test_invert_is_exact() -> None:
    """The error of T⁻¹ is −Ad(T̄⁻¹) ξ for each sample, so the covariance of the samples transforms
    exactly."""
    rng = np.random.default_rng(5)
    T_b_a = se3.exp(rng.normal(size=6))
    samples = sample_poses(T_b_a, random_covariance(rng, 1.0, 0.3), 100, rng)
    T_a_b, cov_a_b = uncertainty.invert(T_b_a, np.cov(left_errors(samples, T_b_a).T))
    np.testing.assert_allclose(T_a_b @ T_b_a, np.eye(4), atol=1e-14)
    np.testing.assert_allclose(
        cov_a_b, np.cov(left_errors(se3.inverse(samples), T_a_b).T), atol=1e-12
    )


def test_inverting_twice_changes_nothing() -> None:
    rng = np.random.default_rng(6)
    T = se3.exp(rng.normal(size=(5, 6)))
    cov = np.stack([random_covariance(rng, 1.0, 0.3) for _ in range(5)])
    T_twice, cov_twice = uncertainty.invert(*uncertainty.invert(T, cov))
    np.testing.assert_allclose(T_twice, T, atol=1e-13)
    np.testing.assert_allclose(cov_twice, cov, atol=1e-13)


def monte_carlo_compound(
    T_b_a: FloatArray,
    cov_b_a: FloatArray,
    T_c_b: FloatArray,
    cov_c_b: FloatArray,
    rng: np.random.Generator,
) -> FloatArray:
    """E[ξ ξᵀ] of the left error of T_c_b T_b_a, from 100,000 samples, [6, 6]."""
    b_a = sample_poses(T_b_a, cov_b_a, 100_000, rng)
    c_b = sample_poses(T_c_b, cov_c_b, 100_000, rng)
    xi = left_errors(c_b @ b_a, T_c_b @ T_b_a)
    return xi.T @ xi / len(xi)


def test_compound_to_second_order_for_small_noise() -> None:
    rng = np.random.default_rng(7)
    T_b_a, T_c_b = se3.exp(rng.normal(size=(2, 6)))
    cov_b_a = random_covariance(rng, 0.05, 0.02)
    cov_c_b = random_covariance(rng, 0.02, 0.03)
    T_c_a, cov_c_a = uncertainty.compound_pair(T_b_a, cov_b_a, T_c_b, cov_c_b=cov_c_b)
    np.testing.assert_array_equal(T_c_a, T_c_b @ T_b_a)
    assert relative_error(cov_c_a, monte_carlo_compound(T_b_a, cov_b_a, T_c_b, cov_c_b, rng)) < 0.02


def test_compound_is_batched() -> None:
    rng = np.random.default_rng(9)
    T = se3.exp(rng.normal(size=(2, 5, 6)))
    cov = np.stack([random_covariance(rng, 1.0, 0.5) for _ in range(10)]).reshape(2, 5, 6, 6)
    _, together = uncertainty.compound_pair(T[0], cov[0], T[1], cov_c_b=cov[1])
    apart = [
        uncertainty.compound_pair(T[0, k], cov[0, k], T[1, k], cov_c_b=cov[1, k])[1]
        for k in range(5)
    ]
    np.testing.assert_allclose(together, apart, atol=1e-12)


def test_chain_against_monte_carlo() -> None:
    """30 noisy motions along a curve, 4,000 times: the mean NEES of every pose lies in the 99.9 %
    interval."""
    rng = np.random.default_rng(10)
    motions = se3.exp(
        np.array([0.05, 0.0, -1.0, 0.0, 0.05, 0.01]) + 0.02 * rng.normal(size=(30, 6))
    )
    covs = np.stack([random_covariance(rng, 0.02, 0.002) for _ in motions])
    T_world_cam, cov_world_cam = uncertainty.compound_chain(motions, covs)

    T = np.broadcast_to(np.eye(4), (4000, 4, 4))
    low, high = chi2_interval(6, len(T))
    for k, (T_curr_prev, cov) in enumerate(zip(motions, covs, strict=True)):
        T = T @ se3.inverse(sample_poses(T_curr_prev, cov, len(T), rng))
        errors = left_errors(T, T_world_cam[k])
        assert relative_error(errors.T @ errors / len(T), cov_world_cam[k]) < 0.1
        assert (
            low
            < np.mean(uncertainty.normalized_error_squared(T, T_world_cam[k], cov_world_cam[k]))
            < high
        )


def test_chain_starts_at_the_first_camera() -> None:
    """With the first motion as StereoOdometry yields it: the identity, without uncertainty."""
    motions = np.stack([np.eye(4), se3.exp(np.array([0.0, 0.0, -1.0, 0.0, 0.1, 0.0]))])
    covs = np.stack([np.zeros((6, 6)), np.diag([0.1, 0.1, 0.1, 0.01, 0.01, 0.01])])
    T_world_cam, cov_world_cam = uncertainty.compound_chain(motions, covs)
    np.testing.assert_array_equal(T_world_cam[0], np.eye(4))
    np.testing.assert_array_equal(cov_world_cam[0], np.zeros((6, 6)))
    np.testing.assert_allclose(T_world_cam[1], se3.inverse(motions[1]))
    np.testing.assert_allclose(cov_world_cam[1], uncertainty.invert(motions[1], covs[1])[1])


def test_normalized_error_of_a_known_error() -> None:
    xi = np.array([0.1, -0.2, 0.3, 0.01, 0.02, -0.03])
    T_estimated = se3.exp(np.arange(6.0))
    cov = np.diag([1.0, 2.0, 3.0, 0.1, 0.2, 0.3])
    nees = uncertainty.normalized_error_squared(se3.exp(xi) @ T_estimated, T_estimated, cov)
    assert nees == pytest.approx(np.sum(xi**2 / np.diag(cov)), rel=1e-12)


def test_normalized_error_does_not_depend_on_the_direction_of_the_pose() -> None:
    """T_b_a with its covariance and T_a_b with the inverted one are equally far off."""
    rng = np.random.default_rng(11)
    T_b_a = se3.exp(rng.normal(size=6))
    cov = random_covariance(rng, 1.0, 0.3)
    T_true = sample_poses(T_b_a, cov, 10, rng)
    T_a_b, cov_a_b = uncertainty.invert(T_b_a, cov)
    backward = uncertainty.normalized_error_squared(se3.inverse(T_true), T_a_b, cov_a_b)
    np.testing.assert_allclose(
        uncertainty.normalized_error_squared(T_true, T_b_a, cov), backward, rtol=1e-8
    )
