"""Compiled inner loops of the reprojection solve.

A point is carried as its ray m and inverse depth ρ = d/(f_u b) rather than as p = m/ρ, so that T acts as
q = C m + ρ t and nothing is singular for a point at infinity: far features keep their say about rotation.
"""

from __future__ import annotations

import math
from enum import IntEnum
from typing import Any

import numpy as np
from numba import njit

from probevo.arrays import FloatArray

COMPILED: dict[str, Any] = {"cache": True, "error_model": "numpy", "fastmath": {"contract", "reassoc", "nsz", "arcp"}}
"""Options of every kernel: kept on disk, divisions unchecked, sums free to be reordered but NaN and inf still honoured."""
NEAREST = 1e-3
"""A point whose scaled depth q_z falls below this is behind the camera or in it, and has no say."""
BEHIND = 1e4
"""Squared Mahalanobis length given to a point that has no say: far enough for any loss, near enough to add up with others."""


class LossKind(IntEnum):
    """Robust losses ρ(s) of the squared Mahalanobis length s of a residual."""

    L2 = 0
    HUBER = 1
    CAUCHY = 2
    TUKEY = 3
    STUDENT_T = 4


@njit(**COMPILED)
def robust_weight(kind: int, parameter: float, dim: int, squared: float) -> float:
    """IRLS weight 2 dρ/ds, one for a perfect residual of every loss but Student-t, where it is (ν + d)/(ν + s)."""
    if kind == 4:
        return (parameter + dim) / (parameter + squared) if parameter < 1e300 else 1.0
    if kind == 1:
        return 1.0 if squared <= parameter * parameter else parameter / math.sqrt(squared)
    if kind == 2:
        return 1.0 / (1.0 + squared / (parameter * parameter))
    if kind == 3:
        inside = 1.0 - squared / (parameter * parameter)
        return inside * inside if inside > 0.0 else 0.0
    return 1.0


@njit(**COMPILED)
def robust_curvature(kind: int, parameter: float, dim: int, squared: float) -> float:
    """w + (2/d) w' s: the second derivative of the loss, averaged over the directions of the residual.

    At least a quarter of the weight, so that it can stand in a Hessian (Tukey's goes negative).
    """
    weight = robust_weight(kind, parameter, dim, squared)
    share = 0.0  # −w' s / w
    if kind == 4:
        share = squared / (parameter + squared) if parameter < 1e300 else 0.0
    elif kind == 1:
        share = 0.5 if squared > parameter * parameter else 0.0
    elif kind == 2:
        share = squared / (parameter * parameter + squared)
    elif kind == 3:
        share = 2.0 * squared / max(parameter * parameter - squared, 1e-12)
    return weight * max(0.25, 1.0 - 2.0 / dim * share)


@njit(**COMPILED)
def robust_bend(kind: int, parameter: float, squared: float) -> float:
    """−2 w'/w²: how much of the outer product of a residual's weighted gradient the exact Hessian of its loss is less by."""
    if kind == 4:
        return 2.0 / (parameter + 4.0)
    if kind == 1:
        return 1.0 / (parameter * math.sqrt(squared)) if squared > parameter * parameter else 0.0
    if kind == 2:
        return 2.0 / (parameter * parameter)
    if kind == 3:
        inside = max(0.1, 1.0 - squared / (parameter * parameter))
        return 4.0 / (parameter * parameter * inside * inside * inside)
    return 0.0


@njit(**COMPILED)
def robust_cost(kind: int, parameter: float, dim: int, squared: float) -> float:
    """ρ(s), scaled such that L2 is s/2."""
    if kind == 4:
        return 0.5 * (parameter + dim) * math.log1p(squared / parameter) if parameter < 1e300 else 0.5 * squared
    if kind == 1:
        if squared <= parameter * parameter:
            return 0.5 * squared
        return parameter * (math.sqrt(squared) - 0.5 * parameter)
    if kind == 2:
        return 0.5 * parameter * parameter * math.log1p(squared / (parameter * parameter))
    if kind == 3:
        inside = max(0.0, 1.0 - squared / (parameter * parameter))
        return parameter * parameter / 6.0 * (1.0 - inside * inside * inside)
    return 0.5 * squared


