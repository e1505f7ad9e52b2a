"""The share of a disparity's error that is correlated from frame to frame, by maximum likelihood.

An error of the disparity that is the same in both frames, κ times as large as the one that is new
in each, σ, adds κ² m mᵀ to the scale Σ of a residual e, with m = σ l
(``measurements.stereo_numba.propagate_noise``). By the rank-one updates of inverse and determinant,

    s(κ) = s − κ² a²/(1 + κ² b),    ln|Σ(κ)| = ln|Σ| + ln(1 + κ² b),

with s = eᵀ Σ⁻¹ e, a = mᵀ Σ⁻¹ e and b = mᵀ Σ⁻¹ m. These three numbers a feature, and its ν, give
the likelihood for every κ. One κ for all features of a kernel, whose σ differ, was 0.02 to 0.07
nats a feature better than one error for all, on KITTI.

The form holds for features of whose track nothing is remembered: new ones, and those that were not
trusted in the previous step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.estimation.reprojection import SolvedFeatures
from probevo.noise.base import StereoNoise, disparity_variance
from probevo.noise.student_t_arrays import DIM

MIN_REST = 1e-3
"""Smallest share of Σ along l that is left without the time-correlated part: l is taken where the
points end up, and Σ where they were observed."""
TIE = 0.01
"""Difference in likelihood, nats a feature, up to which values of κ count as equally good. Few
features carry information about κ, and if it is too large the disparities contribute too little to
every motion: of two values on raw 0005, 1.3 and 2.6, the larger was likelier and had a rotation
error a tenth larger. Features with a known past count in the mean, though they carry no
information."""
RATIOS = np.array([0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0])
"""Grid of κ on which the search for the likeliest one begins."""


class TimeCorrelationProfile(NamedTuple):
    """The likelihood of the residuals of m features as a function of κ."""

    squared: FloatArray
    """s = eᵀ Σ⁻¹ e, [m]."""
    cross: FloatArray
    """a = mᵀ Σ⁻¹ e, [m]."""
    gain: FloatArray
    """b = mᵀ Σ⁻¹ m, [m]."""
    dof: FloatArray
    """Degrees of freedom ν, [m]."""

    @staticmethod
    def of_rows(rows: FloatArray) -> TimeCorrelationProfile:
        """Return the profile whose ``rows`` these are, [m, 4]."""
        squared, cross, gain, dof = rows.T
        return TimeCorrelationProfile(squared=squared, cross=cross, gain=gain, dof=dof)

    def rows(self) -> FloatArray:
        """Return (s, a, b, ν) of each feature, [m, 4], as they are concatenated over drives."""
        return np.column_stack(self)

    def without_information(self, is_left_out: BoolArray) -> TimeCorrelationProfile:
        """Return the same profile, in which the features of a mask, [m], say nothing of κ.

        Their a and b are 0.
        """
        return self._replace(
            cross=np.where(is_left_out, 0.0, self.cross),
            gain=np.where(is_left_out, 0.0, self.gain),
        )


def time_correlation_profile(
    features: SolvedFeatures, noise: StereoNoise, chosen: IntArray
) -> TimeCorrelationProfile:
    """Return the profile of m chosen features.

    Σ is the scale without the time-correlated part that the noise predicts.
    """
    information = features.information[chosen]
    e = features.residuals[chosen]

    # m = σ l, the direction in which an error of the disparity moves the residual.
    variance = disparity_variance(noise.scale[chosen])
    direction = -features.disparity_jacobian[chosen]
    direction[:, 2] -= 1.0
    direction *= np.sqrt(variance)[:, None]

    # Σ⁻¹ m of each feature, and from it a and b; s is that of the solve.
    white = np.einsum("nij,nj->ni", information, direction)
    s = features.mahalanobis_sq[chosen]
    a = np.sum(white * e, axis=1)
    b = np.sum(white * direction, axis=1)

    # Σ contains the predicted part, κ₀² m mᵀ. Remove it by a rank-one downdate: the equations above
    # with −κ₀² for κ².
    removed = 0.0 if noise.time_correlated is None else noise.time_correlated[chosen] / variance
    rest = np.maximum(1.0 - removed * b, MIN_REST)
    return TimeCorrelationProfile(
        squared=s + removed * a**2 / rest,
        cross=a / rest,
        gain=b / rest,
        dof=noise.dof[chosen],
    )


def smallest_likely_ratio(profile: TimeCorrelationProfile, tie: float = TIE) -> float:
    """Return the smallest κ that is as likely as the likeliest one, up to a tie.

    Args:
        profile: of m features.
        tie: nats a feature up to which likelihoods count as equal.
    """

    def cost(ratio: float) -> float:
        """Return minus the log likelihood of κ, nats."""
        return -log_likelihood(profile, ratio)

    # The likeliest κ, by a grid and a search around its best point.
    best = int(np.argmin([cost(ratio) for ratio in RATIOS]))
    bounds = (RATIOS[max(best - 1, 0)], RATIOS[min(best + 1, len(RATIOS) - 1)])
    likeliest = minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-3})

    # The smallest κ within the tie, between 0, where the cost is above the limit, and the likeliest
    # one, where it is below.
    limit = float(likeliest.fun) + tie
    if cost(0.0) <= limit:
        return 0.0
    return float(brentq(lambda ratio: cost(ratio) - limit, 0.0, float(likeliest.x), xtol=1e-3))


def log_likelihood(profile: TimeCorrelationProfile, ratio: float) -> float:
    """Return the mean log density of the residuals under κ, nats, up to a constant."""
    determinant = 1.0 + ratio**2 * profile.gain
    squared = profile.squared - ratio**2 * profile.cross**2 / determinant
    # (ν + d) log(1 + s/ν) tends to s as ν → ∞.
    is_gaussian = np.isinf(profile.dof)
    nu = np.where(is_gaussian, 1.0, profile.dof)
    robust = np.where(is_gaussian, squared, (nu + DIM) * np.log1p(squared / nu))
    return float(np.mean(-0.5 * (robust + np.log(determinant))))
