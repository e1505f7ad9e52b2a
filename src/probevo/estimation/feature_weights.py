"""Weights of features after a solve, comparable whatever the tails of their noise."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.estimation.reprojection import SolvedFeatures
from probevo.measurements.robust_loss_numba import RESIDUAL_DIM
from probevo.measurements.stereo_numba import BEHIND

OUTLIER_BELOW = 0.1
"""Weight below which a track is dropped."""
REFERENCE_DOF = 5.0
"""Degrees of freedom to which all weights are converted."""
INLIER_FROM = 0.5
"""Weight from which a track counts as an inlier."""
MIN_INLIER_SHARE = 0.5
"""Share of inliers among the tracks used, below which the noise is larger than predicted."""
MIN_UNSELECTED_SHARE = 0.9
"""Share of the tracks of a step from which on those that were used are no selection. Of ten with
three mismatches, six are used that agree best on something; with two of them counted as usual, one
such motion in thirty was tens of σ wrong."""
CHANCE_SIGMAS = 2.0
"""Standard deviations by which the number of inliers may be smaller than expected."""
MIN_TAIL = 0.001
"""Tail probability of a residual below which the track does not agree with the motion."""
GAUSSIAN_FROM = 1e6
"""Degrees of freedom from which a Student-t is a Gaussian."""
MIN_DOF = 0.1
"""Where the table of medians begins; learned models have 1 and more."""
BISECTIONS = 50
"""Number of bisections of [0, 1] that reach 10⁻¹⁵."""


def feature_weights(features: SolvedFeatures, dof: FloatArray, loss: str) -> FloatArray:
    """Return the weight of each feature under a loss, [N], from 0 (outlier) to 1.

    Args:
        features: the N features of a solve.
        dof: degrees of freedom ν of each feature's noise, [N].
        loss: its name in the settings. The weights of ``noise`` are converted to REFERENCE_DOF;
            those of any other loss are its robust weights.
    """
    return comparable_weights(features, dof) if loss == "noise" else features.weight


def num_inliers(weights: FloatArray) -> int:
    """Return how many of N weights are those of inliers."""
    return int((weights >= INLIER_FROM).sum())


def num_agreeing(weights: FloatArray) -> int:
    """Return how many of N weights are those of tracks that are no outliers."""
    return int((weights >= OUTLIER_BELOW).sum())


def are_selected(weights: FloatArray, num_tracks: int) -> bool:
    """Return whether N tracks are a selection of those of a step, and not nearly all of them."""
    return len(weights) < MIN_UNSELECTED_SHARE * num_tracks


def are_usual(weights: FloatArray, *, num_tracks: int, min_tracks: int) -> bool:
    """Return whether as many of N tracks are inliers as their predicted noise lets expect.

    It does with half of them, or with fewer where chance explains that: of few tracks whose noise
    is as predicted, often less than half have an inlier's weight. Where others were rejected,
    these have been chosen since they agree, and chance explains nothing.

    Args:
        weights: weight of each, [N].
        num_tracks: number of tracks, with those that were rejected.
        min_tracks: how many determine a motion.
    """
    if are_selected(weights, num_tracks):
        return num_inliers(weights) >= max(min_tracks, MIN_INLIER_SHARE * len(weights))
    expected = INLIER_SHARE * len(weights)
    sigma = math.sqrt(expected * (1.0 - INLIER_SHARE))
    fewest = min(MIN_INLIER_SHARE * len(weights), expected - CHANCE_SIGMAS * sigma)
    return num_inliers(weights) >= fewest


def agree_with_noise(squared: FloatArray, dof: FloatArray, factor: float = 1.0) -> BoolArray:
    """Return which of N residuals their noise explains, [N].

    Args:
        squared: s = eᵀ Σ⁻¹ e of each, [N]; ``BEHIND`` for a point that has no residual.
        dof: degrees of freedom of each, [N].
        factor: by which the variances of the noise are multiplied.
    """
    explained = tail_probability_of(squared / factor, dof) > MIN_TAIL
    agree: BoolArray = (squared < BEHIND) & explained
    return agree


def comparable_weights(features: SolvedFeatures, dof: FloatArray) -> FloatArray:
    """Return weights that mean the same whatever the tails of the noise, [N], 0 to 1.

    The relative robust weight y = ν/(ν + s) of a residual depends on ν: at ν = 1.6, half of all
    inliers have less than a third. So the weight is the y of an equally rare residual at
    REFERENCE_DOF. Residuals with a smaller y have the probability y^(ν/2) (1 + ν (1 − y)/2), the
    tail of the F distribution for d = 4. Gaussian noise, such as that of ``fixed``, has no robust
    weight, so all its features have weight 1.
    """
    robust = np.isfinite(dof) & (dof != REFERENCE_DOF) & (features.weight > 0.0)
    nu = np.where(robust, dof, REFERENCE_DOF)
    # From s to its tail probability under ν, and from that to y under the reference.
    tail = _tail_probability(nu / (nu + features.mahalanobis_sq), nu)
    comparable: FloatArray = np.where(
        robust, np.interp(tail, _REFERENCE_TAILS, _REFERENCE_WEIGHTS), features.weight
    )
    return comparable


def scale_of_residuals(squared: FloatArray, dof: FloatArray, *, num_fitted: float = 0.0) -> float:
    """Return the factor by which the variance of N residuals exceeds that of their noise.

    It is the median of their squared lengths s, [N], each divided by the median of its
    distribution.

    Args:
        squared: eᵀ Σ⁻¹ e of each residual, [N], N > 0.
        dof: degrees of freedom ν of each feature's noise, [N].
        num_fitted: how many numbers were fitted to the residuals, such as the six of a motion: they
            are smaller than the errors by that share (Bessel's correction).
    """
    log_dof = np.log(np.minimum(dof, GAUSSIAN_FROM))
    medians = np.exp(np.interp(log_dof, _LOG_DOF, _LOG_MEDIANS))
    # The median tolerates up to half of the residuals as outliers.
    num_numbers = RESIDUAL_DIM * len(squared)
    correction = num_numbers / max(num_numbers - num_fitted, 1.0)
    return correction * float(np.median(squared / medians))


def tail_probability_of(squared: FloatArray, dof: FloatArray) -> FloatArray:
    """Return the probability of residuals of such squared lengths or longer, [N].

    Args:
        squared: eᵀ Σ⁻¹ e of each residual, [N].
        dof: degrees of freedom ν of each feature's noise, [N].
    """
    nu = np.minimum(dof, GAUSSIAN_FROM)
    return _tail_probability(nu / (nu + squared), nu)


def _tail_probability(share: FloatArray, dof: FloatArray | float) -> FloatArray:
    """Return the probability of a residual of s or more, from y = ν/(ν + s)."""
    probability: FloatArray = share ** (0.5 * dof) * (1.0 + 0.5 * dof * (1.0 - share))
    return probability


_REFERENCE_WEIGHTS = np.linspace(0.0, 1.0, 4001)
_REFERENCE_TAILS = _tail_probability(_REFERENCE_WEIGHTS, REFERENCE_DOF)
INLIER_SHARE = 1.0 - float(_tail_probability(np.array(INLIER_FROM), REFERENCE_DOF))
"""Share of inliers among tracks whose noise is as predicted, 0.6."""


def _median_squared(dof: FloatArray) -> FloatArray:
    """Return the median of the squared length of a residual with ν degrees of freedom, [K]."""
    # Find the median of y = ν/(ν + s) by bisection.
    low = np.zeros(len(dof))
    high = np.ones(len(dof))
    for _ in range(BISECTIONS):
        share = 0.5 * (low + high)
        is_rare = _tail_probability(share, dof) < 0.5
        low = np.where(is_rare, share, low)
        high = np.where(is_rare, high, share)
    median: FloatArray = dof * (1.0 - share) / share
    return median


_LOG_DOF = np.linspace(np.log(MIN_DOF), np.log(GAUSSIAN_FROM), 1001)
_LOG_MEDIANS = np.log(_median_squared(np.exp(_LOG_DOF)))
