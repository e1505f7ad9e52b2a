import numpy as np
import pytest
from scipy.stats import binom

from intervals import chi2_interval
from probevo.arrays import FloatArray
from probevo.evaluation.consistency import (
    Consistency,
    drift_covariances,
    drift_errors,
    feature_coverage,
    motion_consistency,
)
from probevo.geometry import se3
from probevo.noise import StereoNoise

COV = np.diag([0.02, 0.01, 0.05, 0.002, 0.003, 0.001]) ** 2
COV[0, 4] = COV[4, 0] = 0.5 * 0.02 * 0.003


def noisy_motions(rng: np.random.Generator, count: int) -> tuple[FloatArray, FloatArray]:
    """True motions and estimates of them with T_true = Exp(ξ) T_est, ξ ~ N(0, COV)."""
    est = se3.exp(rng.normal([0, 0, 1, 0, 0.02, 0], 0.05, (count, 6)))
    return se3.exp(rng.multivariate_normal(np.zeros(6), COV, count)) @ est, est


def test_a_consistent_covariance_has_anees_6_and_nominal_coverage() -> None:
    true, est = noisy_motions(np.random.default_rng(0), 4000)
    consistency = motion_consistency(est, np.tile(COV, (4000, 1, 1)), true)
    assert consistency is not None
    low, high = chi2_interval(6, len(consistency.nees), 0.99)
    assert low < consistency.anees < high
    for percent, share in consistency.coverage.items():
        assert share == pytest.approx(int(percent) / 100.0, abs=0.025)


@pytest.mark.parametrize("factor", [0.25, 4.0])
def test_anees_scales_with_the_inverse_of_the_covariance(factor: float) -> None:
    true, est = noisy_motions(np.random.default_rng(1), 2000)
    consistency = motion_consistency(est, np.tile(factor * COV, (2000, 1, 1)), true)
    assert consistency is not None
    low, high = chi2_interval(6, len(consistency.nees))
    assert low < factor * consistency.anees < high


def test_only_steps_with_truth_count() -> None:
    true, est = noisy_motions(np.random.default_rng(2), 10)
    cov = np.tile(COV, (10, 1, 1))
    half = motion_consistency(est[:5], cov[:5], true[:5])
    true[5:] = np.nan
    assert half is not None
    np.testing.assert_array_equal(motion_consistency(est, cov, true).nees, half.nees)
    assert motion_consistency(est, cov, np.full_like(true, np.nan)) is None


def test_shares_inside_are_those_of_the_coverage_and_grow_with_the_ellipsoid() -> None:
    consistency = Consistency(np.random.default_rng(5).chisquare(6, 500))
    levels = np.array([0.0, 0.5, 0.9, 0.95, 0.99, 1.0])
    shares = consistency.share_inside(levels)
    assert shares[1:-1].tolist() == list(consistency.coverage.values())
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    assert (np.diff(shares) >= 0.0).all()


@pytest.mark.parametrize("count", [1, 2, 10, 463, 4540])
def test_interval_of_the_share_is_that_of_the_binomial(count: int) -> None:
    levels = np.arange(101) / 100.0
    low, high = Consistency(np.full(count, 6.0)).share_interval(levels)
    np.testing.assert_array_equal(low, binom.ppf(0.025, count, levels) / count)
    np.testing.assert_array_equal(high, binom.ppf(0.975, count, levels) / count)


def test_a_consistent_run_stays_in_the_interval_as_often_as_it_should() -> None:
    """At each of five levels, over 2000 runs of 300 steps: 95 %, or the little more that a whole
    number needs."""
    levels = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
    runs = np.random.default_rng(6).chisquare(6, (2000, 300))
    low, high = Consistency(runs[0]).share_interval(levels)
    shares = np.array([Consistency(nees).share_inside(levels) for nees in runs])
    often = ((low <= shares) & (shares <= high)).mean(axis=0)
    nominal = binom.cdf(np.round(300 * high), 300, levels) - binom.cdf(
        np.round(300 * low) - 1, 300, levels
    )
    assert (nominal >= 0.95).all()
    np.testing.assert_allclose(often, nominal, atol=3.5 * np.sqrt(0.05 * 0.95 / 2000))


def student_errors(rng: np.random.Generator, noise: StereoNoise) -> FloatArray:
    """Residuals drawn from the noise: Gaussian, over the root of χ²(ν)/ν."""
    count = len(noise.dof)
    finite = np.where(np.isinf(noise.dof), 1.0, noise.dof)
    mixture = np.where(np.isinf(noise.dof), 1.0, rng.chisquare(finite) / finite)
    white = rng.normal(size=(count, 4)) / np.sqrt(mixture)[:, None]
    return noise.bias + (np.linalg.cholesky(noise.scale) @ white[..., None])[..., 0]


