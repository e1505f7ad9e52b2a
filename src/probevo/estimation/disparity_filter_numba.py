"""The compiled loops of the disparity filter."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import (
    compiled,
    factor,
    invert_positive_definite,
    solve_positive_definite,
)

NUM_LATENT = 6
"""Number of latent errors c."""
ROUNDING = 1e-9
"""What a residual leaves of a variance at least, relative to it."""


class LinearizedFeatures(NamedTuple):
    """N features linearised at a motion, see ``SolvedFeatures``."""

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

    With z = (ξ, η, c) the errors of the motion and of the rig's jitter and the latent errors,
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
    # z is [ξ, η', η°, c], of which V = ∂x/∂z has the last K columns: those of η°, if there is one,
    # and of c. D has the columns of (ξ, η), J, and those of c, H U.
    m = features.jacobian.shape[2]
    num_moving = common.shape[2]
    first_moving = m + NUM_LATENT - num_moving
    num_prev_jitter = num_moving - NUM_LATENT
    D = np.empty((4, m + NUM_LATENT))
    for n in range(len(chosen)):
        i = chosen[n]
        # x + V z.
        x[n, 0] = prior.point[i, 2]
        x[n, 1] = prior.error[i]
        for k in range(num_moving):
            x[n, 0] += common[i, 0, k] * mean[first_moving + k]
            x[n, 1] += common[i, 1, k] * mean[first_moving + k]
        # D = (J, H U), of which δ enters u_r alone; the innovation e − D z; K, and K times that.
        for r in range(4):
            e = features.residuals[i, r]
            for k in range(m):
                D[r, k] = features.jacobian[i, r, k]
                e -= D[r, k] * mean[k]
            for k in range(NUM_LATENT):
                common_column = num_prev_jitter + k
                D[r, m + k] = features.disparity_jacobian[i, r] * common[i, 0, common_column]
                if r == 2:
                    D[r, m + k] -= common[i, 1, common_column]
                e -= D[r, m + k] * mean[m + k]
            for s in range(2):
                gain[s, r] = 0.0
                for q in range(4):
                    gain[s, r] += prior.cross_cov[i, q, s] * features.information[i, q, r]
                x[n, s] += gain[s, r] * e
        # P − K H P and V − K D, with the columns of (d, δ) of H P in ``cross_cov``. The diagonal of
        # P is first enlarged by a rounding error, so that a variance stays positive even if the
        # residual takes all of it away.
        for s in range(2):
            for t in range(2):
                cov[n, s, t] = prior.cov[i, 2 + s, 2 + t] * (1.0 + ROUNDING if s == t else 1.0)
                for r in range(4):
                    cov[n, s, t] -= gain[s, r] * prior.cross_cov[i, r, t]
            for k in range(m + NUM_LATENT):
                sensitivity[n, s, k] = 0.0
                if k >= first_moving:
                    sensitivity[n, s, k] = common[i, s, k - first_moving]
                for r in range(4):
                    sensitivity[n, s, k] -= gain[s, r] * D[r, k]
        # In terms of the current frame: d' = u_l' − u_r' grows by ∂d'/∂d, and the motion ξ moves d'
        # itself, by the rows of J for u_l less those for u_r. The mean is moved by the caller.
        growth = features.disparity_jacobian[i, 0] - features.disparity_jacobian[i, 2]
        cov[n, 0, 0] *= growth * growth
        cov[n, 0, 1] *= growth
        cov[n, 1, 0] *= growth
        for k in range(m + NUM_LATENT):
            sensitivity[n, 0, k] *= growth
            if k < 6:
                sensitivity[n, 0, k] += features.jacobian[i, 0, k] - features.jacobian[i, 2, k]


class LatentEquations(NamedTuple):
    """What the latent errors add to the normal equations, with M = H U."""

    cross: FloatArray
    """Σ w Jᵀ Σ⁻¹ M, [m, 6]."""
    hessian: FloatArray
    """Σ w Mᵀ Σ⁻¹ M, [6, 6]."""
    gradient: FloatArray
    """Σ w Mᵀ Σ⁻¹ e, [6]."""


@compiled
def latent_equations(
    rows: IntArray,
    features: LinearizedFeatures,
    weight: FloatArray,
    common: FloatArray,
    equations: LatentEquations,
) -> None:
    """Fill in the normal equations of the latent errors.

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
    M = np.empty((4, NUM_LATENT))
    white = np.empty((4, NUM_LATENT))
    for n in range(len(rows)):
        i = rows[n]
        # M = H U: d moves the whole prediction, δ its u_r alone.
        for r in range(4):
            for k in range(NUM_LATENT):
                M[r, k] = features.disparity_jacobian[i, r] * common[n, 0, k] - (
                    common[n, 1, k] if r == 2 else 0.0
                )
        # w Σ⁻¹ M.
        for r in range(4):
            for k in range(NUM_LATENT):
                total = 0.0
                for q in range(4):
                    total += features.information[i, r, q] * M[q, k]
                white[r, k] = weight[i] * total
        # Column k of w Σ⁻¹ M, times e, J and M.
        J = features.jacobian[i]
        e = features.residuals[i]
        for k in range(NUM_LATENT):
            w0 = white[0, k]
            w1 = white[1, k]
            w2 = white[2, k]
            w3 = white[3, k]
            gradient[k] += w0 * e[0] + w1 * e[1] + w2 * e[2] + w3 * e[3]
            for j in range(cross.shape[0]):
                cross[j, k] += w0 * J[0, j] + w1 * J[1, j] + w2 * J[2, j] + w3 * J[3, j]
            for j in range(NUM_LATENT):
                hessian[j, k] += w0 * M[0, j] + w1 * M[1, j] + w2 * M[2, j] + w3 * M[3, j]


