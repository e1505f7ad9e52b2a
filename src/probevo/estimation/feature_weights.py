"""How far a feature is trusted after a solve, whatever the tails of its noise."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.reprojection import ReprojectionSolution

OUTLIER_BELOW = 0.1
"""Weight below which a track is no longer followed."""
REFERENCE_DOF = 5.0
"""Degrees of freedom for which the two bounds hold."""
INLIER_FROM = 0.5
"""Weight from which a track counts as an inlier."""
GAUSSIAN_FROM = 1e6
"""Degrees of freedom from which a Student-t is a Gaussian."""
BISECTIONS = 50
"""They find a share of 0 to 1 to 10⁻¹⁵."""


def feature_weights(solution: ReprojectionSolution, dof: FloatArray, loss: str) -> FloatArray:
    """Return how far each feature is trusted under that loss, [N], 0 to 1.

    Args:
        solution: the solve.
        dof: degrees of freedom ν of each feature's noise, [N].
        loss: its name in the settings; one that is not the noise's own has no other measure than
            its robust weight.
    """
    return comparable_weights(solution, dof) if loss == "noise" else solution.weight


def comparable_weights(solution: ReprojectionSolution, dof: FloatArray) -> FloatArray:
    """Return weights that mean the same for any tails of the noise, [N], 0 to 1.

    The robust weight against a perfect feature's, y = ν/(ν + s), says how common a residual is only
    for one ν: half of all inliers have less than a third at ν = 1.6. So the weight is the y that a
    residual as rare would have at REFERENCE_DOF; rarer ones occur with probability
    y^(ν/2) (1 + ν (1 − y)/2), the F distribution's tail for d = 4. Gaussian noise, as that of
    ``fixed``, has no robust weight, and all features count in full.
    """
    robust = np.isfinite(dof) & (dof != REFERENCE_DOF) & (solution.weight > 0.0)
    nu = np.where(robust, dof, REFERENCE_DOF)
    tail = _tail_probability(nu / (nu + solution.squared), nu)
    comparable: FloatArray = np.where(
        robust, np.interp(tail, _REFERENCE_TAILS, _REFERENCE_WEIGHTS), solution.weight
    )
    return comparable


def scale_of_residuals(squared: FloatArray, dof: FloatArray) -> float:
    """Return how much larger the variance of N residuals is than their noise says: the median of
    their squared lengths s, [N], each over the median of its distribution.

    Args:
        squared: eᵀ Σ⁻¹ e of each residual, [N], N > 0.
        dof: degrees of freedom ν of each feature's noise, [N].
    """
    nu = np.minimum(dof, GAUSSIAN_FROM)
    low = np.zeros(len(nu))
    high = np.ones(len(nu))
    for _ in range(BISECTIONS):
        share = 0.5 * (low + high)
        is_rare = _tail_probability(share, nu) < 0.5
        low = np.where(is_rare, share, low)
        high = np.where(is_rare, high, share)
    # y = ν/(ν + s) solved for s. The median bears outliers up to half of the residuals.
    median = nu * (1.0 - share) / share
    return float(np.median(squared / median))


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
