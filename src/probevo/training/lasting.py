"""How much of the error of a disparity lasts from frame to frame, by the likelihood of the residuals.

An error of the disparity that is the same in both frames, of variance τ², adds τ² l lᵀ to the scale Σ of a residual e
(``motion.reprojection_kernels.linearize_noise``). By the rank-one updates of inverse and determinant,

    s(τ²) = s − τ² a²/(1 + τ² b),    ln|Σ(τ²)| = ln|Σ| + ln(1 + τ² b),

with s = eᵀ Σ⁻¹ e, a = lᵀ Σ⁻¹ e and b = lᵀ Σ⁻¹ l, so that three numbers a feature tell the likelihood for every τ.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import minimize_scalar

from probevo.arrays import FloatArray, IntArray
from probevo.motion.reprojection import ReprojectionSolution
from probevo.noise.base import StereoNoise
from probevo.noise.student_fit import DIM

LEAST_REST = 1e-3
"""Of what Σ is along l without that part; l is taken where the points end up, and Σ where they were seen."""
MOST_PX = 3.0
GRID_PX = np.array([0.0, 0.05, 0.1, 0.2, 0.3, 0.45, 0.6, 0.8, 1.1, 1.5, 2.0, MOST_PX])


def lasting_profile(solution: ReprojectionSolution, noise: StereoNoise, chosen: IntArray) -> FloatArray:
    """(s, a, b, ν) of some features, [m, 4], by the Σ that is left when what is taken to last is taken out."""
    information, e = solution.information[chosen], solution.residuals[chosen]
    direction = -solution.disparity_jacobian[chosen]
    direction[:, 2] -= 1.0
    white = np.einsum("nij,nj->ni", information, direction)
    s = np.einsum("ni,nij,nj->n", e, information, e)
    a, b = np.sum(white * e, axis=1), np.sum(white * direction, axis=1)
    taken_out = 0.0 if noise.lasting is None else noise.lasting[chosen]
    rest = np.maximum(1.0 - taken_out * b, LEAST_REST)
    return np.column_stack([s + taken_out * a**2 / rest, a / rest, b / rest, noise.dof[chosen]])


def most_likely_px(profile: FloatArray) -> float:
    """The τ under which residuals with these (s, a, b, ν), [m, 4], are most likely, px; 0 if any makes them less so."""

    def cost(tau_px: float) -> float:
        return -log_likelihood(profile, tau_px)

    best = int(np.argmin([cost(tau) for tau in GRID_PX]))
    if best == 0 and cost(GRID_PX[1]) > cost(0.0):
        return 0.0
    around = GRID_PX[max(best - 1, 0)], GRID_PX[min(best + 1, len(GRID_PX) - 1)]
    return float(minimize_scalar(cost, bounds=around, method="bounded", options={"xatol": 1e-3}).x)


def log_likelihood(profile: FloatArray, tau_px: float) -> float:
    """Mean over the features, nats, but for a constant."""
    s, a, b, dof = profile.T
    grown = 1.0 + tau_px**2 * b
    squared = s - tau_px**2 * a**2 / grown
    gaussian = np.isinf(dof)
    nu = np.where(gaussian, 1.0, dof)
    robust = np.where(gaussian, squared, (nu + DIM) * np.log1p(squared / nu))
    return float(np.mean(-0.5 * (robust + np.log(grown))))
