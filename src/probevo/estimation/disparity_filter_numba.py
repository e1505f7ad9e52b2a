"""Compiled inner loop of the memory of disparities."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled

ROUNDING = 1e-9
"""Of a variance, is left by whatever a residual says."""


@compiled
def renew(
    chosen: IntArray,
    seen: FloatArray,
    error: FloatArray,
    point_cov: FloatArray,
    shared: FloatArray,
    information: FloatArray,
    residuals: FloatArray,
    jacobian: FloatArray,
    disparity_jacobian: FloatArray,
    common: FloatArray,
    mean: FloatArray,
    x: FloatArray,
    cov: FloatArray,
    felt: FloatArray,
) -> None:
    """What a step tells of x = (d, δ) of M chosen ones among N tracks.

    With z = (ξ, c) the motion's error and the errors in common, D = (J, H U), and K = (H P)ᵀ Σ⁻¹
    the gain of the residual e, x becomes x + U c + K (e − D z), its own covariance P − K H P, and
    what z does to it (0, U) − K D. Covariance and felt are in terms of the current frame, where d
    has grown by ∂d'/∂d, and moves with ξ itself.

    Args:
        chosen: which tracks, [M].
        seen, error, point_cov: as of ``SeenPoints``, [N, 3], [N], [N, 4, 4].
        shared, information, residuals, jacobian, disparity_jacobian: as of
            ``ReprojectionSolution``.
        common: U, [N, 2, 6], px.
        mean: z, [12].
        x: out, in terms of the previous frame, [M, 2], px.
        cov: out, [M, 2, 2], px².
        felt: out, [M, 2, 12], px.
    """
    gain = np.empty((2, 4))
    moved = np.empty((4, 12))
    for n in range(len(chosen)):
        i = chosen[n]
        x[n, 0] = seen[i, 2]
        x[n, 1] = error[i]
        for k in range(6):
            x[n, 0] += common[i, 0, k] * mean[6 + k]
            x[n, 1] += common[i, 1, k] * mean[6 + k]
        for r in range(4):
            e = residuals[i, r]
            for k in range(6):
                moved[r, k] = jacobian[i, r, k]
                moved[r, 6 + k] = disparity_jacobian[i, r] * common[i, 0, k]
                if r == 2:
                    moved[r, 6 + k] -= common[i, 1, k]
                e -= moved[r, k] * mean[k] + moved[r, 6 + k] * mean[6 + k]
            for s in range(2):
                gain[s, r] = 0.0
                for q in range(4):
                    gain[s, r] += shared[i, q, s] * information[i, q, r]
                x[n, s] += gain[s, r] * e
        growth = disparity_jacobian[i, 0] - disparity_jacobian[i, 2]
        for s in range(2):
            for t in range(2):
                cov[n, s, t] = point_cov[i, 2 + s, 2 + t] * (1.0 + ROUNDING if s == t else 1.0)
                for r in range(4):
                    cov[n, s, t] -= gain[s, r] * shared[i, r, t]
            for k in range(12):
                felt[n, s, k] = common[i, s, k - 6] if k >= 6 else 0.0
                for r in range(4):
                    felt[n, s, k] -= gain[s, r] * moved[r, k]
        cov[n, 0, 0] *= growth * growth
        cov[n, 0, 1] *= growth
        cov[n, 1, 0] *= growth
        for k in range(12):
            felt[n, 0, k] *= growth
            if k < 6:
                felt[n, 0, k] += jacobian[i, 0, k] - jacobian[i, 2, k]


@compiled
def normal_parts(
    rows: IntArray,
    jacobian: FloatArray,
    disparity_jacobian: FloatArray,
    information: FloatArray,
    weight: FloatArray,
    residuals: FloatArray,
    common: FloatArray,
    cross: FloatArray,
    own: FloatArray,
    pull: FloatArray,
) -> None:
    """What the errors in common add to the normal equations: Σ w Jᵀ Σ⁻¹ M, Σ w Mᵀ Σ⁻¹ M and Σ w Mᵀ
    Σ⁻¹ e, M = H U.

    Args:
        rows: the M tracks that feel them, among N.
        jacobian, disparity_jacobian, information, weight, residuals: as of
            ``ReprojectionSolution``; the IRLS weight.
        common: U of these tracks, [M, 2, 6], px.
        cross, own, pull: out, [6, 6], [6, 6], [6].
    """
    cross[:] = 0.0
    own[:] = 0.0
    pull[:] = 0.0
    moved = np.empty((4, 6))
    white = np.empty((4, 6))
    for n in range(len(rows)):
        i = rows[n]
        for r in range(4):
            for k in range(6):
                moved[r, k] = disparity_jacobian[i, r] * common[n, 0, k] - (
                    common[n, 1, k] if r == 2 else 0.0
                )
        for r in range(4):
            for k in range(6):
                total = 0.0
                for q in range(4):
                    total += information[i, r, q] * moved[q, k]
                white[r, k] = weight[i] * total
        for r in range(4):
            for k in range(6):
                pull[k] += white[r, k] * residuals[i, r]
                for j in range(6):
                    cross[j, k] += jacobian[i, r, j] * white[r, k]
                    own[j, k] += moved[r, j] * white[r, k]
