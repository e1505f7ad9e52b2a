"""Compiled loops over the rig's jitter: unknowns that move all features of a step together.

The residual is e = y' − h(s) − D η, with h(s) = f(T g(s)) and η = (η', η°) ~ N(0, I). Here η' is
the jitter of the current frame in units of its standard deviation; it moves the right observations
by B η'. And η° is the unknown part of the jitter of the previous frame; it moves (s, δ) = (u, v, d,
δ) by V η°. Hence D = (B, H V), with H = (∂h/∂s, −(0, 0, 1, 0)).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.rig_jitter_numba import right_offset
from probevo.camera.transfer_numba import NEAREST, Intrinsics, move_point
from probevo.compiled import compiled
from probevo.measurements.robust_loss_numba import robust_bend, robust_weight
from probevo.measurements.stereo_numba import (
    FeatureWeights,
    LossParameters,
    NormalEquations,
    PointPairs,
    PropagatedNoise,
    StereoJacobians,
    normal_equations,
    propagate_noise,
)

JITTER_DIM = 3
"""Degrees of freedom of the jitter in one frame: pitch, yaw, roll."""
JITTER_PAIR_DIM = 2 * JITTER_DIM
"""Dimension of η: the jitter of the current frame, then that of the previous one."""


class JitterEffects(NamedTuple):
    """Derivatives of N features by the jitter."""

    basis: FloatArray
    """B = ∂(u_r', v_r')/∂η', [N, 2, 3], px."""
    sensitivity: FloatArray
    """V = ∂(u, v, d, δ)/∂η°, the points of the previous frame, [N, 4, 3], px."""


class LinearizedJitter(NamedTuple):
    """The effect of the jitter on N residuals, at the motion at which their noise was
    propagated."""

    columns: FloatArray
    """D = −∂e/∂η, [N, 4, 6], px."""
    white: FloatArray
    """Σ⁻¹ D, [N, 4, 6], px⁻¹."""
    square: FloatArray
    """The lower triangle of Dᵀ Σ⁻¹ D, [N, 6, 6]."""
    prev_eta: FloatArray
    """η° at the linearisation, [3]: the points are those of this value, and of η' = 0."""
    curr: FloatArray
    """y' of these points, with their δ, [N, 4], px."""

    @staticmethod
    def empty(count: int) -> LinearizedJitter:
        """Return uninitialised arrays for N features."""
        return LinearizedJitter(
            columns=np.empty((count, 4, JITTER_PAIR_DIM)),
            white=np.empty((count, 4, JITTER_PAIR_DIM)),
            square=np.empty((count, JITTER_PAIR_DIM, JITTER_PAIR_DIM)),
            prev_eta=np.empty(JITTER_DIM),
            curr=np.empty((count, 4)),
        )


class Iterate(NamedTuple):
    """The current values of a solve."""

    T: FloatArray
    """T_curr_prev, [4, 4]."""
    eta: FloatArray
    """η, [6]."""


class JitterEquations(NamedTuple):
    """Hessian · (ξ, η) = gradient."""

    hessian: FloatArray
    """[12, 12]."""
    gradient: FloatArray
    """The direction of descent, [12]."""

    @staticmethod
    def empty() -> JitterEquations:
        """Return uninitialised arrays."""
        return JitterEquations(
            hessian=np.empty((6 + JITTER_PAIR_DIM, 6 + JITTER_PAIR_DIM)),
            gradient=np.empty(6 + JITTER_PAIR_DIM),
        )