@compiled
def _set_joint(
    own: FloatArray, cross: FloatArray, common: FloatArray, scale: float, joint: FloatArray
) -> None:
    """Fill in the matrix of these blocks, the last one times ``scale`` and with the prior of c."""
    m = len(own)
    for i in range(m):
        for j in range(m):
            joint[i, j] = own[i, j]
        for k in range(NUM_LATENT):
            joint[i, m + k] = joint[m + k, i] = cross[i, k]
    for k in range(NUM_LATENT):
        for j in range(NUM_LATENT):
            joint[m + k, m + j] = scale * common[k, j] + (1.0 if j == k else 0.0)


@compiled
def joint_posterior(
    hessian: FloatArray,
    cov: FloatArray,
    equations: LatentEquations,
    num_known: int,
    mean: FloatArray,
    root: FloatArray,
) -> bool:
    """Compute the posterior of z = (ξ, η, c) one Gauss–Newton step from the optimum of (ξ, η).

    Only the latent errors have a gradient there. The step follows from the Hessian with the robust
    weights, in which (ξ, η) have the block H = A Aᵀ. The covariance must not: that of (ξ, η) alone
    is C, with C⁻¹ = B Bᵀ, the information of an M-estimate. The blocks of c are changed alike. With
    F = B A⁻¹ and f the geometric mean of its diagonal, the cross term X becomes f F X, and the
    Hessian of c becomes f² times as large. So does its Schur complement, since
    (F X)ᵀ (B Bᵀ)⁻¹ F X = Xᵀ H⁻¹ X.

    Args:
        hessian: H of (ξ, η), [m, m].
        cov: C of (ξ, η), [m, m].
        equations: of the latent errors, without their prior N(0, I).
        num_known: how many of z, the first ones, are known.
        mean: filled in, [m + 6]; that of the known ones is left alone.
        root: filled in, a root of the covariance, [m + 6, m + 6]; likewise.

    Returns:
        False where a matrix is not positive definite to working precision.
    """
    m = len(hessian)
    free = m + NUM_LATENT - num_known
    joint = np.empty((m + NUM_LATENT, m + NUM_LATENT))
    # One Gauss–Newton step.
    _set_joint(hessian, equations.cross, equations.hessian, scale=1.0, joint=joint)
    # At the optimum of (ξ, η) these have no gradient; c is at zero, where its prior has none
    # either.
    gradient = np.zeros(free)
    for k in range(NUM_LATENT):
        gradient[free - NUM_LATENT + k] = equations.gradient[k]
    lower = np.zeros((free, free))
    step = np.empty(free)
    if not solve_positive_definite(joint[num_known:, num_known:], gradient, lower, solution=step):
        return False
    for i in range(free):
        mean[num_known + i] = step[i]
    # The factors A and B, and f, the geometric mean of the diagonal of B A⁻¹. The inversion has A
    # as its work space first.
    information = np.empty((m, m))
    A = np.zeros((m, m))
    B = np.zeros((m, m))
    if not (invert_positive_definite(cov, A, information) and factor(information, m, B)):
        return False
    if not factor(hessian, m, A):
        return False
    scale = 1.0
    for i in range(m):
        scale *= (B[i, i] / A[i, i]) ** (1.0 / m)
    # f B A⁻¹ X, column by column: forward substitution with A, then times B.
    cross = np.empty((m, NUM_LATENT))
    column = np.empty(m)
    for k in range(NUM_LATENT):
        for i in range(m):
            total = equations.cross[i, k]
            for j in range(i):
                total -= A[i, j] * column[j]
            column[i] = total / A[i, i]
        for i in range(m):
            total = 0.0
            for j in range(i + 1):
                total += B[i, j] * column[j]
            cross[i, k] = scale * total
    _set_joint(information, cross, equations.hessian, scale=scale * scale, joint=joint)
    if not factor(joint[num_known:, num_known:], free, lower):
        return False
    # A root of (L Lᵀ)⁻¹ is L⁻ᵀ, which is upper triangular: its row j is column j of L⁻¹.
    for j in range(free):
        for i in range(j, free):
            total = 1.0 if i == j else 0.0
            for k in range(j, i):
                total -= lower[i, k] * root[num_known + j, num_known + k]
            root[num_known + j, num_known + i] = total / lower[i, i]
    return True


