"""The compiled loops over the stereo observations of a frame: residuals e = y' − f(T g(y)), their
Jacobians, noise and normal equations.

One pass over N features at a time; a feature is a row of each array. With h the map f(T ·) from
s = (u, v, d) in the previous frame to the observation y' in the current one, these loops work at a
point s that is refined by both observations (see ``propagate_noise``).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.transfer_numba import NEAREST, Intrinsics, move_point
from probevo.compiled import compiled, invert_symmetric_4
from probevo.measurements.robust_loss_numba import (
    INFINITE_DOF,
    RESIDUAL_DIM,
    STUDENT_T,
    robust_bend,
    robust_cost,
    robust_curvature,
    robust_weight,
)

BEHIND = 1e4
"""Squared Mahalanobis distance assigned to a point that does not contribute: an outlier for any
loss, but small enough to be summed."""


class PointPairs(NamedTuple):
    """N points: their estimates by earlier frames, and their observations in the current frame."""

    point: FloatArray
    """s = (u, v, d) in the previous frame, [N, 3], px."""
    point_cov: FloatArray
    """P, the scale matrix of (u, v, d, δ), [N, 4, 4], px². δ is the error of the measured disparity
    that is the same in both frames (time-correlated)."""
    curr: FloatArray
    """y', less the bias and the estimate of δ, [N, 4], px."""
    curr_scale: FloatArray
    """R', the scale matrix of y' alone, [N, 4, 4], px²."""


class PropagatedNoise(NamedTuple):
    """The noise of N residuals at one motion, and the points at which they are linearised."""

    refined: FloatArray
    """ŝ, the most likely (u, v, d) given both observations, [N, 3], px."""
    offset: FloatArray
    """A (s − ŝ), by which the residual at ŝ differs from the one at s, [N, 4], px."""
    information: FloatArray
    """Σ⁻¹, [N, 4, 4], px⁻²; zero where the point is behind the camera."""
    cross_cov: FloatArray
    """Cross-covariance of the residual with (d, δ), [N, 4, 2], px²."""


class LossParameters(NamedTuple):
    """The robust loss of N residuals."""

    kind: int
    """A ``LossKind``."""
    parameter: FloatArray
    """Parameter of the loss for each residual, [N]: ν of a Student-t, k of Huber, c of Cauchy and
    Tukey."""


class NormalEquations(NamedTuple):
    """Hessian · ξ = gradient, for a left perturbation ξ = [ρ; φ] of the motion."""

    hessian: FloatArray
    """[6, 6]."""
    gradient: FloatArray
    """Σ w Jᵀ Σ⁻¹ e, [6]: the direction of descent."""
    squared: FloatArray
    """s = eᵀ Σ⁻¹ e of each residual, [N]."""


class StereoJacobians(NamedTuple):
    """Residuals and their derivatives; zero behind the camera, except for the squared lengths."""

    residual: FloatArray
    """e, [N, 4], px."""
    motion: FloatArray
    """J = ∂h/∂ξ, [N, 4, 6], px/m and px/rad."""
    white: FloatArray
    """Σ⁻¹ J, [N, 4, 6]."""
    disparity: FloatArray
    """∂h/∂d, how the disparity in the previous frame moves the prediction, [N, 4]."""
    squared: FloatArray
    """s = eᵀ Σ⁻¹ e, [N]; ``BEHIND`` for a point that does not contribute."""
    contributes: BoolArray
    """Which points contribute, [N]: those in front of the camera whose Σ is positive definite."""


class FeatureWeights(NamedTuple):
    """Weights of N residuals under a robust loss."""

    weight: FloatArray
    """IRLS weight w, [N]; 0 for a point that does not contribute."""
    curvature: FloatArray
    """a = w + (2/d) w' s, [N], the second derivative of the loss averaged over directions."""
    relative: FloatArray
    """w over that of a perfect residual, [N], 0 to 1."""


