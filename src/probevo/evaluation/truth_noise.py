"""Estimate of the truth's noise from frame to frame, relative to the claimed errors of steps."""

from __future__ import annotations

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.geometry import se3

MIN_STEPS = 10
"""Minimum number of second differences for an estimate."""
MAX_IRREGULARITY = 0.1
"""Largest deviation of a step's duration from the usual one, as a share of it."""
SECOND_DIFFERENCE_GAIN = 10.0
"""Variance of ξ_k−1 − 2 ξ_k + ξ_k+1 over that of ξ, for poses with white noise n, as of GPS.

With ξ_k = n_k+1 − n_k, which has twice the variance of n, it is n_k+2 − 3 n_k+1 + 3 n_k − n_k−1:
(1 + 9 + 9 + 1) / 2. If the motions themselves had white noise it would be 6, and the estimate is
then too small."""


def truth_noise_ratio(
    T_curr_prev: FloatArray,
    cov: FloatArray,
    T_curr_prev_true: FloatArray,
    *,
    duration_s: FloatArray,
    is_ok: BoolArray,
) -> float | None:
    """Estimate the noise of the true steps, in multiples of the claimed standard deviation.

    A vehicle moves smoothly, and its vibrations are in the truth and in the estimate. If the second
    differences of the true motions are larger than the estimates', the excess is therefore noise of
    the truth. Above a ratio of 1, the errors of steps come mostly from the truth, and the
    consistency of the covariance cannot be tested. Smoothed truth gives too small a ratio, which
    makes it a lower bound.

    Args:
        T_curr_prev: estimates, [K, 4, 4], m.
        cov: claimed covariances of their left perturbations, [K, 6, 6].
        T_curr_prev_true: truth, [K, 4, 4], m; NaN where unknown.
        duration_s: time of each step, [K]. A step over missing frames is a larger motion: as a
            second difference it would dwarf all others.
        is_ok: which steps are solved, [K]. A dead-reckoned one makes the estimate jump.

    Returns:
        The larger ratio of translation and rotation; 0 where the truth is at least as smooth as the
        estimate. None if too few successive steps are solved, as long as usual, and have a truth.
    """
    # ξ_{k−1} − 2 ξ_k + ξ_{k+1} of the motions, [K − 2, 6]
    truth_differences = np.diff(se3.log(T_curr_prev_true), n=2, axis=0)
    estimate_differences = np.diff(se3.log(T_curr_prev), n=2, axis=0)
    is_usual = np.abs(duration_s / np.median(duration_s) - 1.0) < MAX_IRREGULARITY
    counts = is_ok & is_usual & np.isfinite(T_curr_prev_true).all(axis=(1, 2))
    known = counts[:-2] & counts[1:-1] & counts[2:]
    if known.sum() < MIN_STEPS:
        return None
    ratios = []
    # Translation, then rotation: σ² of one axis times three in both numerator and denominator
    for part in (slice(0, 3), slice(3, 6)):
        excess = _mean_square(truth_differences[known, part]) - _mean_square(
            estimate_differences[known, part]
        )
        claimed = np.median(np.trace(cov[counts, part, part], axis1=1, axis2=2))
        ratios.append(np.sqrt(max(excess, 0.0) / SECOND_DIFFERENCE_GAIN / claimed))
    return float(max(ratios))


def _mean_square(vectors: FloatArray) -> float:
    """Return the mean of the squared lengths."""
    return float(np.mean(np.sum(vectors**2, axis=1)))
