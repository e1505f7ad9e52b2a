"""The noise of the truth against the claim: known noise comes back, exact truth has none."""

from __future__ import annotations

import numpy as np
import pytest

from probevo.arrays import FloatArray
from probevo.evaluation.truth_noise import truth_noise_ratio
from probevo.geometry import se3

SIGMA = np.array([2e-3, 2e-3, 2e-3, 1e-4, 1e-4, 1e-4])
COUNT = 4000


def smooth_motions() -> FloatArray:
    phase = np.linspace(0.0, 20.0, COUNT)[:, None]
    step = np.array([0.02, 0.0, -1.0, 0.001, 0.02, 0.0])
    return se3.exp(step * (1.0 + 0.3 * np.sin(phase)))


def noisy(T: FloatArray, sigma: FloatArray, seed: int) -> FloatArray:
    return se3.exp(sigma * np.random.default_rng(seed).normal(size=(len(T), 6))) @ T


@pytest.mark.parametrize("ratio", [2.0, 20.0])
def test_noise_of_true_poses_is_measured_in_claimed_sigmas(ratio: float) -> None:
    """Poses of GPS have white noise; its steps have √2 as much. The estimate is exact."""
    true = smooth_motions()
    cov = np.tile(np.diag(SIGMA**2), (COUNT, 1, 1))
    poses = noisy(se3.inverse(se3.chain_motions(true)), ratio / np.sqrt(2.0) * SIGMA, 1)
    of_steps = poses[1:] @ se3.inverse(poses[:-1])
    assert truth_noise_ratio(true, cov, of_steps) == pytest.approx(ratio, rel=0.06)


@pytest.mark.parametrize("ratio", [2.0, 20.0])
def test_of_white_steps_it_is_a_lower_bound(ratio: float) -> None:
    """What the truth has beyond the noise of the estimate, which is as claimed: r² − 1."""
    true = smooth_motions()
    cov = np.tile(np.diag(SIGMA**2), (COUNT, 1, 1))
    found = truth_noise_ratio(noisy(true, SIGMA, 0), cov, noisy(true, ratio * SIGMA, 1))
    assert found == pytest.approx(np.sqrt(0.6 * (ratio**2 - 1.0)), rel=0.06)


def test_exact_truth_has_none() -> None:
    true = smooth_motions()
    cov = np.tile(np.diag(SIGMA**2), (COUNT, 1, 1))
    assert truth_noise_ratio(noisy(true, SIGMA, 0), cov, true) == 0.0
    overconfident = 1e-4 * cov
    assert truth_noise_ratio(noisy(true, SIGMA, 0), overconfident, true) == 0.0


def test_it_needs_ten_second_differences() -> None:
    true = smooth_motions()[:12]
    cov = np.tile(np.diag(SIGMA**2), (12, 1, 1))
    assert truth_noise_ratio(true, cov, true) == 0.0
    unknown = true.copy()
    unknown[5] = np.nan
    assert truth_noise_ratio(true, cov, unknown) is None