@njit(**COMPILED)
def _invert_symmetric_4(matrix: FloatArray, inverse: FloatArray, lower: FloatArray) -> bool:
    """Inverse of a 4×4 symmetric positive definite matrix by Cholesky; False if it is not one."""
    for i in range(4):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 0.0:
                    return False
                lower[i, i] = math.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    for column in range(4):  # lower ← its own inverse, column by column
        lower[column, column] = 1.0 / lower[column, column]
        for i in range(column + 1, 4):
            total = 0.0
            for k in range(column, i):
                total -= lower[i, k] * lower[k, column]
            lower[i, column] = total / lower[i, i]
    for i in range(4):
        for j in range(i + 1):
            total = 0.0
            for k in range(i, 4):
                total += lower[k, i] * lower[k, j]
            inverse[i, j] = inverse[j, i] = total
    return True


@njit(**COMPILED)
def linearize_noise(
    C: FloatArray,
    t: FloatArray,
    camera: FloatArray,
    seen: FloatArray,
    point_cov: FloatArray,
    curr: FloatArray,
    scale: FloatArray,
    refined: FloatArray,
    offset: FloatArray,
    information: FloatArray,
) -> None:
    """Fold the noise of the triangulated points into that of the residuals, at the motion (C, t).

    With h the map from s = (u, v, d) in the previous frame to y' in the current one and A = ∂h/∂s, the residual
    e = y' − h(s) has the scale Σ = R' + A S Aᵀ. The most likely true s given both observations, ŝ = s + S Aᵀ Σ⁻¹ e, is where
    the solver then linearises: at the noisy s itself the Jacobian would correlate with the residual, which shortens the
    motion estimated from small disparities (errors-in-variables attenuation). For points whose noise is not
    propagated, S = 0 and nothing changes.

    Args:
        C, t: current estimate of the motion, [3, 3], [3].
        camera: (fu, fv, cu, cv, fu b).
        seen: s of each point, [N, 3], px.
        point_cov: S, [N, 3, 3], px².
        curr: y', bias removed, [N, 4], px.
        scale: R', [N, 4, 4], px².
        refined: in and out, ŝ, [N, 3], px.
        offset: out, A (s − ŝ), by which the residual at ŝ differs from the one at s, [N, 4], px.
        information: out, Σ⁻¹, [N, 4, 4]; zero where the point is behind the camera.
    """
    fu, fv, cu, cv, fb = camera
    A = np.zeros((4, 3))
    AS = np.empty((4, 3))
    sigma = np.empty((4, 4))
    lower = np.zeros((4, 4))
    e = np.empty(4)
    for n in range(len(seen)):
        mx, my, rho = (refined[n, 0] - cu) / fu, (refined[n, 1] - cv) / fv, refined[n, 2] / fb
        X = C[0, 0] * mx + C[0, 1] * my + C[0, 2] + rho * t[0]
        Y = C[1, 0] * mx + C[1, 1] * my + C[1, 2] + rho * t[1]
        Z = C[2, 0] * mx + C[2, 1] * my + C[2, 2] + rho * t[2]
        if Z < NEAREST:
            information[n] = 0.0
            continue
        iz = 1.0 / Z
        u, v, d = fu * X * iz, fv * Y * iz, fb * rho * iz
        for k in range(3):  # columns: ∂/∂u, ∂/∂v, ∂/∂d of the previous frame
            if k == 0:
                gx, gy, gz, grho = C[0, 0] / fu, C[1, 0] / fu, C[2, 0] / fu, 0.0
            elif k == 1:
                gx, gy, gz, grho = C[0, 1] / fv, C[1, 1] / fv, C[2, 1] / fv, 0.0
            else:
                gx, gy, gz, grho = t[0] / fb, t[1] / fb, t[2] / fb, 1.0
            A[0, k] = (fu * gx - u * gz) * iz
            A[1, k] = A[3, k] = (fv * gy - v * gz) * iz
            A[2, k] = A[0, k] - (grho - d * gz) * iz
        for i in range(4):
            offset[n, i] = 0.0
            for j in range(3):
                offset[n, i] += A[i, j] * (seen[n, j] - refined[n, j])
                AS[i, j] = 0.0
                for k in range(3):
                    AS[i, j] += A[i, k] * point_cov[n, k, j]
        for i in range(4):
            for j in range(4):
                sigma[i, j] = scale[n, i, j]
                for k in range(3):
                    sigma[i, j] += AS[i, k] * A[j, k]
        if not _invert_symmetric_4(sigma, information[n], lower):
            information[n] = 0.0
            continue
        e[0] = curr[n, 0] - (u + cu) - offset[n, 0]
        e[1] = curr[n, 1] - (v + cv) - offset[n, 1]
        e[2] = curr[n, 2] - (u - d + cu) - offset[n, 2]
        e[3] = curr[n, 3] - (v + cv) - offset[n, 3]
        for j in range(3):
            step = 0.0
            for i in range(4):
                for k in range(4):
                    step += AS[i, j] * information[n, i, k] * e[k]
            refined[n, j] = seen[n, j] + step
        for i in range(4):
            offset[n, i] = 0.0
            for j in range(3):
                offset[n, i] += A[i, j] * (seen[n, j] - refined[n, j])


