"""How far a feature is trusted depends on how rare its residual is, not on how heavy the tails of
its noise are."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f as f_distribution

from probevo.arrays import FloatArray
from probevo.estimation.feature_weights import TRUSTED, USUAL_DOF, trust
from probevo.estimation.reprojection import ReprojectionSolution


def solution(squared: FloatArray, dof: float) -> ReprojectionSolution:
    """All that is looked at."""
    weight = dof / (dof + squared) if np.isfinite(dof) else np.ones_like(squared)
    return SimpleNamespace(squared=squared, weight=weight)  # type: ignore[return-value]


def test_of_the_usual_dof_it_is_the_robust_weight() -> None:
    squared = np.geomspace(1e-6, 1e6, 50)
    expected = USUAL_DOF / (USUAL_DOF + squared)
    np.testing.assert_allclose(
        trust(solution(squared, USUAL_DOF), np.full(50, USUAL_DOF)), expected, rtol=1e-12
    )


@pytest.mark.parametrize("dof", [1.0, 1.6, 3.0, 8.0, 30.0, 200.0])
def test_as_many_are_trusted_whatever_the_tails(dof: float) -> None:
    """The share of features, each from its own Student-t, that keep half of their weight: that at ν
    = 5."""
    ranks = (np.arange(20_000) + 0.5) / 20_000
    usual, own = (f_distribution.ppf(ranks, 4, nu) * 4.0 for nu in (USUAL_DOF, dof))
    expected = (USUAL_DOF / (USUAL_DOF + usual) >= TRUSTED).mean()
    assert (trust(solution(own, dof), np.full(len(own), dof)) >= TRUSTED).mean() == pytest.approx(
        expected, abs=2e-3
    )


@pytest.mark.parametrize("dof", [1.0, 1.6, 3.0, 8.0, 200.0])
def test_it_falls_from_one_to_nothing(dof: float) -> None:
    squared = np.concatenate([[0.0], np.geomspace(1e-3, 1e6, 200), [1e300]])
    found = trust(solution(squared, dof), np.full(len(squared), dof))
    assert found[0] == 1.0
    assert (np.diff(found) <= 0.0).all()
    assert found[-1] == pytest.approx(0.0, abs=1e-3)


def test_what_has_no_robust_weight_keeps_the_one_it_has() -> None:
    """Gaussian features, and such behind the camera."""
    squared = np.array([0.0, 1e6])
    np.testing.assert_array_equal(trust(solution(squared, np.inf), np.full(2, np.inf)), [1.0, 1.0])
    behind = SimpleNamespace(squared=np.array([1e4]), weight=np.zeros(1))
    np.testing.assert_array_equal(trust(behind, np.full(1, 2.0)), [0.0])  # type: ignore[arg-type]
