"""One pass over the features: the normal equations of the reprojection solve."""

from __future__ import annotations

import math

from probevo.arrays import FloatArray
from probevo.compiled import compiled
from probevo.measurements.robust_loss_numba import (
    RESIDUAL_DIM,
    STUDENT_T,
    robust_bend,
    robust_cost,
    robust_curvature,
    robust_weight,
)
from probevo.measurements.stereo_numba import NEAREST

BEHIND = 1e4
"""Squared Mahalanobis length of a point that does not contribute: far for any loss, near enough to
add up."""


@compiled
def weigh(
    kind: int,
    parameter: FloatArray,
    squared: FloatArray,
    weight: FloatArray,
    curvature: FloatArray,
    relative: FloatArray,
) -> tuple[float, float]:
    """Fill in IRLS weight w, curvature a = w + (2/d) w' s, and w against that of a perfect
    residual, [N] each.

    Returns Σ w² s / d, the scatter of the gradient, and Σ a. All are zero for a point that does not
    contribute.
    """
    scatter = 0.0
    curved = 0.0
    for n in range(len(squared)):
        s = squared[n]
        if s >= BEHIND:
            weight[n] = 0.0
            curvature[n] = 0.0
            relative[n] = 0.0
            continue
        weight[n] = robust_weight(kind, parameter[n], s)
        curvature[n] = robust_curvature(kind, parameter[n], s)
        relative[n] = weight[n] / robust_weight(kind, parameter[n], 0.0)
        scatter += weight[n] * weight[n] * s / RESIDUAL_DIM
        curved += curvature[n]
    return scatter, curved


@compiled
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
    """One pass over the features: normal equations of Σ ρ(eᵀ Σ⁻¹ e) for a left perturbation ξ = [ρ;
    φ] of T.

    Fills hessian [6, 6], gradient [6] (Σ w Jᵀ Σ⁻¹ e with J = ∂h/∂ξ) and squared [N] (eᵀ Σ⁻¹ e), and
    returns the cost. The Hessian is that of IRLS, Σ w Jᵀ Σ⁻¹ J, which never overshoots; ``near``
    the optimum it is Newton's, with 2 w' (Jᵀ Σ⁻¹ e)(Jᵀ Σ⁻¹ e)ᵀ added: where two groups of features
    pull apart, IRLS needs 40 steps and Newton 4.
    """
    fu, fv, cu, cv, fb = camera
    cost = 0.0
    grown = 1.0
    shared_dof = parameter[0] if len(parameter) > 0 and parameter[0] < 1e300 else -1.0
    t00 = t01 = t02 = t11 = t12 = t22 = 0.0  # translation block
    m00 = m01 = m02 = m10 = m11 = m12 = m20 = m21 = m22 = 0.0  # translation × rotation
    r00 = r01 = r02 = r11 = r12 = r22 = 0.0  # rotation block
    gt0 = gt1 = gt2 = gr0 = gr1 = gr2 = 0.0
    for n in range(len(refined)):
        mx = (refined[n, 0] - cu) / fu
        my = (refined[n, 1] - cv) / fv
        rho = refined[n, 2] / fb
        X = C[0, 0] * mx + C[0, 1] * my + C[0, 2] + rho * t[0]
        Y = C[1, 0] * mx + C[1, 1] * my + C[1, 2] + rho * t[1]
        Z = C[2, 0] * mx + C[2, 1] * my + C[2, 2] + rho * t[2]
        if Z < NEAREST:
            squared[n] = BEHIND
            cost += robust_cost(kind, parameter[n], BEHIND)
            continue
        iz = 1.0 / Z
        u = fu * X * iz
        v = fv * Y * iz
        d = fb * rho * iz
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
        if kind == STUDENT_T and parameter[n] == shared_dof:
            grown *= (
                1.0 + s / shared_dof
            )  # Σ log(1 + s/ν) of features of one ν is the logarithm of a product
            if grown > 1e250:
                cost += 0.5 * (shared_dof + 4.0) * math.log(grown)
                grown = 1.0
        else:
            cost += robust_cost(kind, parameter[n], s)
        w = robust_weight(kind, parameter[n], s)
        # both image rows move alike, so the information of v_l and v_r folds into one row v
        w00 = w * W[0, 0]
        w01 = w * (W[0, 1] + W[0, 3])
        w02 = w * W[0, 2]
        w11 = w * (W[1, 1] + 2.0 * W[1, 3] + W[3, 3])
        w12 = w * (W[1, 2] + W[3, 2])
        w22 = w * W[2, 2]
        g0 = w * g0
        g1 = w * (g1 + g3)
        g2 = w * g2
        # rows of ∂f/∂q: u_l (a, 0, b), v (0, c, e), u_r (a, 0, f); H = Fᵀ W F
        a = fu * iz
        b = -u * iz
        c = fv * iz
        e = -v * iz
        f = -(u - d) * iz
        k0 = w00 * b + w01 * e + w02 * f
        k1 = w01 * b + w11 * e + w12 * f
        k2 = w02 * b + w12 * e + w22 * f
        H00 = a * a * (w00 + 2.0 * w02 + w22)
        H01 = a * c * (w01 + w12)
        H02 = a * (k0 + k2)
        H11 = c * c * w11
        H12 = c * k1
        H22 = b * k0 + e * k1 + f * k2
        q0 = a * (g0 + g2)
        q1 = c * g1
        q2 = b * g0 + e * g1 + f * g2
        if near:
            bend = robust_bend(kind, parameter[n], s)
            H00 = H00 - bend * q0 * q0
            H01 = H01 - bend * q0 * q1
            H02 = H02 - bend * q0 * q2
            H11 = H11 - bend * q1 * q1
            H12 = H12 - bend * q1 * q2
            H22 = H22 - bend * q2 * q2
        # q moves by ρ δt + φ × q: M = H (−q^), then the rotation block (−q^)ᵀ M
        M00 = Y * H02 - Z * H01
        M01 = Z * H00 - X * H02
        M02 = X * H01 - Y * H00
        M10 = Y * H12 - Z * H11
        M11 = Z * H01 - X * H12
        M12 = X * H11 - Y * H01
        M20 = Y * H22 - Z * H12
        M21 = Z * H02 - X * H22
        M22 = X * H12 - Y * H02
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
    if grown > 1.0:
        cost += 0.5 * (shared_dof + 4.0) * math.log(grown)
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
