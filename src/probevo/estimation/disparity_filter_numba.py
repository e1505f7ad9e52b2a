"""The compiled loops of the disparity filter."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled

COMMON = 6
"""Number of common-mode errors c."""
ROUNDING = 1e-9
"""What a residual leaves of a variance at least, relative to it."""


class LinearizedFeatures(NamedTuple):
    """N features linearised at a motion, as of ``ReprojectionSolution``."""

    jacobian: FloatArray
    """∂h/∂(ξ, η), the motion and, if there is one, the rig's jitter, [N, 4, m], m = 6 or 12."""
    disparity_jacobian: FloatArray
    """∂h/∂d, [N, 4]."""
    information: FloatArray
    """Σ⁻¹, [N, 4, 4]."""
    residuals: FloatArray
    """e, [N, 4]."""


class PriorStates(NamedTuple):
    """The states x = (d, δ) of N tracks before a step."""

    point: FloatArray
    """(u, v, d), [N, 3], px."""
    error: FloatArray
    """δ, [N], px."""
    cov: FloatArray
    """Covariance of (u, v, d, δ), [N, 4, 4], px²."""
    cross_cov: FloatArray
    """Cross-covariance of the residual with (d, δ), [N, 4, 2], px²."""
    common: FloatArray
    """How the last K of z = (ξ, η, c) move (d, δ), [N, 2, K], px: c, of which it is U, and, if
    there is one, the jitter of the previous frame, K = 6 or 9."""


class PosteriorStates(NamedTuple):
    """The states of M tracks after a step, in terms of the current frame but for the mean."""

    mean: FloatArray
    """(d, δ), d still in terms of the previous frame, [M, 2], px."""
    cov: FloatArray
    """Covariance of each track's own error, [M, 2, 2], px²."""
    sensitivity: FloatArray
    """How z = (ξ, η, c) moves them, [M, 2, m + 6], px."""


@compiled
def update_states(
    chosen: IntArray,
    prior: PriorStates,
    features: LinearizedFeatures,
    mean: FloatArray,
    posterior: PosteriorStates,
) -> None:
    """Kalman update of x = (d, δ) of M chosen ones among N tracks with the residuals of a step.

    With z = (ξ, η, c) the errors of the motion and of the rig's jitter and the common-mode errors,
    V = ∂x/∂z before the step, D = (J, H U), and K = (H P)ᵀ Σ⁻¹ the gain of the residual e, x
    becomes x + V z + K (e − D z), its own covariance P − K H P, and its sensitivity to z V − K D.
    The points and residuals are those at the optimum of η already. Covariance and sensitivity are
    in terms of the current frame, where d has grown by ∂d'/∂d, and moves with ξ itself.

    Args:
        chosen: which tracks, [M].
        prior: of the N tracks.
        features: of the N tracks.
        mean: posterior mean of z, [m + 6].
        posterior: filled in.
    """
    x = posterior.mean
    cov = posterior.cov
    sensitivity = posterior.sensitivity
    common = prior.common
    gain = np.empty((2, 4))
    m = features.jacobian.shape[2]
    before = m + COMMON - common.shape[2]
    jittered = common.shape[2] - COMMON
    D = np.empty((4, m + COMMON))
    for n in range(len(chosen)):
        i = chosen[n]
        x[n, 0] = prior.point[i, 2]
        x[n, 1] = prior.error[i]
        for k in range(common.shape[2]):
            x[n, 0] += common[i, 0, k] * mean[before + k]
            x[n, 1] += common[i, 1, k] * mean[before + k]
        for r in range(4):
            e = features.residuals[i, r]
            for k in range(m):
                D[r, k] = features.jacobian[i, r, k]
                e -= D[r, k] * mean[k]
            for k in range(COMMON):
                D[r, m + k] = features.disparity_jacobian[i, r] * common[i, 0, jittered + k]
                if r == 2:
                    D[r, m + k] -= common[i, 1, jittered + k]
                e -= D[r, m + k] * mean[m + k]
            for s in range(2):
                gain[s, r] = 0.0
                for q in range(4):
                    gain[s, r] += prior.cross_cov[i, q, s] * features.information[i, q, r]
                x[n, s] += gain[s, r] * e
        growth = features.disparity_jacobian[i, 0] - features.disparity_jacobian[i, 2]
        for s in range(2):
            for t in range(2):
                cov[n, s, t] = prior.cov[i, 2 + s, 2 + t] * (1.0 + ROUNDING if s == t else 1.0)
                for r in range(4):
                    cov[n, s, t] -= gain[s, r] * prior.cross_cov[i, r, t]
            for k in range(m + COMMON):
                sensitivity[n, s, k] = common[i, s, k - before] if k >= before else 0.0
                for r in range(4):
                    sensitivity[n, s, k] -= gain[s, r] * D[r, k]
        cov[n, 0, 0] *= growth * growth
        cov[n, 0, 1] *= growth
        cov[n, 1, 0] *= growth
        for k in range(m + COMMON):
            sensitivity[n, 0, k] *= growth
            if k < 6:
                sensitivity[n, 0, k] += features.jacobian[i, 0, k] - features.jacobian[i, 2, k]


class CommonModeEquations(NamedTuple):
    """What the common-mode errors add to the normal equations, with M = H U."""

    cross: FloatArray
    """Σ w Jᵀ Σ⁻¹ M, [m, 6]."""
    hessian: FloatArray
    """Σ w Mᵀ Σ⁻¹ M, [6, 6]."""
    gradient: FloatArray
    """Σ w Mᵀ Σ⁻¹ e, [6]."""


@compiled
def common_mode_equations(
    rows: IntArray,
    features: LinearizedFeatures,
    weight: FloatArray,
    common: FloatArray,
    equations: CommonModeEquations,
) -> None:
    """Fill in the normal equations of the common-mode errors.

    Args:
        rows: the M tracks, among N, that these errors move.
        features: of the N tracks.
        weight: IRLS weight of the N tracks, [N].
        common: U of the M tracks, [M, 2, 6], px.
        equations: filled in.
    """
    cross = equations.cross
    hessian = equations.hessian
    gradient = equations.gradient
    cross[:] = 0.0
    hessian[:] = 0.0
    gradient[:] = 0.0
    M = np.empty((4, 6))
    white = np.empty((4, 6))
    for n in range(len(rows)):
        i = rows[n]
        for r in range(4):
            for k in range(6):
                M[r, k] = features.disparity_jacobian[i, r] * common[n, 0, k] - (
                    common[n, 1, k] if r == 2 else 0.0
                )
        for r in range(4):
            for k in range(6):
                total = 0.0
                for q in range(4):
                    total += features.information[i, r, q] * M[q, k]
                white[r, k] = weight[i] * total
        for r in range(4):
            for k in range(6):
                gradient[k] += white[r, k] * features.residuals[i, r]
                for j in range(cross.shape[0]):
                    cross[j, k] += features.jacobian[i, r, j] * white[r, k]
                for j in range(COMMON):
                    hessian[j, k] += M[r, j] * white[r, k]