@compiled
def jitter_effects(
    prev: FloatArray,
    curr: FloatArray,
    camera: Intrinsics,
    curr_root: FloatArray,
    prev_root: FloatArray,
    gain: FloatArray,
) -> JitterEffects:
    """Return the derivatives of N features that have no state in the disparity filter.

    An observation is the true one plus G ω, with ω = L η. The true point is therefore that of the
    observation minus K G L η.

    Args:
        prev: observations in the previous frame, [N, 4], px.
        curr: those in the current frame, [N, 4], px.
        camera: the intrinsics.
        curr_root: L' of the current frame, [3, 3], rad.
        prev_root: L° of the previous frame, [3, 3], rad.
        gain: K, [N, 3, 4].
    """
    basis = np.empty((len(prev), 2, JITTER_DIM))
    sensitivity = np.empty((len(prev), 4, JITTER_DIM))
    offset = np.empty((2, JITTER_DIM))
    moved = np.empty((2, JITTER_DIM))
    for n in range(len(prev)):
        # G of the place in the right image, ∂(u_r, v_r)/∂ω, [2, 3]: B = G' L', and G° L°.
        right_offset(camera, curr[n, 2], curr[n, 3], offset)
        _product(offset, curr_root, basis[n])
        right_offset(camera, prev[n, 2], prev[n, 3], offset)
        _product(offset, prev_root, moved)
        for k in range(JITTER_DIM):
            # K applied to (0, 0, δu_r, δv_r): the jitter moves the right observation only.
            for i in range(3):
                sensitivity[n, i, k] = -gain[n, i, 2] * moved[0, k] - gain[n, i, 3] * moved[1, k]
            sensitivity[n, 3, k] = 0.0
    return JitterEffects(basis, sensitivity)


@compiled
def _product(offset: FloatArray, root: FloatArray, product: FloatArray) -> None:
    """Fill in offset · root, [2, 3] by [3, 3]."""
    for r in range(2):
        for k in range(JITTER_DIM):
            product[r, k] = (
                offset[r, 0] * root[0, k] + offset[r, 1] * root[1, k] + offset[r, 2] * root[2, k]
            )


@compiled
def jitter_columns(
    T: FloatArray,
    camera: Intrinsics,
    refined: FloatArray,
    basis: FloatArray,
    sensitivity: FloatArray,
    columns: FloatArray,
) -> None:
    """Fill in D = (B, H V).

    Args:
        T: T_curr_prev, [4, 4].
        camera: the intrinsics.
        refined: where to linearise, (u, v, d), [N, 3], px.
        basis: B, [N, 2, 3], px.
        sensitivity: V, [N, 4, 3], px.
        columns: filled in, [N, 4, 6], px; zero behind the camera.
    """
    fu, fv, _, _, fb = camera
    move = np.empty(3)  # ∂q/∂η° over q_z
    for n in range(len(refined)):
        columns[n] = 0.0
        X, Y, Z, rho = move_point(T, camera, refined[n])
        if Z < NEAREST:
            continue
        # q = C m + ρ t moves with (u, v, d) by C e_x/f_u, C e_y/f_v and t/(f_u b).
        x = X / Z
        y = Y / Z
        d = fb * rho / Z
        for k in range(JITTER_DIM):
            # B: the jitter of the current frame moves u_r and v_r.
            columns[n, 2, k] = basis[n, 0, k]
            columns[n, 3, k] = basis[n, 1, k]
            # H V: that of the previous frame moves the point, and so the whole prediction.
            for i in range(3):
                move[i] = (
                    T[i, 0] * sensitivity[n, 0, k] / fu
                    + T[i, 1] * sensitivity[n, 1, k] / fv
                    + T[i, 3] * sensitivity[n, 2, k] / fb
                ) / Z
            # u' = f_u q_x/q_z and d' = d/q_z, whose derivatives are those of the numerator over
            # q_z, less (u', d') ∂q_z/q_z; u_r' = u' − d' − δ.
            u_move = fu * (move[0] - x * move[2])
            v_move = fv * (move[1] - y * move[2])
            d_move = sensitivity[n, 2, k] / Z - d * move[2]
            columns[n, 0, JITTER_DIM + k] = u_move
            columns[n, 1, JITTER_DIM + k] = v_move
            columns[n, 2, JITTER_DIM + k] = u_move - d_move - sensitivity[n, 3, k]
            columns[n, 3, JITTER_DIM + k] = v_move