@njit(**COMPILED)
def normal_equations(
    C: FloatArray,
    t: FloatArray,
    camera: FloatArray,
    refined: FloatArray,
    offset: FloatArray,
    curr: FloatArray,
    information: FloatArray,
    kind: int,
    parameter: FloatArray,
    near: bool,
    hessian: FloatArray,
    gradient: FloatArray,
    squared: FloatArray,
) -> float:
    """One pass over the features: normal equations of Σ ρ(eᵀ Σ⁻¹ e) for a left perturbation ξ = [ρ; φ] of T.

    Fills hessian [6, 6], gradient [6] (Σ w Jᵀ Σ⁻¹ e with J = ∂h/∂ξ) and squared [N] (eᵀ Σ⁻¹ e), and returns the cost. The
    Hessian is that of IRLS, Σ w Jᵀ Σ⁻¹ J, which never overshoots; ``near`` the optimum it is Newton's, with
    2 w' (Jᵀ Σ⁻¹ e)(Jᵀ Σ⁻¹ e)ᵀ added: where two groups of features pull apart, IRLS needs 40 steps and Newton 4.
    """
    fu, fv, cu, cv, fb = camera
    cost = 0.0
    t00 = t01 = t02 = t11 = t12 = t22 = 0.0  # translation block
    m00 = m01 = m02 = m10 = m11 = m12 = m20 = m21 = m22 = 0.0  # translation × rotation
    r00 = r01 = r02 = r11 = r12 = r22 = 0.0  # rotation block
    gt0 = gt1 = gt2 = gr0 = gr1 = gr2 = 0.0
    for n in range(len(refined)):
        mx, my, rho = (refined[n, 0] - cu) / fu, (refined[n, 1] - cv) / fv, refined[n, 2] / fb
        X = C[0, 0] * mx + C[0, 1] * my + C[0, 2] + rho * t[0]
        Y = C[1, 0] * mx + C[1, 1] * my + C[1, 2] + rho * t[1]
        Z = C[2, 0] * mx + C[2, 1] * my + C[2, 2] + rho * t[2]
        if Z < NEAREST:
            squared[n] = BEHIND
            cost += robust_cost(kind, parameter[n], 4, BEHIND)
            continue
        iz = 1.0 / Z
        u, v, d = fu * X * iz, fv * Y * iz, fb * rho * iz
        e0 = curr[n, 0] - (u + cu) - offset[n, 0]
        e1 = curr[n, 1] - (v + cv) - offset[n, 1]
        e2 = curr[n, 2] - (u - d + cu) - offset[n, 2]
        e3 = curr[n, 3] - (v + cv) - offset[n, 3]
        W = information[n]
        g0 = W[0, 0] * e0 + W[0, 1] * e1 + W[0, 2] * e2 + W[0, 3] * e3
        g1 = W[1, 0] * e0 + W[1, 1] * e1 + W[1, 2] * e2 + W[1, 3] * e3
        g2 = W[2, 0] * e0 + W[2, 1] * e1 + W[2, 2] * e2 + W[2, 3] * e3
        g3 = W[3, 0] * e0 + W[3, 1] * e1 + W[3, 2] * e2 + W[3, 3] * e3
        s = e0 * g0 + e1 * g1 + e2 * g2 + e3 * g3 if W[0, 0] > 0.0 else BEHIND
        squared[n] = s
        cost += robust_cost(kind, parameter[n], 4, s)
        w = robust_weight(kind, parameter[n], 4, s)
        # both image rows move alike, so the information of v_l and v_r folds into one row v
        w00, w01, w02 = w * W[0, 0], w * (W[0, 1] + W[0, 3]), w * W[0, 2]
        w11, w12, w22 = w * (W[1, 1] + 2.0 * W[1, 3] + W[3, 3]), w * (W[1, 2] + W[3, 2]), w * W[2, 2]
        g0, g1, g2 = w * g0, w * (g1 + g3), w * g2
        # rows of ∂f/∂q: u_l (a, 0, b), v (0, c, e), u_r (a, 0, f); H = Fᵀ W F
        a, b, c, e, f = fu * iz, -u * iz, fv * iz, -v * iz, -(u - d) * iz
        k0, k1, k2 = w00 * b + w01 * e + w02 * f, w01 * b + w11 * e + w12 * f, w02 * b + w12 * e + w22 * f
        H00, H01, H02 = a * a * (w00 + 2.0 * w02 + w22), a * c * (w01 + w12), a * (k0 + k2)
        H11, H12, H22 = c * c * w11, c * k1, b * k0 + e * k1 + f * k2
        q0, q1, q2 = a * (g0 + g2), c * g1, b * g0 + e * g1 + f * g2
        if near:
            bend = robust_bend(kind, parameter[n], s)
            H00, H01, H02 = H00 - bend * q0 * q0, H01 - bend * q0 * q1, H02 - bend * q0 * q2
            H11, H12, H22 = H11 - bend * q1 * q1, H12 - bend * q1 * q2, H22 - bend * q2 * q2
        # q moves by ρ δt + φ × q: M = H (−q^), then the rotation block (−q^)ᵀ M
        M00, M01, M02 = Y * H02 - Z * H01, Z * H00 - X * H02, X * H01 - Y * H00
        M10, M11, M12 = Y * H12 - Z * H11, Z * H01 - X * H12, X * H11 - Y * H01
        M20, M21, M22 = Y * H22 - Z * H12, Z * H02 - X * H22, X * H12 - Y * H02
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
    hessian[0, 0], hessian[0, 1], hessian[0, 2], hessian[1, 1], hessian[1, 2], hessian[2, 2] = (
        t00,
        t01,
        t02,
        t11,
        t12,
        t22,
    )
    hessian[0, 3], hessian[0, 4], hessian[0, 5] = m00, m01, m02
    hessian[1, 3], hessian[1, 4], hessian[1, 5] = m10, m11, m12
    hessian[2, 3], hessian[2, 4], hessian[2, 5] = m20, m21, m22
    hessian[3, 3], hessian[3, 4], hessian[3, 5], hessian[4, 4], hessian[4, 5], hessian[5, 5] = (
        r00,
        r01,
        r02,
        r11,
        r12,
        r22,
    )
    for i in range(6):
        for j in range(i):
            hessian[i, j] = hessian[j, i]
    gradient[0], gradient[1], gradient[2] = gt0, gt1, gt2
    gradient[3], gradient[4], gradient[5] = gr0, gr1, gr2
    return cost