@compiled
def propagate_noise(
    T: FloatArray, camera: Intrinsics, pairs: PointPairs, propagated: PropagatedNoise
) -> None:
    """Fold the noise of the triangulated points into that of the residuals, at T_curr_prev [4, 4].

    With A = ∂h/∂s, the residual e = y' − h(s) has the scale Σ = R' + A S Aᵀ. The most likely true s
    given both observations, ŝ = s + S Aᵀ Σ⁻¹ e, is where the solver then linearises: at the noisy s
    itself the Jacobian would correlate with the residual, which shortens the motion estimated from
    small disparities (errors-in-variables attenuation). For points whose noise is not propagated,
    S = 0 and nothing changes.

    A time-correlated error δ of the disparity, the same in both frames, moves y' along
    −(0, 0, 1, 0), so that s and δ are treated jointly: with P their covariance and
    H = [A, −(0, 0, 1, 0)], Σ = R' + H P Hᵀ. For a point with a single observation, d and δ have
    opposite errors of variance τ², and Σ = R' + A S Aᵀ + τ² l lᵀ with l = −(0, 0, 1, 0) − ∂h/∂d.
    Stereo matching has such errors: a window across an edge is matched just as wrongly in the next
    frame.

    ``propagated.refined`` is where to linearise on entry; all of ``propagated`` is filled in.
    """
    fu, fv, cu, cv, fb = camera
    point = pairs.point
    curr = pairs.curr
    scale = pairs.curr_scale
    refined = propagated.refined
    offset = propagated.offset
    information = propagated.information
    cross_cov = propagated.cross_cov
    A = np.empty((3, 3))
    HP = np.empty((3, 4))
    projected = np.empty((3, 3))  # rows u_l, v, u_r: v_l and v_r are alike
    sigma = np.empty((4, 4))
    lower = np.zeros((4, 4))
    e = np.empty(4)
    g = np.empty(4)
    for n in range(len(point)):
        X, Y, Z, rho = move_point(T, camera, refined[n])
        if Z < NEAREST:
            information[n] = 0.0
            continue
        iz = 1.0 / Z
        # q = C m + ρ t is the point in the current frame over its depth in the previous one.
        # What the current left image should show, from the principal point on, and the disparity.
        u = fu * X * iz
        v = fv * Y * iz
        d = fb * rho * iz
        u_x = fu * iz  # ∂u/∂q_x
        v_y = fv * iz  # ∂v/∂q_y
        per_d = iz / fb  # ∂ρ/∂d over q_z
        # Columns of A: a change of u, v, d moves q = C m + ρ t along C's columns and t. The first
        # term of each entry is from the numerator of u = f_u q_x/q_z, the second from q_z.
        A[0, 0] = (u_x * T[0, 0] - u * iz * T[2, 0]) / fu
        A[0, 1] = (u_x * T[0, 1] - u * iz * T[2, 1]) / fv
        A[0, 2] = (fu * T[0, 3] - u * T[2, 3]) * per_d
        A[1, 0] = (v_y * T[1, 0] - v * iz * T[2, 0]) / fu
        A[1, 1] = (v_y * T[1, 1] - v * iz * T[2, 1]) / fv
        A[1, 2] = (fv * T[1, 3] - v * T[2, 3]) * per_d
        # u_r = u_l − d, where d = f_u b ρ/q_z depends on the disparity before directly, and on q_z.
        A[2, 0] = A[0, 0] + d * iz * T[2, 0] / fu
        A[2, 1] = A[0, 1] + d * iz * T[2, 1] / fv
        A[2, 2] = A[0, 2] - iz + d * T[2, 3] * per_d
        P = pairs.point_cov[n]
        # H P, and with it H P Hᵀ: the rows of H are those of A, less 1 for δ in the row of u_r.
        for i in range(3):
            for j in range(4):
                HP[i, j] = A[i, 0] * P[0, j] + A[i, 1] * P[1, j] + A[i, 2] * P[2, j]
                if i == 2:
                    HP[i, j] -= P[3, j]
        for i in range(3):
            for j in range(i + 1):
                product = HP[i, 0] * A[j, 0] + HP[i, 1] * A[j, 1] + HP[i, 2] * A[j, 2]
                if j == 2:
                    product -= HP[i, 3]
                projected[i, j] = product
                projected[j, i] = product
        # Σ = R' + H P Hᵀ, its lower triangle. v_l and v_r are predicted alike, so that row 1 of the
        # products stands for both.
        for i in range(4):
            row = i if i < 3 else 1
            cross_cov[n, i, 0] = HP[row, 2]
            cross_cov[n, i, 1] = HP[row, 3]
            for j in range(i + 1):
                column = j if j < 3 else 1
                sigma[i, j] = scale[n, i, j] + projected[row, column]
        # e is the residual at s, to first order around the point of linearisation.
        _set_offset(A, point[n], refined[n], offset[n])
        if not invert_symmetric_4(sigma, information[n], lower):
            information[n] = 0.0
            continue
        # The refined point, the Kalman update ŝ = s + P Hᵀ Σ⁻¹ e: row 1 of H P serves v_l and v_r.
        e[0] = curr[n, 0] - (u + cu) - offset[n, 0]
        e[1] = curr[n, 1] - (v + cv) - offset[n, 1]
        e[2] = curr[n, 2] - (u - d + cu) - offset[n, 2]
        e[3] = curr[n, 3] - (v + cv) - offset[n, 3]
        W = information[n]
        for i in range(4):
            g[i] = W[i, 0] * e[0] + W[i, 1] * e[1] + W[i, 2] * e[2] + W[i, 3] * e[3]
        for j in range(3):
            refined[n, j] = (
                point[n, j] + HP[0, j] * g[0] + HP[1, j] * (g[1] + g[3]) + HP[2, j] * g[2]
            )
        # From here on, ŝ is the point of linearisation; A is still that of the one before, which
        # the next propagation corrects.
        _set_offset(A, point[n], refined[n], offset[n])