@compiled
def propagate_with_jitter(
    at: Iterate,
    camera: Intrinsics,
    pairs: PointPairs,
    effects: JitterEffects,
    propagated: PropagatedNoise,
    jitter: LinearizedJitter,
) -> None:
    """Propagate the noise of the residuals as ``propagate_noise`` does, and linearise the jitter.

    Args:
        at: the motion and the jitter.
        camera: the intrinsics.
        pairs: the points and observations at η = 0.
        effects: their derivatives by η.
        propagated: filled in.
        jitter: filled in.
    """
    V = effects.sensitivity
    eta = at.eta
    # Points and observations at the current η: the noise is propagated there, not at η = 0.
    point = np.empty((len(pairs.point), 3))
    curr = np.empty((len(point), 4))
    for n in range(len(point)):
        for i in range(3):
            point[n, i] = pairs.point[n, i] + (
                V[n, i, 0] * eta[3] + V[n, i, 1] * eta[4] + V[n, i, 2] * eta[5]
            )
        error = V[n, 3, 0] * eta[3] + V[n, 3, 1] * eta[4] + V[n, 3, 2] * eta[5]
        # η° changes the estimate of δ, too, for which u_r' has been corrected; η' moves both
        # coordinates of the right observation.
        for r in range(4):
            jitter.curr[n, r] = pairs.curr[n, r] + (error if r == 2 else 0.0)
            curr[n, r] = jitter.curr[n, r]
        for r in range(2):
            B = effects.basis[n, r]
            curr[n, 2 + r] -= B[0] * eta[0] + B[1] * eta[1] + B[2] * eta[2]
    for k in range(JITTER_DIM):
        jitter.prev_eta[k] = eta[JITTER_DIM + k]
    moved = PointPairs(point, pairs.point_cov, curr, pairs.curr_scale)
    propagate_noise(at.T, camera, moved, propagated)
    jitter_columns(
        at.T,
        camera,
        propagated.refined,
        basis=effects.basis,
        sensitivity=V,
        columns=jitter.columns,
    )
    for n in range(len(point)):
        _whiten(propagated.information[n], jitter.columns[n], jitter.white[n], jitter.square[n])


@compiled
def _whiten(W: FloatArray, D: FloatArray, white: FloatArray, square: FloatArray) -> None:
    """Fill in W D and the lower triangle of Dᵀ W D of a feature, without the zeros of D.

    η' moves the right observation only (rows 2 and 3), and η° moves v_l and v_r equally (rows 1
    and 3).
    """
    for i in range(4):
        row_v = W[i, 1] + W[i, 3]
        for k in range(JITTER_DIM):
            white[i, k] = W[i, 2] * D[2, k] + W[i, 3] * D[3, k]
        for k in range(JITTER_DIM, JITTER_PAIR_DIM):
            white[i, k] = W[i, 0] * D[0, k] + row_v * D[1, k] + W[i, 2] * D[2, k]
    for k in range(JITTER_DIM):
        for j in range(k + 1):
            square[k, j] = D[2, k] * white[2, j] + D[3, k] * white[3, j]
    for k in range(JITTER_DIM, JITTER_PAIR_DIM):
        for j in range(k + 1):
            row_v = white[1, j] + white[3, j]
            square[k, j] = D[0, k] * white[0, j] + D[1, k] * row_v + D[2, k] * white[2, j]


@compiled
def subtract_jitter(jitter: LinearizedJitter, eta: FloatArray, shifted: FloatArray) -> None:
    """Fill ``shifted`` [N, 4] with y' − D η, where η° counts from its value at the
    linearisation."""
    change = np.empty(JITTER_PAIR_DIM)
    for k in range(JITTER_DIM):
        change[k] = eta[k]  # ``jitter.curr`` is that of η' = 0
        change[JITTER_DIM + k] = eta[JITTER_DIM + k] - jitter.prev_eta[k]
    for n in range(len(shifted)):
        for r in range(4):
            offset = 0.0
            for k in range(JITTER_PAIR_DIM):
                offset += jitter.columns[n, r, k] * change[k]
            shifted[n, r] = jitter.curr[n, r] - offset


class _LossAt(NamedTuple):
    """The robust loss at the residuals of N features."""

    kind: int
    parameter: FloatArray
    """Parameter of the loss for each residual, [N] (``LossParameters``)."""
    squared: FloatArray
    """s of each residual, [N]."""
    newton: bool
    """Whether to take its curvature into account."""


