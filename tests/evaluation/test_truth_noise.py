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


def ratio_of(
    T_curr_prev: FloatArray, cov: FloatArray, T_curr_prev_true: FloatArray
) -> float | None:
    """The ratio of a run whose frames are all there, and whose steps are all solved."""
    return truth_noise_ratio(
        T_curr_prev,
        cov,
        T_curr_prev_true,
        duration_s=np.full(len(cov), 0.1),
        is_ok=np.ones(len(cov), np.bool_),
    )


def noisy(T: FloatArray, sigma: FloatArray, seed: int) -> FloatArray:
    return se3.exp(sigma * np.random.default_rng(seed).normal(size=(len(T), 6))) @ T


@pytest.mark.parametrize("ratio", [2.0, 20.0])
def test_noise_of_true_poses_is_measured_in_claimed_sigmas(ratio: float) -> None:
    """Poses of GPS have white noise; its steps have √2 as much. The estimate is exact."""
    true = smooth_motions()
    cov = np.tile(np.diag(SIGMA**2), (COUNT, 1, 1))
    poses = noisy(se3.inverse(se3.chain_motions(true)), ratio / np.sqrt(2.0) * SIGMA, 1)
    of_steps = poses[1:] @ se3.inverse(poses[:-1])
    assert ratio_of(true, cov, of_steps) == pytest.approx(ratio, rel=0.06)


@pytest.mark.parametrize("ratio", [2.0, 20.0])
def test_of_white_steps_it_is_a_lower_bound(ratio: float) -> None:
    """What the truth has beyond the noise of the estimate, which is as claimed: r² − 1."""
    true = smooth_motions()
    cov = np.tile(np.diag(SIGMA**2), (COUNT, 1, 1))
    found = ratio_of(noisy(true, SIGMA, 0), cov, noisy(true, ratio * SIGMA, 1))
    assert found == pytest.approx(np.sqrt(0.6 * (ratio**2 - 1.0)), rel=0.06)


def test_exact_truth_has_none() -> None:
    true = smooth_motions()
    cov = np.tile(np.diag(SIGMA**2), (COUNT, 1, 1))
    assert ratio_of(noisy(true, SIGMA, 0), cov, true) == 0.0
    overconfident = 1e-4 * cov
    assert ratio_of(noisy(true, SIGMA, 0), overconfident, true) == 0.0


def test_it_needs_ten_second_differences() -> None:
    true = smooth_motions()[:12]
    cov = np.tile(np.diag(SIGMA**2), (12, 1, 1))
    assert ratio_of(true, cov, true) == 0.0
    unknown = true.copy()
    unknown[5] = np.nan
    assert ratio_of(true, cov, unknown) is None


@pytest.mark.parametrize("ratio", [0.0, 3.0])
@pytest.mark.parametrize("spoiled", ["missing frames", "dead reckoning"])
def test_a_long_step_or_a_jump_of_the_estimate_tells_nothing(ratio: float, spoiled: str) -> None:
    """A step over fifteen missing frames, with an error of a millimetre, and a dead-reckoned one,
    with one of metres, would be the largest second differences of all."""
    true = smooth_motions()[:200]
    cov = np.tile(np.diag(SIGMA**2), (200, 1, 1))
    estimate = noisy(true, SIGMA, 0)
    seen = noisy(true, ratio * SIGMA, 1)
    duration_s = np.full(200, 0.1)
    is_ok = np.ones(200, np.bool_)
    expected = truth_noise_ratio(estimate, cov, seen, duration_s=duration_s, is_ok=is_ok)
    if spoiled == "missing frames":
        far = se3.exp(np.array([0.0, 0.0, -15.0, 0.0, 0.0, 0.0]))
        seen[100] = se3.exp(np.full(6, 1e-3)) @ far
        estimate[100] = far
        duration_s[100] = 1.6
    else:
        estimate[100] = se3.exp(np.full(6, 0.5)) @ estimate[100]
        is_ok[100] = False
    found = truth_noise_ratio(estimate, cov, seen, duration_s=duration_s, is_ok=is_ok)
    assert found == pytest.approx(expected, rel=0.05, abs=0.1)