@compiled
def whiten(sensitivity: FloatArray, cov: FloatArray) -> bool:
    """Divide sensitivities [M, 2, L] by the Cholesky factors of covariances [M, 2, 2], in place;
    False where one is not positive definite."""
    # L⁻¹ V with the factor L = [[first, 0], [across, second]] of each covariance.
    for n in range(len(sensitivity)):
        first = math.sqrt(cov[n, 0, 0])
        across = cov[n, 1, 0] / first
        rest = cov[n, 1, 1] - across * across
        if not rest > 0.0:
            return False
        second = math.sqrt(rest)
        for k in range(sensitivity.shape[2]):
            white = sensitivity[n, 0, k] / first
            sensitivity[n, 0, k] = white
            sensitivity[n, 1, k] = (sensitivity[n, 1, k] - across * white) / second
    return True


@compiled
def add_squares(sensitivity: FloatArray, first: int, last: int, cov: FloatArray) -> None:
    """Add to covariances [M, 2, 2] what some independent errors of unit variance contribute.

    Args:
        sensitivity: to L errors, [M, 2, L].
        first: the first of those errors.
        last: the one behind the last of them.
        cov: changed in place.
    """
    for n in range(len(sensitivity)):
        for k in range(first, last):
            disparity_sensitivity = sensitivity[n, 0, k]
            error_sensitivity = sensitivity[n, 1, k]
            cov[n, 0, 0] += disparity_sensitivity * disparity_sensitivity
            cov[n, 1, 1] += error_sensitivity * error_sensitivity
            cov[n, 0, 1] += disparity_sensitivity * error_sensitivity
        cov[n, 1, 0] = cov[n, 0, 1]


@compiled
def split_rows(rows: FloatArray, lower: FloatArray, directions: FloatArray) -> bool:
    """Split rows [K, L] into ``lower`` [K, K], triangular, times orthonormal ``directions`` [L, K],
    transposed, by Gram–Schmidt's method; False where a row depends on those before.

    Each row is orthogonalised twice, and so to working precision.
    """
    lower[:] = 0.0
    for k in range(len(rows)):
        q = rows[k].copy()
        for _ in range(2):
            for j in range(k):
                along = 0.0
                for i in range(len(q)):
                    along += q[i] * directions[i, j]
                lower[k, j] += along
                for i in range(len(q)):
                    q[i] -= along * directions[i, j]
        squared = 0.0
        for i in range(len(q)):
            squared += q[i] * q[i]
        if not squared > 0.0:
            return False
        lower[k, k] = math.sqrt(squared)
        for i in range(len(q)):
            directions[i, k] = q[i] / lower[k, k]
    return True