@compiled
def _set_offset(A: FloatArray, point: FloatArray, refined: FloatArray, offset: FloatArray) -> None:
    """Fill offset [4] with A (s − ŝ), the rows v_l and v_r alike."""
    x = point[0] - refined[0]
    y = point[1] - refined[1]
    z = point[2] - refined[2]
    offset[0] = A[0, 0] * x + A[0, 1] * y + A[0, 2] * z
    offset[1] = offset[3] = A[1, 0] * x + A[1, 1] * y + A[1, 2] * z
    offset[2] = A[2, 0] * x + A[2, 1] * y + A[2, 2] * z


@compiled
def normal_equations(
    T: FloatArray,
    camera: Intrinsics,
    curr: FloatArray,
    propagated: PropagatedNoise,
    loss: LossParameters,
    newton: bool,
    system: NormalEquations,
) -> float:
    """Fill the normal equations of Σ ρ(eᵀ Σ⁻¹ e) in one pass over the features; return the cost.

    The Hessian is that of iteratively reweighted least squares, Σ w Jᵀ Σ⁻¹ J, which never
    overshoots. With ``newton``, near the optimum, it is Newton's, with 2 w' (Jᵀ Σ⁻¹ e)(Jᵀ Σ⁻¹ e)ᵀ
    added: where two groups of features pull apart, IRLS needs 40 steps and Newton 4.

    All 3 × 3 products are written out and the sums are scalars, so that no feature needs a loop or
    an array of its own.
    """
    fu, fv, cu, cv, fb = camera
    refined = propagated.refined
    offset = propagated.offset
    information = propagated.information
    kind = loss.kind
    parameter = loss.parameter
    hessian = system.hessian
    gradient = system.gradient
    squared = system.squared
    cost = 0.0
    # Most models give all features one ν. The sum of their log(1 + s/ν) is then the logarithm of a
    # product, which is taken only before the product overflows. −1 is the ν of no feature.
    product = 1.0
    common_dof = parameter[0] if len(parameter) > 0 and parameter[0] < INFINITE_DOF else -1.0
    t00 = t01 = t02 = t11 = t12 = t22 = 0.0  # translation block
    m00 = m01 = m02 = m10 = m11 = m12 = m20 = m21 = m22 = 0.0  # translation × rotation
    r00 = r01 = r02 = r11 = r12 = r22 = 0.0  # rotation block
    gt0 = gt1 = gt2 = gr0 = gr1 = gr2 = 0.0
    for n in range(len(refined)):
        X, Y, Z, rho = move_point(T, camera, refined[n])
        if Z < NEAREST:
            # It costs as much as an outlier: otherwise a motion that takes points behind the camera
            # would be rewarded.
            squared[n] = BEHIND
            cost += robust_cost(kind, parameter[n], BEHIND)
            continue
        iz = 1.0 / Z
        u = fu * X * iz
        v = fv * Y * iz
        d = fb * rho * iz
        # e = y' − h(ŝ) − A (s − ŝ): the residual at s, to first order around ŝ.
        e0 = curr[n, 0] - (u + cu) - offset[n, 0]
        e1 = curr[n, 1] - (v + cv) - offset[n, 1]
        e2 = curr[n, 2] - (u - d + cu) - offset[n, 2]
        e3 = curr[n, 3] - (v + cv) - offset[n, 3]
        # g = Σ⁻¹ e, and s = eᵀ g. Σ⁻¹ is zero where the point was behind the camera when the noise
        # was propagated.
        W = information[n]
        g0 = W[0, 0] * e0 + W[0, 1] * e1 + W[0, 2] * e2 + W[0, 3] * e3
        g1 = W[1, 0] * e0 + W[1, 1] * e1 + W[1, 2] * e2 + W[1, 3] * e3
        g2 = W[2, 0] * e0 + W[2, 1] * e1 + W[2, 2] * e2 + W[2, 3] * e3
        g3 = W[3, 0] * e0 + W[3, 1] * e1 + W[3, 2] * e2 + W[3, 3] * e3
        s = e0 * g0 + e1 * g1 + e2 * g2 + e3 * g3 if W[0, 0] > 0.0 else BEHIND
        squared[n] = s
        if kind == STUDENT_T and parameter[n] == common_dof:
            product *= 1.0 + s / common_dof
            if product > 1e250:
                cost += 0.5 * (common_dof + RESIDUAL_DIM) * math.log(product)
                product = 1.0
        else:
            cost += robust_cost(kind, parameter[n], s)
        w = robust_weight(kind, parameter[n], s)
        # Both image rows move alike, so the information of v_l and v_r folds into one row v
        w00 = w * W[0, 0]
        w01 = w * (W[0, 1] + W[0, 3])
        w02 = w * W[0, 2]
        w11 = w * (W[1, 1] + 2.0 * W[1, 3] + W[3, 3])
        w12 = w * (W[1, 2] + W[3, 2])
        w22 = w * W[2, 2]
        g0 = w * g0
        g1 = w * (g1 + g3)
        g2 = w * g2
        # Rows of F = ∂f/∂q: u_l (u_x, 0, u_z), v (0, v_y, v_z), u_r (u_x, 0, r_z). By q alone, the
        # Hessian is H = Fᵀ w Σ⁻¹ F, and the gradient (q0, q1, q2) = Fᵀ w Σ⁻¹ e.
        u_x = fu * iz
        u_z = -u * iz
        v_y = fv * iz
        v_z = -v * iz
        r_z = -(u - d) * iz
        # (k0, k1, k2) is w Σ⁻¹, its rows folded, times the third column of F, (u_z, v_z, r_z).
        k0 = w00 * u_z + w01 * v_z + w02 * r_z
        k1 = w01 * u_z + w11 * v_z + w12 * r_z
        k2 = w02 * u_z + w12 * v_z + w22 * r_z
        H00 = u_x * u_x * (w00 + 2.0 * w02 + w22)
        H01 = u_x * v_y * (w01 + w12)
        H02 = u_x * (k0 + k2)
        H11 = v_y * v_y * w11
        H12 = v_y * k1
        H22 = u_z * k0 + v_z * k1 + r_z * k2
        q0 = u_x * (g0 + g2)
        q1 = v_y * g1
        q2 = u_z * g0 + v_z * g1 + r_z * g2
        # Newton's term 2 w' (Fᵀ Σ⁻¹ e)(Fᵀ Σ⁻¹ e)ᵀ, by the weighted gradient: bend is −2 w'/w²,
        # which is positive as w falls with s.
        if newton:
            bend = robust_bend(kind, parameter[n], s)
            H00 = H00 - bend * q0 * q0
            H01 = H01 - bend * q0 * q1
            H02 = H02 - bend * q0 * q2
            H11 = H11 - bend * q1 * q1
            H12 = H12 - bend * q1 * q2
            H22 = H22 - bend * q2 * q2
        # From q to ξ: q moves by ρ δt + φ × q, so that the translation block is ρ² H, the mixed one
        # ρ M with M = H (−q^), and the rotation block (−q^)ᵀ M.
        M00 = Y * H02 - Z * H01
        M01 = Z * H00 - X * H02
        M02 = X * H01 - Y * H00
        M10 = Y * H12 - Z * H11
        M11 = Z * H01 - X * H12
        M12 = X * H11 - Y * H01
        M20 = Y * H22 - Z * H12
        M21 = Z * H02 - X * H22
        M22 = X * H12 - Y * H02
        # Sum up the blocks, of the symmetric ones the upper triangle only; the gradients
        # are ρ Fᵀ w Σ⁻¹ e and q × Fᵀ w Σ⁻¹ e.
        rho_2 = rho * rho
        t00 += rho_2 * H00
        t01 += rho_2 * H01
        t02 += rho_2 * H02
        t11 += rho_2 * H11
        t12 += rho_2 * H12
        t22 += rho_2 * H22
        m00 += rho * M00
        m01 += rho * M01
        m02 += rho * M02
        m10 += rho * M10
        m11 += rho * M11
        m12 += rho * M12
        m20 += rho * M20
        m21 += rho * M21
        m22 += rho * M22
        r00 += Y * M20 - Z * M10
        r01 += Y * M21 - Z * M11
        r02 += Y * M22 - Z * M12
        r11 += Z * M01 - X * M21
        r12 += Z * M02 - X * M22
        r22 += X * M12 - Y * M02
        gt0 += rho * q0
        gt1 += rho * q1
        gt2 += rho * q2
        gr0 += Y * q2 - Z * q1
        gr1 += Z * q0 - X * q2
        gr2 += X * q1 - Y * q0
    if product > 1.0:
        cost += 0.5 * (common_dof + RESIDUAL_DIM) * math.log(product)
    # The order of ξ = [ρ; φ]: translation first. Above the diagonal first, then mirrored.
    hessian[0, 0] = t00
    hessian[0, 1] = t01
    hessian[0, 2] = t02
    hessian[1, 1] = t11
    hessian[1, 2] = t12
    hessian[2, 2] = t22
    hessian[0, 3] = m00
    hessian[0, 4] = m01
    hessian[0, 5] = m02
    hessian[1, 3] = m10
    hessian[1, 4] = m11
    hessian[1, 5] = m12
    hessian[2, 3] = m20
    hessian[2, 4] = m21
    hessian[2, 5] = m22
    hessian[3, 3] = r00
    hessian[3, 4] = r01
    hessian[3, 5] = r02
    hessian[4, 4] = r11
    hessian[4, 5] = r12
    hessian[5, 5] = r22
    for i in range(6):
        for j in range(i):
            hessian[i, j] = hessian[j, i]
    gradient[0] = gt0
    gradient[1] = gt1
    gradient[2] = gt2
    gradient[3] = gr0
    gradient[4] = gr1
    gradient[5] = gr2
    return cost