@njit(**COMPILED)
def solve_positive_definite(matrix: FloatArray, vector: FloatArray, lower: FloatArray, solution: FloatArray) -> bool:
    """Solve matrix · solution = vector by Cholesky, in the given work space; False if the matrix is not positive definite."""
    n = len(vector)
    for i in range(n):
        for j in range(i + 1):
            total = matrix[i, j]
            for k in range(j):
                total -= lower[i, k] * lower[j, k]
            if i == j:
                if not total > 1e-13 * matrix[i, i]:
                    return False
                lower[i, i] = math.sqrt(total)
            else:
                lower[i, j] = total / lower[j, j]
    for i in range(n):
        total = vector[i]
        for k in range(i):
            total -= lower[i, k] * solution[k]
        solution[i] = total / lower[i, i]
    for i in range(n - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, n):
            total -= lower[k, i] * solution[k]
        solution[i] = total / lower[i, i]
    return True


@njit(**COMPILED)
def perturb(xi: FloatArray, C: FloatArray, t: FloatArray, C_out: FloatArray, t_out: FloatArray) -> None:
    """(C_out, t_out) = Exp(ξ) (C, t), for ξ = [ρ; φ] (thesis eqs. 2.3, 2.14, 2.15)."""
    x, y, z = xi[3], xi[4], xi[5]
    squared = x * x + y * y + z * z
    if squared < 1e-6:  # series: the next terms are below the last bit
        a, b, c = 1.0 - squared / 6.0, 0.5 - squared / 24.0, 1.0 / 6.0 - squared / 120.0
    else:
        angle = math.sqrt(squared)
        a, b = math.sin(angle) / angle, (1.0 - math.cos(angle)) / squared
        c = (1.0 - a) / squared
    wedge = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    wedge_2 = np.array(
        [[x * x - squared, x * y, x * z], [x * y, y * y - squared, y * z], [x * z, y * z, z * z - squared]]
    )
    for i in range(3):
        moved = 0.0
        for k in range(3):
            turn = a * wedge[i, k] + b * wedge_2[i, k]
            left_jacobian = b * wedge[i, k] + c * wedge_2[i, k]
            if i == k:
                turn += 1.0
                left_jacobian += 1.0
            moved += turn * t[k] + left_jacobian * xi[k]
        t_out[i] = moved
        for j in range(3):
            total = C[i, j]
            for k in range(3):
                total += (a * wedge[i, k] + b * wedge_2[i, k]) * C[k, j]
            C_out[i, j] = total