@compiled
def _set_jitter(
    T: FloatArray,
    camera: Intrinsics,
    curr: FloatArray,
    propagated: PropagatedNoise,
    jitter: LinearizedJitter,
    loss: _LossAt,
    equations: JitterEquations,
) -> None:
    """Fill in Σ w Jᵀ Σ⁻¹ D, Σ w Dᵀ Σ⁻¹ D and Σ w Dᵀ Σ⁻¹ e, with Newton's terms if asked for.

    ``curr`` [N, 4] are the observations minus D η, at whose residuals the weights are taken.
    """
    fu, fv, cu, cv, fb = camera
    pull = np.empty(JITTER_PAIR_DIM)
    cross = np.zeros((6, JITTER_PAIR_DIM))
    square = np.zeros((JITTER_PAIR_DIM, JITTER_PAIR_DIM))
    gradient = np.zeros(JITTER_PAIR_DIM)
    for n in range(len(curr)):
        W = propagated.information[n]
        X, Y, Z, rho = move_point(T, camera, propagated.refined[n])
        if Z < NEAREST or not W[0, 0] > 0.0:
            continue
        white = jitter.white[n]
        iz = 1.0 / Z
        u = fu * X * iz
        v = fv * Y * iz
        d = fb * rho * iz
        # The weighted residual w e, and with it the gradient w Dᵀ Σ⁻¹ e by η.
        weight = robust_weight(loss.kind, loss.parameter[n], loss.squared[n])
        e0 = weight * (curr[n, 0] - (u + cu) - propagated.offset[n, 0])
        e1 = weight * (curr[n, 1] - (v + cv) - propagated.offset[n, 1])
        e2 = weight * (curr[n, 2] - (u - d + cu) - propagated.offset[n, 2])
        e3 = weight * (curr[n, 3] - (v + cv) - propagated.offset[n, 3])
        for k in range(JITTER_PAIR_DIM):
            pull[k] = white[0, k] * e0 + white[1, k] * e1 + white[2, k] * e2 + white[3, k] * e3
            gradient[k] += pull[k]
        # As in ``normal_equations``, the rows of F = ∂f/∂q are u_l (u_x, 0, u_z),
        # v (0, v_y, v_z) and u_r (u_x, 0, r_z), and q moves by ρ δt + φ × q.
        u_x = fu * iz
        u_z = -u * iz
        v_y = fv * iz
        v_z = -v * iz
        r_z = -(u - d) * iz
        # Newton's Hessian is that of IRLS minus a multiple of the outer product of the weighted
        # gradient, since the curvature of a robust loss is less than its weight.
        bend = 0.0
        q0 = q1 = q2 = 0.0
        if loss.newton:
            bend = robust_bend(loss.kind, loss.parameter[n], loss.squared[n])
            # (q0, q1, q2) = Fᵀ w Σ⁻¹ e, with the weight in e already.
            g0 = W[0, 0] * e0 + W[0, 1] * e1 + W[0, 2] * e2 + W[0, 3] * e3
            g1 = W[1, 0] * e0 + W[1, 1] * e1 + W[1, 2] * e2 + W[1, 3] * e3
            g2 = W[2, 0] * e0 + W[2, 1] * e1 + W[2, 2] * e2 + W[2, 3] * e3
            g3 = W[3, 0] * e0 + W[3, 1] * e1 + W[3, 2] * e2 + W[3, 3] * e3
            q0 = u_x * (g0 + g2)
            q1 = v_y * (g1 + g3)
            q2 = u_z * g0 + v_z * (g1 + g3) + r_z * g2
        for k in range(JITTER_PAIR_DIM):
            bent = bend * pull[k]
            w0 = weight * white[0, k]
            w1 = weight * (white[1, k] + white[3, k])
            w2 = weight * white[2, k]
            # Column k of Fᵀ w Σ⁻¹ D, with Newton's term, and from q to ξ.
            k0 = u_x * (w0 + w2) - q0 * bent
            k1 = v_y * w1 - q1 * bent
            k2 = u_z * w0 + v_z * w1 + r_z * w2 - q2 * bent
            cross[0, k] += rho * k0
            cross[1, k] += rho * k1
            cross[2, k] += rho * k2
            cross[3, k] += Y * k2 - Z * k1
            cross[4, k] += Z * k0 - X * k2
            cross[5, k] += X * k1 - Y * k0
            for j in range(k + 1):
                square[k, j] += weight * jitter.square[n, k, j] - bent * pull[j]
    _set_blocks(cross, square, equations.hessian)
    for k in range(JITTER_PAIR_DIM):
        equations.gradient[6 + k] = gradient[k]