@compiled
def residual_jacobians(
    T: FloatArray,
    camera: Intrinsics,
    curr: FloatArray,
    propagated: PropagatedNoise,
    out: StereoJacobians,
) -> None:
    """Fill in the residuals and Jacobians of all features at T_curr_prev [4, 4]."""
    fu, fv, cu, cv, fb = camera
    refined = propagated.refined
    offset = propagated.offset
    information = propagated.information
    residual = out.residual
    motion = out.motion
    white = out.white
    disparity = out.disparity
    F = np.zeros((4, 3))
    for n in range(len(refined)):
        X, Y, Z, rho = move_point(T, camera, refined[n])
        if Z < NEAREST:
            residual[n] = 0.0
            motion[n] = 0.0
            white[n] = 0.0
            disparity[n] = 0.0
            out.squared[n] = BEHIND
            out.contributes[n] = False
            continue
        # e = y' − h(ŝ) − A (s − ŝ), as in ``normal_equations``, and its squared length.
        u = fu * X / Z
        v = fv * Y / Z
        d = fb * rho / Z
        residual[n, 0] = curr[n, 0] - (u + cu) - offset[n, 0]
        residual[n, 1] = curr[n, 1] - (v + cv) - offset[n, 1]
        residual[n, 2] = curr[n, 2] - (u - d + cu) - offset[n, 2]
        residual[n, 3] = curr[n, 3] - (v + cv) - offset[n, 3]
        squared = 0.0
        for i in range(4):
            total = 0.0
            for k in range(4):
                total += information[n, i, k] * residual[n, k]
            squared += residual[n, i] * total
        out.contributes[n] = information[n, 0, 0] > 0.0
        out.squared[n] = squared if out.contributes[n] else BEHIND
        # F = ∂f/∂q. The left perturbation moves q by ρ δt + φ × q (ρ the inverse depth), and a
        # change of d moves it by t/(f_u b); d itself also stands in u_r = u_l − f_u b ρ/q_z.
        F[0, 0] = F[2, 0] = fu / Z
        F[1, 1] = F[3, 1] = fv / Z
        F[0, 2] = -u / Z
        F[1, 2] = -v / Z
        F[2, 2] = -(u - d) / Z
        F[3, 2] = -v / Z
        for i in range(4):
            motion[n, i, 0] = rho * F[i, 0]
            motion[n, i, 1] = rho * F[i, 1]
            motion[n, i, 2] = rho * F[i, 2]
            motion[n, i, 3] = Y * F[i, 2] - Z * F[i, 1]
            motion[n, i, 4] = Z * F[i, 0] - X * F[i, 2]
            motion[n, i, 5] = X * F[i, 1] - Y * F[i, 0]
            disparity[n, i] = (F[i, 0] * T[0, 3] + F[i, 1] * T[1, 3] + F[i, 2] * T[2, 3]) / fb
        disparity[n, 2] -= 1.0 / Z
        # Σ⁻¹ J.
        for i in range(4):
            for j in range(6):
                total = 0.0
                for k in range(4):
                    total += information[n, i, k] * motion[n, k, j]
                white[n, i, j] = total