@njit(**COMPILED)
def _rotation_error(C: FloatArray, C_prior: FloatArray, error: FloatArray) -> None:
    """Error φ = Log(C C_priorᵀ), by the angle from both sine and cosine; C is taken to be far from a half turn of C_prior."""
    D = C @ C_prior.T
    x, y, z = 0.5 * (D[2, 1] - D[1, 2]), 0.5 * (D[0, 2] - D[2, 0]), 0.5 * (D[1, 0] - D[0, 1])
    sine, cosine = math.sqrt(x * x + y * y + z * z), 0.5 * (D[0, 0] + D[1, 1] + D[2, 2] - 1.0)
    ratio = math.atan2(sine, cosine) / sine if sine > 1e-9 else 1.0
    error[0], error[1], error[2] = ratio * x, ratio * y, ratio * z


@njit(**COMPILED)
def minimize(
    C: FloatArray,
    t: FloatArray,
    camera: FloatArray,
    seen: FloatArray,
    point_cov: FloatArray,
    curr: FloatArray,
    scale: FloatArray,
    kind: int,
    parameter: FloatArray,
    C_prior: FloatArray,
    prior_information: FloatArray,
    max_iterations: int,
    tolerance: float,
    refined: FloatArray,
    offset: FloatArray,
    information: FloatArray,
    squared: FloatArray,
) -> tuple[int, bool, float]:
    """Levenberg–Marquardt on SE(3) over Σ ρ(eᵀ Σ⁻¹ e) + ½ φᵀ Λ φ, with φ = Log(C C_priorᵀ).

    C and t are the guess on entry and the solution on return; refined, offset, information and squared are those of
    ``linearize_noise`` and ``normal_equations`` there. Σ is renewed after the 1st and the 3rd step and then kept, so that
    the cost is one function near the optimum. Returns the iterations, whether the last
    step was shorter than the tolerance times its own standard deviation, and the cost.
    """
    hessian, gradient = np.empty((6, 6)), np.empty(6)
    trial_hessian, trial_gradient, trial_squared = np.empty((6, 6)), np.empty(6), np.empty(len(squared))
    lower, step, damped = np.zeros((6, 6)), np.zeros(6), np.empty((6, 6))
    trial_C, trial_t, phi = np.empty((3, 3)), np.empty(3), np.empty(3)
    damping, accepted, cost, stale, near = 1e-6, 0, 0.0, True, False
    for iteration in range(max_iterations):
        if stale:
            if accepted == 0 or accepted == 1 or accepted == 3:
                linearize_noise(C, t, camera, seen, point_cov, curr, scale, refined, offset, information)
            cost = normal_equations(
                C, t, camera, refined, offset, curr, information, kind, parameter, near, hessian, gradient, squared
            ) + _add_rotation_prior(C, C_prior, prior_information, hessian, gradient, phi)
            stale = False
        damped[:] = hessian
        for i in range(6):
            damped[i, i] += damping * hessian[i, i]
        if not solve_positive_definite(damped, gradient, lower, step):
            if not near:
                return iteration + 1, False, cost
            near, stale = False, True
            continue
        perturb(step, C, t, trial_C, trial_t)
        trial_cost = normal_equations(
            trial_C, trial_t, camera, refined, offset, curr, information, kind, parameter, accepted > 1 and damping < 1e-3,
            trial_hessian, trial_gradient, trial_squared,
        ) + _add_rotation_prior(trial_C, C_prior, prior_information, trial_hessian, trial_gradient, phi)  # fmt: skip
        if not trial_cost <= cost * (1.0 + 1e-12):
            if near:
                near, stale = False, True
            else:
                damping = max(1e-3, 10.0 * damping)
            continue
        decrement = np.sum(step * gradient)
        C[:], t[:] = trial_C, trial_t
        hessian[:], gradient[:], squared[:] = trial_hessian, trial_gradient, trial_squared
        cost, damping, accepted, near = trial_cost, 0.1 * damping, accepted + 1, accepted > 1 and damping < 1e-3
        stale = accepted == 1 or accepted == 3
        if decrement < tolerance * tolerance and accepted > 1:
            return iteration + 1, True, cost
    return max_iterations, False, cost


