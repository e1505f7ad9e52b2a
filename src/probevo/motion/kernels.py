"""Compiled inner loops of the reprojection solve.

A point is carried as its ray m and inverse depth ρ = d/(f_u b) rather than as p = m/ρ, so that T acts as
q = C m + ρ t and nothing is singular for a point at infinity: far features keep their say about rotation.
"""

from __future__ import annotations

import math
from enum import IntEnum

import numpy as np
from numba import njit

from probevo.arrays import FloatArray


class LossKind(IntEnum):
    """Robust losses ρ(s) of the squared Mahalanobis length s of a residual."""

    L2 = 0
    HUBER = 1
    CAUCHY = 2
    TUKEY = 3
    STUDENT_T = 4


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", inline="always")
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


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
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


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
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
        if Z < 1e-3:
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


@njit(cache=True, error_model="numpy", fastmath={"contract", "reassoc", "nsz", "arcp"})
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
    hessian: FloatArray,
    gradient: FloatArray,
    squared: FloatArray,
) -> float:
    """One pass over the features: Gauss–Newton system of Σ ρ(eᵀ Σ⁻¹ e) for a left perturbation ξ = [ρ; φ] of T.

    Fills hessian [6, 6] (Σ w Jᵀ Σ⁻¹ J), gradient [6] (Σ w Jᵀ Σ⁻¹ e, J = ∂h/∂ξ) and squared [N] (eᵀ Σ⁻¹ e). Returns the cost.
    """
    fu, fv, cu, cv, fb = camera
    hessian[:] = 0.0
    gradient[:] = 0.0
    cost = 0.0
    J = np.empty((3, 6))  # rows u_l, v, u_r: both rows of the image move alike
    WJ = np.empty((3, 6))
    W = np.empty((3, 3))
    for n in range(len(refined)):
        mx, my, rho = (refined[n, 0] - cu) / fu, (refined[n, 1] - cv) / fv, refined[n, 2] / fb
        X = C[0, 0] * mx + C[0, 1] * my + C[0, 2] + rho * t[0]
        Y = C[1, 0] * mx + C[1, 1] * my + C[1, 2] + rho * t[1]
        Z = C[2, 0] * mx + C[2, 1] * my + C[2, 2] + rho * t[2]
        if Z < 1e-3:
            squared[n] = 1e12
            cost += robust_cost(kind, parameter[n], 4, 1e12)
            continue
        iz = 1.0 / Z
        u, v, d = fu * X * iz, fv * Y * iz, fb * rho * iz
        e0 = curr[n, 0] - (u + cu) - offset[n, 0]
        e1 = curr[n, 1] - (v + cv) - offset[n, 1]
        e2 = curr[n, 2] - (u - d + cu) - offset[n, 2]
        e3 = curr[n, 3] - (v + cv) - offset[n, 3]
        info = information[n]
        g0 = info[0, 0] * e0 + info[0, 1] * e1 + info[0, 2] * e2 + info[0, 3] * e3
        g1 = info[1, 0] * e0 + info[1, 1] * e1 + info[1, 2] * e2 + info[1, 3] * e3
        g2 = info[2, 0] * e0 + info[2, 1] * e1 + info[2, 2] * e2 + info[2, 3] * e3
        g3 = info[3, 0] * e0 + info[3, 1] * e1 + info[3, 2] * e2 + info[3, 3] * e3
        s = e0 * g0 + e1 * g1 + e2 * g2 + e3 * g3
        squared[n] = s
        cost += robust_cost(kind, parameter[n], 4, s)
        w = robust_weight(kind, parameter[n], 4, s)
        g0, g1, g2 = w * g0, w * (g1 + g3), w * g2
        W[0, 0], W[0, 1], W[0, 2] = w * info[0, 0], w * (info[0, 1] + info[0, 3]), w * info[0, 2]
        W[1, 1], W[1, 2] = w * (info[1, 1] + 2.0 * info[1, 3] + info[3, 3]), w * (info[1, 2] + info[3, 2])
        W[2, 2] = w * info[2, 2]
        W[1, 0], W[2, 0], W[2, 1] = W[0, 1], W[0, 2], W[1, 2]
        a0, a2 = fu * iz, -u * iz
        b1, b2 = fv * iz, -v * iz
        c2 = -(u - d) * iz
        # a row r of ∂f/∂q gives [ρ r, q × r]
        J[0, 0], J[0, 1], J[0, 2] = rho * a0, 0.0, rho * a2
        J[0, 3], J[0, 4], J[0, 5] = Y * a2, Z * a0 - X * a2, -Y * a0
        J[1, 0], J[1, 1], J[1, 2] = 0.0, rho * b1, rho * b2
        J[1, 3], J[1, 4], J[1, 5] = Y * b2 - Z * b1, -X * b2, X * b1
        J[2, 0], J[2, 1], J[2, 2] = rho * a0, 0.0, rho * c2
        J[2, 3], J[2, 4], J[2, 5] = Y * c2, Z * a0 - X * c2, -Y * a0
        for j in range(6):
            WJ[0, j] = W[0, 0] * J[0, j] + W[0, 1] * J[1, j] + W[0, 2] * J[2, j]
            WJ[1, j] = W[1, 0] * J[0, j] + W[1, 1] * J[1, j] + W[1, 2] * J[2, j]
            WJ[2, j] = W[2, 0] * J[0, j] + W[2, 1] * J[1, j] + W[2, 2] * J[2, j]
            gradient[j] += J[0, j] * g0 + J[1, j] * g1 + J[2, j] * g2
        for i in range(6):
            for j in range(i + 1):
                hessian[i, j] += J[0, i] * WJ[0, j] + J[1, i] * WJ[1, j] + J[2, i] * WJ[2, j]
    for i in range(6):
        for j in range(i):
            hessian[j, i] = hessian[i, j]
    return cost
