"""The weight of a feature depends on how rare its residual is, not on the tails of its noise."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from probevo.arrays import FloatArray
from probevo.estimation.feature_weights import (
    INLIER_FROM,
    REFERENCE_DOF,
    are_usual,
    comparable_weights,
    feature_weights,
    scale_of_residuals,
    tail_probability_of,
)
from probevo.estimation.reprojection import SolvedFeatures


def features(squared: FloatArray, dof: float) -> SolvedFeatures:
    """All that is looked at."""
    weight = dof / (dof + squared) if np.isfinite(dof) else np.ones_like(squared)
    return SimpleNamespace(mahalanobis_sq=squared, weight=weight)  # type: ignore[return-value]


def test_at_the_reference_dof_it_is_the_robust_weight() -> None:
    squared = np.geomspace(1e-6, 1e6, 50)
    expected = REFERENCE_DOF / (REFERENCE_DOF + squared)
    np.testing.assert_allclose(
        comparable_weights(features(squared, REFERENCE_DOF), np.full(50, REFERENCE_DOF)),
        expected,
        rtol=1e-12,
    )


@pytest.mark.parametrize("dof", [1.0, 1.6, 3.0, 8.0, 30.0, 200.0])
def test_as_many_are_inliers_whatever_the_tails(dof: float) -> None:
    """The share of features, each from its own Student-t, that keep half of their weight: that at ν
    = 5."""
    ranks = (np.arange(20_000) + 0.5) / 20_000
    reference, own = (f_distribution.ppf(ranks, 4, nu) * 4.0 for nu in (REFERENCE_DOF, dof))
    expected = (REFERENCE_DOF / (REFERENCE_DOF + reference) >= INLIER_FROM).mean()
    weights = comparable_weights(features(own, dof), np.full(len(own), dof))
    assert (weights >= INLIER_FROM).mean() == pytest.approx(expected, abs=2e-3)


@pytest.mark.parametrize("dof", [1.0, 1.6, 3.0, 8.0, 200.0])
def test_it_falls_from_one_to_nothing(dof: float) -> None:
    squared = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 200), [1e300]])
    found = comparable_weights(features(squared, dof), np.full(len(squared), dof))
    assert found[0] == 1.0
    assert (np.diff(found) <= 0.0).all()
    assert found[-1] == pytest.approx(0.0, abs=1e-3)


def test_what_has_no_robust_weight_keeps_the_one_it_has() -> None:
    """Gaussian features, and such behind the camera."""
    squared = np.array([0.0, 1e6])
    gaussian = comparable_weights(features(squared, np.inf), np.full(2, np.inf))
    np.testing.assert_array_equal(gaussian, [1.0, 1.0])
    behind = SimpleNamespace(mahalanobis_sq=np.array([1e4]), weight=np.zeros(1))
    np.testing.assert_array_equal(comparable_weights(behind, np.full(1, 2.0)), [0.0])


@pytest.mark.parametrize("loss", ["l2", "huber", "cauchy", "tukey"])
def test_under_another_loss_it_is_the_robust_weight_of_that_loss(loss: str) -> None:
    squared = np.geomspace(1e-3, 1e3, 20)
    found = features(squared, 3.0)
    dof = np.full(20, 3.0)
    np.testing.assert_array_equal(feature_weights(found, dof, loss), found.weight)
    comparable = comparable_weights(found, dof)
    np.testing.assert_array_equal(feature_weights(found, dof, "noise"), comparable)
    assert np.abs(comparable - found.weight).max() > 0.05


@pytest.mark.parametrize("dof", [0.5, 1.0, 2.5, 7.3, 100.0, 1e5])
def test_residuals_at_their_median_have_the_scale_one(dof: float) -> None:
    """The median of a squared length, d = 4 times that of F(4, ν)."""
    median = 4.0 * float(f_distribution.median(4, dof))
    assert scale_of_residuals(np.array([median]), np.array([dof])) == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize("dof", [1.0, 5.0, np.inf])
def test_the_scale_of_residuals_is_their_factor_over_the_noise(dof: float) -> None:
    """A third of outliers makes it larger, never smaller."""
    rng = np.random.default_rng(0)
    chi2 = rng.chisquare(4, 30_000)
    squared = chi2 if dof == np.inf else chi2 / (rng.chisquare(dof, 30_000) / dof)
    each = np.full(30_000, dof)
    assert scale_of_residuals(squared, each) == pytest.approx(1.0, rel=0.03)
    assert scale_of_residuals(25.0 * squared, each) == pytest.approx(25.0, rel=0.03)
    rare = tail_probability_of(squared, each) < 0.01
    assert rare.mean() == pytest.approx(0.01, rel=0.2)
    spoiled = squared.copy()
    spoiled[:10_000] = 1e4
    assert 1.0 < scale_of_residuals(spoiled, each) < 7.0


@pytest.mark.parametrize("count", [8, 20, 200])
def test_residuals_of_a_fitted_motion_are_scaled_by_the_numbers_that_were_fitted(
    count: int,
) -> None:
    """Projected off six directions, Gaussian residuals are shorter than the errors."""
    rng = np.random.default_rng(count)
    found = []
    for _ in range(400):
        basis, _ = np.linalg.qr(rng.normal(size=(4 * count, 6)))
        error = rng.normal(size=4 * count)
        residual = error - basis @ (basis.T @ error)
        squared = np.sum(residual.reshape(count, 4) ** 2, axis=1)
        found.append(scale_of_residuals(squared, np.full(count, np.inf), num_fitted=6))
    assert np.mean(found) == pytest.approx(1.0, abs=0.06)


@pytest.mark.parametrize("count", [7, 10, 20, 50, 200])
@pytest.mark.parametrize("dof", [1.6, 5.0, 100.0])
def test_tracks_whose_noise_is_as_predicted_are_usual_however_few(count: int, dof: float) -> None:
    """And four times the variance is found out, if they are enough to tell."""
    rng = np.random.default_rng(count)
    squared = 4.0 * rng.f(4.0, dof, size=(500, count))
    each = np.full(count, dof)

    def usual_share(factor: float, num_tracks: int) -> float:
        """Share of cases where tracks, selected from so many, seem to have the noise predicted."""
        weights = [comparable_weights(features(factor * s, dof), each) for s in squared]
        return float(
            np.mean([are_usual(one, num_tracks=num_tracks, min_tracks=6) for one in weights])
        )

    assert usual_share(1.0, count) > 0.94
    assert count < 50 or usual_share(4.0, count) < 0.2
    # Of those that others were rejected for, six have to be, as they determine the motion.
    assert count >= 20 or usual_share(1.0, 2 * count) < 0.85