@njit(**COMPILED)
def _add_rotation_prior(
    C: FloatArray,
    C_prior: FloatArray,
    prior_information: FloatArray,
    hessian: FloatArray,
    gradient: FloatArray,
    phi: FloatArray,
) -> float:
    """Add ½ φᵀ Λ φ to the normal equations; returns its cost. The Jacobian of Log is taken as 1: φ is small."""
    _rotation_error(C, C_prior, phi)
    cost = 0.0
    for i in range(3):
        for j in range(3):
            hessian[3 + i, 3 + j] += prior_information[i, j]
            gradient[3 + i] -= prior_information[i, j] * phi[j]
            cost += 0.5 * phi[i] * prior_information[i, j] * phi[j]
    return cost


@njit(**COMPILED)
def observation_to_point(
    observed: FloatArray, scale: FloatArray, propagate: bool, seen: FloatArray, point_cov: FloatArray
) -> None:
    """The point s = (u, v, d) behind each stereo observation y, and its scale matrix S.

    With ``propagate``, s is the generalised least-squares estimate of y = H s under the scale R: the two rows are
    averaged by their information, and S = (Hᵀ R⁻¹ H)⁻¹. Without, s averages the rows plainly, as g does, and S stays zero.
    Fills seen [N, 3] from observed [N, 4], px, and point_cov [N, 3, 3] from scale [N, 4, 4], px².
    """
    inverse, lower = np.empty((4, 4)), np.zeros((4, 4))
    right, lower_3, column = np.empty(3), np.zeros((3, 3)), np.zeros(3)
    normal, unit = np.empty((3, 3)), np.zeros(3)
    for n in range(len(observed)):
        seen[n, 0] = observed[n, 0]
        seen[n, 1] = 0.5 * (observed[n, 1] + observed[n, 3])
        seen[n, 2] = observed[n, 0] - observed[n, 2]
        if not propagate or not _invert_symmetric_4(scale[n], inverse, lower):
            continue
        # H maps (u, v, d) to (u, v, u − d, v)
        normal[0, 0] = inverse[0, 0] + 2.0 * inverse[0, 2] + inverse[2, 2]
        normal[1, 1] = inverse[1, 1] + 2.0 * inverse[1, 3] + inverse[3, 3]
        normal[2, 2] = inverse[2, 2]
        normal[0, 1] = normal[1, 0] = inverse[0, 1] + inverse[0, 3] + inverse[2, 1] + inverse[2, 3]
        normal[0, 2] = normal[2, 0] = -inverse[0, 2] - inverse[2, 2]
        normal[1, 2] = normal[2, 1] = -inverse[1, 2] - inverse[3, 2]
        for k in range(4):
            column_k = 0.0
            for j in range(4):
                column_k += inverse[k, j] * observed[n, j]
            if k == 0:
                right[0] = column_k
            elif k == 1:
                right[1] = column_k
            elif k == 2:
                right[0] += column_k
                right[2] = -column_k
            else:
                right[1] += column_k
        solve_positive_definite(normal, right, lower_3, seen[n])
        for j in range(3):
            unit[:] = 0.0
            unit[j] = 1.0
            solve_positive_definite(normal, unit, lower_3, column)
            for i in range(3):
                point_cov[n, i, j] = column[i]


