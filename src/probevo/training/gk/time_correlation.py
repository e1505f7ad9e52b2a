"""How much of the error of a disparity lasts from frame to frame, by the likelihood of the
residuals.

An error of the disparity that is the same in both frames, κ times as large as the one that is new
in each, σ, adds κ² m mᵀ to the scale Σ of a residual e, m = σ l
(``motion.reprojection_kernels.linearize_noise``). By the rank-one updates of inverse and
determinant,

    s(κ) = s − κ² a²/(1 + κ² b),    ln|Σ(κ)| = ln|Σ| + ln(1 + κ² b),

with s = eᵀ Σ⁻¹ e, a = mᵀ Σ⁻¹ e and b = mᵀ Σ⁻¹ m, so that three numbers a feature tell the
likelihood for every κ. One κ for all features of a kernel, whose σ differ, was 0.02 to 0.07 nats a
feature better than one error for all, on KITTI.

Those are features of whose track nothing is remembered: new ones, and such as were not trusted in
the step before.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.reprojection import ReprojectionSolution
from probevo.noise.base import StereoNoise, disparity_variance
from probevo.noise.student_t_arrays import DIM

LEAST_REST = 1e-3
"""Of what Σ is along l without that part; l is taken where the points end up, and Σ where they were
seen."""
TIE = 0.01
"""Nats a feature by which κ are as good as each other. Few features tell of it, and under a κ that
is too large the disparities contribute too little to every motion: of two on raw 0005, 1.3 and 2.6,
the larger was likelier, and turned a tenth farther astray. Features whose past is known count among
all, though they tell nothing."""
RATIOS = np.array([0.0, 0.1, 0.2, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6, 8.0, 11.0, 16.0])


def time_correlation_profile(
    solution: ReprojectionSolution, noise: StereoNoise, chosen: IntArray
) -> FloatArray:
    """(s, a, b, ν) of some features, [m, 4], by the Σ that is left when what is taken to last is
    taken out."""
    information = solution.information[chosen]
    e = solution.residuals[chosen]
    variance = disparity_variance(noise.scale[chosen])
    direction = -solution.disparity_jacobian[chosen]
    direction[:, 2] -= 1.0
    direction *= np.sqrt(variance)[:, None]
    white = np.einsum("nij,nj->ni", information, direction)
    s = solution.squared[chosen]
    a = np.sum(white * e, axis=1)
    b = np.sum(white * direction, axis=1)
    taken_out = 0.0 if noise.time_correlated is None else noise.time_correlated[chosen] / variance
    rest = np.maximum(1.0 - taken_out * b, LEAST_REST)
    return np.column_stack([s + taken_out * a**2 / rest, a / rest, b / rest, noise.dof[chosen]])


def smallest_likely_ratio(profile: FloatArray, tie: float = TIE) -> float:
    """The smallest κ under which residuals with these (s, a, b, ν), [m, 4], are hardly less likely
    than under any.

    Hardly is by as much as the tie, nats a feature.
    """

    def cost(ratio: float) -> float:
        return -log_likelihood(profile, ratio)

    best = int(np.argmin([cost(ratio) for ratio in RATIOS]))
    around = RATIOS[max(best - 1, 0)], RATIOS[min(best + 1, len(RATIOS) - 1)]
    likeliest = minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-3})
    limit = float(likeliest.fun) + tie
    if cost(0.0) <= limit:
        return 0.0
    return float(brentq(lambda ratio: cost(ratio) - limit, 0.0, float(likeliest.x), xtol=1e-3))


def log_likelihood(profile: FloatArray, ratio: float) -> float:
    """Mean over the features, nats, but for a constant."""
    s, a, b, dof = profile.T
    grown = 1.0 + ratio**2 * b
    squared = s - ratio**2 * a**2 / grown
    gaussian = np.isinf(dof)
    nu = np.where(gaussian, 1.0, dof)
    robust = np.where(gaussian, squared, (nu + DIM) * np.log1p(squared / nu))
    return float(np.mean(-0.5 * (robust + np.log(grown))))
