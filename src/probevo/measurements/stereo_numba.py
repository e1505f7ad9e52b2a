"""Compiled inner loops of the reprojection solve.

A point is carried as its ray m and inverse depth ρ = d/(f_u b) rather than as p = m/ρ, so that T
acts as q = C m + ρ t and nothing is singular for a point at infinity: far features still contribute
to the rotation.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, invert_symmetric_4

NEAREST = 1e-3
"""A point whose scaled depth q_z falls below this is behind the camera or in it, and does not
contribute."""


@compiled
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
    shared: FloatArray,
) -> None:
    """Fold the noise of the triangulated points into that of the residuals, at the motion (C, t).

    With h the map from s = (u, v, d) in the previous frame to y' in the current one and A = ∂h/∂s,
    the residual e = y' − h(s) has the scale Σ = R' + A S Aᵀ. The most likely true s given both
    observations, ŝ = s + S Aᵀ Σ⁻¹ e, is where the solver then linearises: at the noisy s itself the
    Jacobian would correlate with the residual, which shortens the motion estimated from small
    disparities (errors-in-variables attenuation). For points whose noise is not propagated, S = 0
    and nothing changes.

    The error δ of the disparity that is the same in both frames moves y' along −(0, 0, 1, 0), so
    that s and δ are taken together: with P their covariance and H = [A, −(0, 0, 1, 0)], Σ = R' + H
    P Hᵀ. For a point of which nothing is known but its observation, d and δ are off by opposite
    amounts, of variance τ², and that is R' + A S Aᵀ + τ² l lᵀ, with l = −(0, 0, 1, 0) − ∂h/∂d.
    Stereo matching errs so: a window that straddles an edge is matched as wrongly in the next
    frame.

    Args:
        C, t: current estimate of the motion, [3, 3], [3].
        camera: (fu, fv, cu, cv, fu b).
        seen: s of each point, [N, 3], px.
        point_cov: P, that of (u, v, d, δ), [N, 4, 4], px².
        curr: y', less the bias and what δ is taken for, [N, 4], px.
        scale: R', [N, 4, 4], px².
        refined: in and out, ŝ, [N, 3], px.
        offset: out, A (s − ŝ), by which the residual at ŝ differs from the one at s, [N, 4], px.
        information: out, Σ⁻¹, [N, 4, 4]; zero where the point is behind the camera.
        shared: out, the last two columns of H P: the covariance of the residual with (d, δ), [N, 4,
            2], px².
    """
    fu, fv, cu, cv, fb = camera
    A = np.empty((3, 3))
    HP = np.empty((3, 4))
    point = np.empty((3, 3))  # rows u_l, v, u_r: v_l and v_r are alike
    sigma = np.empty((4, 4))
    lower = np.zeros((4, 4))
    e = np.empty(4)
    g = np.empty(4)
    for n in range(len(seen)):
        mx = (refined[n, 0] - cu) / fu
        my = (refined[n, 1] - cv) / fv
        rho = refined[n, 2] / fb
        X = C[0, 0] * mx + C[0, 1] * my + C[0, 2] + rho * t[0]
        Y = C[1, 0] * mx + C[1, 1] * my + C[1, 2] + rho * t[1]
        Z = C[2, 0] * mx + C[2, 1] * my + C[2, 2] + rho * t[2]
        if Z < NEAREST:
            information[n] = 0.0
            continue
        iz = 1.0 / Z
        u = fu * X * iz
        v = fv * Y * iz
        d = fb * rho * iz
        a = fu * iz
        b = fv * iz
        c = iz / fb  # columns of A: a change of u, v, d moves q along C's columns and t
        A[0, 0] = (a * C[0, 0] - u * iz * C[2, 0]) / fu
        A[0, 1] = (a * C[0, 1] - u * iz * C[2, 1]) / fv
        A[0, 2] = (fu * t[0] - u * t[2]) * c
        A[1, 0] = (b * C[1, 0] - v * iz * C[2, 0]) / fu
        A[1, 1] = (b * C[1, 1] - v * iz * C[2, 1]) / fv
        A[1, 2] = (fv * t[1] - v * t[2]) * c
        A[2, 0], A[2, 1], A[2, 2] = (
            A[0, 0] + d * iz * C[2, 0] / fu,
            A[0, 1] + d * iz * C[2, 1] / fv,
            A[0, 2] - iz + d * t[2] * c,
        )
        P = point_cov[n]
        for i in range(3):
            for j in range(4):
                HP[i, j] = A[i, 0] * P[0, j] + A[i, 1] * P[1, j] + A[i, 2] * P[2, j]
                if i == 2:
                    HP[i, j] -= P[3, j]
        for i in range(3):
            for j in range(i + 1):
                product = HP[i, 0] * A[j, 0] + HP[i, 1] * A[j, 1] + HP[i, 2] * A[j, 2]
                point[i, j] = point[j, i] = product - HP[i, 3] if j == 2 else product
        for i in range(4):
            shared[n, i, 0] = HP[i if i < 3 else 1, 2]
            shared[n, i, 1] = HP[i if i < 3 else 1, 3]
            for j in range(i + 1):
                sigma[i, j] = scale[n, i, j] + point[i if i < 3 else 1, j if j < 3 else 1]
        _set_offset(A, seen[n], refined[n], offset=offset[n])
        if not invert_symmetric_4(sigma, information[n], lower):
            information[n] = 0.0
            continue
        e[0] = curr[n, 0] - (u + cu) - offset[n, 0]
        e[1] = curr[n, 1] - (v + cv) - offset[n, 1]
        e[2] = curr[n, 2] - (u - d + cu) - offset[n, 2]
        e[3] = curr[n, 3] - (v + cv) - offset[n, 3]
        W = information[n]
        for i in range(4):
            g[i] = W[i, 0] * e[0] + W[i, 1] * e[1] + W[i, 2] * e[2] + W[i, 3] * e[3]
        for j in range(3):
            refined[n, j] = (
                seen[n, j] + HP[0, j] * g[0] + HP[1, j] * (g[1] + g[3]) + HP[2, j] * g[2]
            )
        _set_offset(A, seen[n], refined[n], offset=offset[n])


@compiled
def _set_offset(A: FloatArray, seen: FloatArray, refined: FloatArray, offset: FloatArray) -> None:
    """offset [4] = A (s − ŝ), the rows v_l and v_r alike."""
    x = seen[0] - refined[0]
    y = seen[1] - refined[1]
    z = seen[2] - refined[2]
    offset[0] = A[0, 0] * x + A[0, 1] * y + A[0, 2] * z
    offset[1] = offset[3] = A[1, 0] * x + A[1, 1] * y + A[1, 2] * z
    offset[2] = A[2, 0] * x + A[2, 1] * y + A[2, 2] * z


@compiled
def residual_jacobians(
    C: FloatArray,
    t: FloatArray,
    camera: FloatArray,
    refined: FloatArray,
    offset: FloatArray,
    curr: FloatArray,
    information: FloatArray,
    residual: FloatArray,
    motion: FloatArray,
    white: FloatArray,
    disparity: FloatArray,
) -> None:
    """Residuals e [N, 4] and what moves h: J = ∂h/∂ξ (motion, [N, 4, 6]), Σ⁻¹ J (white), ∂h/∂d
    (disparity, [N, 4]).

    All are zero behind the camera.
    """
    fu, fv, cu, cv, fb = camera
    F = np.zeros((4, 3))
    for n in range(len(refined)):
        mx = (refined[n, 0] - cu) / fu
        my = (refined[n, 1] - cv) / fv
        rho = refined[n, 2] / fb
        X = C[0, 0] * mx + C[0, 1] * my + C[0, 2] + rho * t[0]
        Y = C[1, 0] * mx + C[1, 1] * my + C[1, 2] + rho * t[1]
        Z = C[2, 0] * mx + C[2, 1] * my + C[2, 2] + rho * t[2]
        if Z < NEAREST:
            residual[n] = 0.0
            motion[n] = 0.0
            white[n] = 0.0
            disparity[n] = 0.0
            continue
        u = fu * X / Z
        v = fv * Y / Z
        d = fb * rho / Z
        residual[n, 0] = curr[n, 0] - (u + cu) - offset[n, 0]
        residual[n, 1] = curr[n, 1] - (v + cv) - offset[n, 1]
        residual[n, 2] = curr[n, 2] - (u - d + cu) - offset[n, 2]
        residual[n, 3] = curr[n, 3] - (v + cv) - offset[n, 3]
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
            disparity[n, i] = (F[i, 0] * t[0] + F[i, 1] * t[1] + F[i, 2] * t[2]) / fb
        disparity[n, 2] -= 1.0 / Z
        for i in range(4):
            for j in range(6):
                total = 0.0
                for k in range(4):
                    total += information[n, i, k] * motion[n, k, j]
                white[n, i, j] = total


@compiled
def sum_information(
    jacobian: FloatArray,
    white: FloatArray,
    weight: FloatArray,
    curvature: FloatArray,
    share: FloatArray,
    lent: FloatArray,
    hessian: FloatArray,
    information: FloatArray,
) -> None:
    """Fill hessian, Σ w Jᵀ Σ⁻¹ J, and information, Σ a Jᵀ Σ⁻¹ J, [6, 6] each; see
    ``reprojection._information``.

    In the information, the translation's columns of J are scaled by ``share`` [N], their square
    less by ``lent`` [N].
    """
    hessian[:] = 0.0
    information[:] = 0.0
    for n in range(len(jacobian)):
        both = curvature[n] * (share[n] * share[n] - lent[n])
        one = curvature[n] * share[n]
        for i in range(6):
            for j in range(i + 1):
                product = 0.0
                for k in range(4):
                    product += jacobian[n, k, i] * white[n, k, j]
                hessian[i, j] += weight[n] * product
                information[i, j] += (both if i < 3 else one if j < 3 else curvature[n]) * product
    for i in range(6):
        for j in range(i):
            hessian[j, i] = hessian[i, j]
            information[j, i] = information[i, j]