@njit(**COMPILED)
def residual_jacobians(
    C: FloatArray,
    t: FloatArray,
    camera: FloatArray,
    refined: FloatArray,
    offset: FloatArray,
    curr: FloatArray,
    residual: FloatArray,
    motion: FloatArray,
    disparity: FloatArray,
) -> None:
    """Residuals e [N, 4] and what moves h: ∂h/∂ξ, motion [N, 4, 6], and ∂h/∂d, disparity [N, 4]; zero behind the camera."""
    fu, fv, cu, cv, fb = camera
    F = np.zeros((4, 3))
    for n in range(len(refined)):
        mx, my, rho = (refined[n, 0] - cu) / fu, (refined[n, 1] - cv) / fv, refined[n, 2] / fb
        X = C[0, 0] * mx + C[0, 1] * my + C[0, 2] + rho * t[0]
        Y = C[1, 0] * mx + C[1, 1] * my + C[1, 2] + rho * t[1]
        Z = C[2, 0] * mx + C[2, 1] * my + C[2, 2] + rho * t[2]
        if Z < NEAREST:
            residual[n], motion[n], disparity[n] = 0.0, 0.0, 0.0
            continue
        u, v, d = fu * X / Z, fv * Y / Z, fb * rho / Z
        residual[n, 0] = curr[n, 0] - (u + cu) - offset[n, 0]
        residual[n, 1] = curr[n, 1] - (v + cv) - offset[n, 1]
        residual[n, 2] = curr[n, 2] - (u - d + cu) - offset[n, 2]
        residual[n, 3] = curr[n, 3] - (v + cv) - offset[n, 3]
        F[0, 0] = F[2, 0] = fu / Z
        F[1, 1] = F[3, 1] = fv / Z
        F[0, 2], F[1, 2], F[2, 2], F[3, 2] = -u / Z, -v / Z, -(u - d) / Z, -v / Z
        for i in range(4):
            motion[n, i, 0], motion[n, i, 1], motion[n, i, 2] = rho * F[i, 0], rho * F[i, 1], rho * F[i, 2]
            motion[n, i, 3] = Y * F[i, 2] - Z * F[i, 1]
            motion[n, i, 4] = Z * F[i, 0] - X * F[i, 2]
            motion[n, i, 5] = X * F[i, 1] - Y * F[i, 0]
            disparity[n, i] = (F[i, 0] * t[0] + F[i, 1] * t[1] + F[i, 2] * t[2]) / fb
        disparity[n, 2] -= 1.0 / Z
