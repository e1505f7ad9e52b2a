"""Robust linear regression whose errors are correlated within frames, and from frame to frame.

Estimates are those of a Student-t likelihood. Their covariance is the sandwich A⁻¹ B A⁻¹ (Huber
1967), with B from the sums of the scores of each frame (Liang and Zeger 1986) and their
autocovariances over a few frames (Newey and West 1987), so that it holds whatever the errors of a
frame, and of its neighbours, have in common. A feature may keep its error for longer than that:
where the sums of the scores of each feature over all frames scatter more, these give the variance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import stdtr

from probevo.arrays import FloatArray, IntArray

DOF = 5.0
"""Degrees of freedom of the likelihood: between those of a Gaussian and of outliers."""
ITERATIONS = 30
_MEDIAN_OF_ABSOLUTE = 0.6745
"""Median of the absolute value of a standard normal variable."""


@dataclass(frozen=True)
class Regression:
    """Estimates of P coefficients."""

    values: FloatArray
    """[P]."""
    cov: FloatArray
    """Their covariance, [P, P]."""
    num_frames: int
    """Frames that it was estimated from."""
    cost: float
    """Negative logarithm of likelihood and prior, up to a constant."""

    @property
    def sigma(self) -> FloatArray:
        """Standard deviations, [P]."""
        return np.asarray(np.sqrt(np.diag(self.cov)))

    def p_value(self, value: float, sigma: float) -> float:
        """Return how probable a value at least as far from zero is, if the truth is zero."""
        return two_sided_p(value / sigma, self.num_frames - len(self.values))


def two_sided_p(z: float, dof: float) -> float:
    """Return the probability that Student's t with that many degrees of freedom exceeds ±z."""
    return float(2.0 * stdtr(max(dof, 1.0), -abs(z)))


def regress(
    design: FloatArray,
    target: FloatArray,
    frame: IntArray,
    *,
    prior_sigma: FloatArray,
    track: IntArray | None = None,
) -> Regression:
    """Estimate β of target = design β + noise.

    Args:
        design: [N, P].
        target: [N].
        frame: the frame of each row, [N], ascending.
        prior_sigma: standard deviations of the Gaussian prior of β around zero, [P]. They keep
            coefficients that nothing constrains finite.
        track: the feature of each row, [N], whose errors may be correlated for as long as it is
            seen; None if there are none.

    Returns:
        The estimates. What the data do not constrain has the prior's standard deviation.
    """
    prior = np.diag(prior_sigma**-2.0)
    beta: FloatArray = np.zeros(design.shape[1])
    scale = max(float(np.median(np.abs(target))) / _MEDIAN_OF_ABSOLUTE, 1e-12)
    # IRLS of a Student-t, by EM: weights, coefficients, scale.
    for _ in range(ITERATIONS):
        residual = target - design @ beta
        weight = (DOF + 1.0) / (DOF + (residual / scale) ** 2)
        information = (design * weight[:, None]).T @ design / scale**2 + prior
        gradient = design.T @ (weight * target) / scale**2
        beta = np.asarray(np.linalg.solve(information, gradient), dtype=np.float64)
        residual = target - design @ beta
        scale = max(float(np.sqrt(np.mean(weight * residual**2))), 1e-12)
    # Sandwich covariance A⁻¹ B A⁻¹ at the estimate.
    squared = (residual / scale) ** 2
    weight = (DOF + 1.0) / (DOF + squared)
    # A: derivative of the estimating equations; ψ' = (ν + 1)(ν − r²)/(ν + r²)² of ψ = w r.
    slope = (DOF + 1.0) * (DOF - squared) / (DOF + squared) ** 2
    bread = np.linalg.inv((design * slope[:, None]).T @ design / scale**2 + prior)
    scores = design * (weight * residual / scale**2)[:, None]
    # B: covariance of the sum of the scores, which are summed over each frame first, [K, P].
    of_frames = _sums(scores, frame)
    count = len(of_frames)
    # As many coefficients as were estimated are missing from the scatter of the scores.
    meat = _long_run_covariance(of_frames) * (count / max(count - len(beta), 1)) + prior
    cov = bread @ meat @ bread.T
    if track is not None:
        cov = _at_least(cov, bread @ (_covariance_of_sums(scores, track) + prior) @ bread.T)
    # −ln of N Student-t densities of this scale, and of the Gaussian prior
    cost = (
        0.5 * (DOF + 1.0) * float(np.log1p(squared / DOF).sum())
        + len(target) * float(np.log(scale))
        + 0.5 * float(beta @ prior @ beta)
    )
    return Regression(values=beta, cov=cov, num_frames=count, cost=cost)


def _sums(scores: FloatArray, frame: IntArray) -> FloatArray:
    """Add up the rows, [N, P], of each frame, [K, P]."""
    # Rows of a frame are consecutive: a frame begins where the number changes.
    starts = np.flatnonzero(np.r_[True, np.diff(frame) != 0])
    return np.asarray(np.add.reduceat(scores, starts, axis=0))


def _covariance_of_sums(scores: FloatArray, group: IntArray) -> FloatArray:
    """Return the covariance of the sum of scores, [N, P], that are correlated within groups, [N],
    in any order: [P, P]."""
    order = np.argsort(group, kind="stable")
    of_groups = _sums(scores[order], group[order])
    count = len(of_groups)
    return np.asarray(of_groups.T @ of_groups * (count / max(count - scores.shape[1], 1)))


def _at_least(cov: FloatArray, other: FloatArray) -> FloatArray:
    """Return a covariance, [P, P], whose variances are raised to those of another one; correlations
    stay."""
    factor = np.sqrt(np.maximum(np.diag(other) / np.diag(cov), 1.0))
    return np.asarray(cov * factor[:, None] * factor)


def _long_run_covariance(of_frames: FloatArray) -> FloatArray:
    """Add up the covariance and the autocovariances of the scores of K frames, [K, P], [P, P].

    Weights and number of lags are those of Newey and West (1987, 1994), which keep it positive
    definite.
    """
    count = len(of_frames)
    # Bartlett's weights 1 − k/(L + 1), up to L = 4 (K/100)^(2/9) lags
    lags = int(4.0 * (count / 100.0) ** (2.0 / 9.0))
    total: FloatArray = of_frames.T @ of_frames
    for lag in range(1, min(lags, count - 1) + 1):
        autocovariance = of_frames[lag:].T @ of_frames[:-lag]
        total = total + (1.0 - lag / (lags + 1.0)) * (autocovariance + autocovariance.T)
    return total