@compiled
def weigh(
    loss: LossParameters, squared: FloatArray, contributes: BoolArray, weights: FeatureWeights
) -> tuple[float, float]:
    """Fill in the weights of residuals of squared lengths [N], of which some contribute [N].

    Returns Σ w² s / d, the scatter of the gradient, and Σ a.
    """
    scatter = 0.0
    curved = 0.0
    for n in range(len(squared)):
        s = squared[n]
        if not contributes[n]:
            weights.weight[n] = 0.0
            weights.curvature[n] = 0.0
            weights.relative[n] = 0.0
            continue
        # The sandwich A⁻¹ B A⁻¹ needs the curvature a for A and the scatter w² s/d for B
        # (``StereoObservations._variance_factor``).
        weight = robust_weight(loss.kind, loss.parameter[n], s)
        weights.weight[n] = weight
        weights.curvature[n] = robust_curvature(
            loss.kind, loss.parameter[n], s, dimension=RESIDUAL_DIM
        )
        weights.relative[n] = weight / robust_weight(loss.kind, loss.parameter[n], 0.0)
        scatter += weight * weight * s / RESIDUAL_DIM
        curved += weights.curvature[n]
    return scatter, curved


@compiled
def sum_information(
    jacobians: StereoJacobians,
    weights: FeatureWeights,
    disparity_share: FloatArray,
    disparity_noise_share: FloatArray,
    hessian: FloatArray,
    information: FloatArray,
) -> None:
    """Fill hessian, Σ w Jᵀ Σ⁻¹ J, and information, Σ a Jᵀ Σ⁻¹ J, [6, 6] each, the first rows and
    columns where they are larger.

    In the information, the translation's columns of J are scaled by ``disparity_share`` [N], and
    their square is reduced by ``disparity_noise_share`` [N]
    (``StereoObservations._information``).
    """
    hessian[:] = 0.0
    information[:] = 0.0
    for n in range(len(jacobians.motion)):
        curvature = weights.curvature[n]
        # Factors of the blocks translation × translation and translation × rotation.
        translation_factor = curvature * (
            disparity_share[n] * disparity_share[n] - disparity_noise_share[n]
        )
        mixed_factor = curvature * disparity_share[n]
        for i in range(6):
            for j in range(i + 1):
                product = 0.0
                for k in range(4):
                    product += jacobians.motion[n, k, i] * jacobians.white[n, k, j]
                hessian[i, j] += weights.weight[n] * product
                # j ≤ i: translations come first in ξ.
                factor = curvature
                if i < 3:
                    factor = translation_factor
                elif j < 3:
                    factor = mixed_factor
                information[i, j] += factor * product
    for i in range(6):
        for j in range(i):
            hessian[j, i] = hessian[i, j]
            information[j, i] = information[i, j]