@pytest.mark.parametrize("dof", [1.0, 3.0, 30.0, np.inf, None])
def test_features_drawn_from_their_noise_have_nominal_coverage(dof: float | None) -> None:
    """Also where each has a scale, a bias and a ν of its own (None), Gaussians among them."""
    rng = np.random.default_rng(7)
    count = 20_000
    factor = rng.normal(size=(count, 4, 4))
    each = rng.choice([0.7, 2.0, 8.0, np.inf], count) if dof is None else np.full(count, dof)
    noise = StereoNoise(factor @ factor.mT + 0.1 * np.eye(4), each, rng.normal(size=(count, 4)))
    coverage = feature_coverage(noise, student_errors(rng, noise))
    assert list(coverage) == ["50", "90", "95", "99"]
    for percent, share in coverage.items():
        nominal = int(percent) / 100.0
        assert share == pytest.approx(nominal, abs=3.5 * np.sqrt(nominal * (1.0 - nominal) / count))


def test_coverage_tells_heavy_tails_and_too_small_a_scale_from_the_truth() -> None:
    """Half the variance is overconfident; a model with ν = 3 of Gaussian errors is conservative in
    the tails."""
    rng = np.random.default_rng(8)
    count = 20_000
    scale = np.tile(np.eye(4), (count, 1, 1))
    bias = np.zeros((count, 4))
    errors = rng.normal(size=(count, 4))
    assert (
        feature_coverage(StereoNoise(0.5 * scale, np.full(count, np.inf), bias), errors)["95"] < 0.8
    )
    assert feature_coverage(StereoNoise(scale, np.full(count, 3.0), bias), errors)["95"] > 0.99


def uncorrelated(steps: int) -> FloatArray:
    """Cross-covariances of motions whose errors are independent of those before."""
    return np.zeros((steps, 6, 6))


def test_drift_of_many_runs_fits_its_covariance() -> None:
    """Average NEES of the pose after 20 noisy steps, over 300 runs, lies in the 99 % interval of
    χ²(6)/300."""
    rng = np.random.default_rng(3)
    nees = []
    for _ in range(300):
        true, est = noisy_motions(rng, 20)
        error = drift_errors(_trajectory(est), _trajectory(true))[-1]
        cov = drift_covariances(
            est, np.tile(COV, (20, 1, 1)), np.zeros((20, 6, 1)), path_cross_cov=uncorrelated(20)
        )[-1]
        nees.append(error @ np.linalg.solve(cov, error))
    consistency = Consistency(np.array(nees))
    low, high = chi2_interval(6, len(consistency.nees), 0.99)
    assert low < consistency.anees < high


def test_common_mode_errors_add_up() -> None:
    """Two unit-variance errors move each of 20 steps alike: average NEES at the end over 300 runs
    is that of χ²(6)."""
    rng = np.random.default_rng(4)
    nees = []
    for _ in range(300):
        true, est = noisy_motions(rng, 20)
        common_mode = 0.5 * np.sqrt(COV.diagonal()) * rng.normal(size=(2, 20, 6))
        columns = np.moveaxis(common_mode, 0, -1)
        true = se3.exp(columns @ rng.normal(size=2)) @ true
        error = drift_errors(_trajectory(est), _trajectory(true))[-1]
        cov = drift_covariances(
            est, COV + columns @ columns.mT, columns, path_cross_cov=uncorrelated(len(est))
        )[-1]
        nees.append(error @ np.linalg.solve(cov, error))
    low, high = chi2_interval(6, len(nees), 0.99)
    assert low < np.mean(nees) < high


def test_a_constant_common_mode_error_grows_with_the_length_and_not_with_its_root() -> None:
    columns = np.tile(np.array([0.0, 0.0, 0.01, 0.0, 0.0, 0.0])[:, None], (100, 1, 1))
    cov = 1e-12 * np.eye(6) + columns @ columns.mT
    cov = drift_covariances(
        np.tile(np.eye(4), (100, 1, 1)), cov, columns, path_cross_cov=uncorrelated(100)
    )
    assert np.sqrt(cov[-1, 2, 2]) == pytest.approx(1.0, rel=1e-3)


def test_a_step_whose_error_cancels_that_of_the_one_before_adds_nothing() -> None:
    """Independent errors of the poses: each step's is the new one less the old one."""
    cross_cov = np.tile(-COV, (20, 1, 1))
    cross_cov[0] = 0.0
    cov = np.tile(2.0 * COV, (20, 1, 1))
    cov[0] = COV
    drift = drift_covariances(
        np.tile(np.eye(4), (20, 1, 1)), cov, np.zeros((20, 6, 1)), path_cross_cov=cross_cov
    )
    np.testing.assert_allclose(drift[1:], np.tile(COV, (20, 1, 1)), atol=1e-12 * np.abs(COV).max())


def test_drift_starts_certain() -> None:
    none = np.zeros((3, 6, 1))
    three = drift_covariances(
        np.tile(np.eye(4), (3, 1, 1)), np.tile(COV, (3, 1, 1)), none, path_cross_cov=uncorrelated(3)
    )
    np.testing.assert_array_equal(three[0], 0)
    nowhere = drift_covariances(
        np.empty((0, 4, 4)),
        np.empty((0, 6, 6)),
        np.empty((0, 6, 1)),
        path_cross_cov=uncorrelated(0),
    )
    assert nowhere.shape == (1, 6, 6)


def _trajectory(T_curr_prev: FloatArray) -> FloatArray:
    poses = [np.eye(4)]
    for motion in T_curr_prev:
        poses.append(poses[-1] @ se3.inverse(motion))
    return np.array(poses)