@compiled
def _set_blocks(cross: FloatArray, square: FloatArray, joint: FloatArray) -> None:
    """Fill in the blocks ξ × η and η × η of a symmetric matrix over (ξ, η), [12, 12].

    Of the block η × η, the lower triangle is given.
    """
    for k in range(JITTER_PAIR_DIM):
        for i in range(6):
            joint[i, 6 + k] = joint[6 + k, i] = cross[i, k]
        for j in range(k + 1):
            joint[6 + j, 6 + k] = joint[6 + k, 6 + j] = square[k, j]


@compiled
def joint_normal_equations(
    at: Iterate,
    camera: Intrinsics,
    propagated: PropagatedNoise,
    jitter: LinearizedJitter,
    loss: LossParameters,
    newton: bool,
    equations: JitterEquations,
) -> float:
    """Fill in the normal equations over (ξ, η), with the prior of η; return the cost.

    They extend those of ``stereo_numba.normal_equations``, which are taken at the observations
    minus D η.

    Args:
        at: the motion and the jitter.
        camera: the intrinsics.
        propagated: the noise of the residuals.
        jitter: where it was linearised.
        loss: the robust loss.
        newton: whether to take the curvature of the loss into account.
        equations: filled in.
    """
    # The block of ξ at y' − D η. The other blocks have the robust weights of the same residuals.
    curr = np.empty((len(jitter.curr), 4))
    subtract_jitter(jitter, at.eta, curr)
    motion = NormalEquations(np.empty((6, 6)), np.empty(6), np.empty(len(curr)))
    cost = normal_equations(
        at.T, camera, curr, propagated=propagated, loss=loss, newton=newton, system=motion
    )
    hessian = equations.hessian
    gradient = equations.gradient
    _set_jitter(
        at.T,
        camera,
        curr,
        propagated=propagated,
        jitter=jitter,
        loss=_LossAt(loss.kind, loss.parameter, motion.squared, newton),
        equations=equations,
    )
    # The block of ξ is that of the motion at a given η.
    for i in range(6):
        gradient[i] = motion.gradient[i]
        for j in range(6):
            hessian[i, j] = motion.hessian[i, j]
    # The prior η ~ N(0, I)
    for k in range(JITTER_PAIR_DIM):
        cost += 0.5 * at.eta[k] * at.eta[k]
        gradient[6 + k] -= at.eta[k]
        hessian[6 + k, 6 + k] += 1.0
    return cost


@compiled
def jitter_information(
    jacobians: StereoJacobians,
    weights: FeatureWeights,
    jitter: LinearizedJitter,
    disparity_share: FloatArray,
    hessian: FloatArray,
    information: FloatArray,
) -> None:
    """Fill in the jitter's blocks of Σ w (J, D)ᵀ Σ⁻¹ (J, D), [12, 12], without the prior of η.

    In the information, w is the curvature of the loss.

    Args:
        jacobians: the residuals linearised.
        weights: their robust weights.
        jitter: where it was linearised.
        disparity_share: factor of the translation's columns of J in the information, [N].
        hessian: filled in, with the weights.
        information: filled in, with their curvature.
    """
    cross = np.zeros((6, JITTER_PAIR_DIM))
    square = np.zeros((JITTER_PAIR_DIM, JITTER_PAIR_DIM))
    curved_cross = np.zeros((6, JITTER_PAIR_DIM))
    curved_square = np.zeros((JITTER_PAIR_DIM, JITTER_PAIR_DIM))
    for n in range(len(weights.weight)):
        weight = weights.weight[n]
        curvature = weights.curvature[n]
        J = jacobians.motion[n]
        white = jitter.white[n]
        for i in range(6):
            # The translation's columns, as in ``stereo_numba.sum_information``.
            share = curvature * disparity_share[n] if i < 3 else curvature
            for k in range(JITTER_PAIR_DIM):
                product = J[0, i] * white[0, k] + J[1, i] * white[1, k]
                product += J[2, i] * white[2, k] + J[3, i] * white[3, k]
                cross[i, k] += weight * product
                curved_cross[i, k] += share * product
        # η × η: Dᵀ Σ⁻¹ D was formed when the jitter was linearised.
        for k in range(JITTER_PAIR_DIM):
            for j in range(k + 1):
                square[k, j] += weight * jitter.square[n, k, j]
                curved_square[k, j] += curvature * jitter.square[n, k, j]
    _set_blocks(cross, square, hessian)
    _set_blocks(curved_cross, curved_square, information)
