"""The compiled loops over the rig's jitter: an unknown that moves all right observations of a frame.

With B = ∂(u_r', v_r')/∂η at each feature, the residual is e = y' − f(T g(y)) − (0, 0, B η), in which
the jitter is ω = L η with η ~ N(0, I), so that B is taken in units of its standard deviation.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.transfer_numba import NEAREST, Intrinsics, transfer
from probevo.compiled import compiled
from probevo.measurements.robust_loss_numba import robust_bend, robust_weight
from probevo.measurements.stereo_numba import LossParameters, PropagatedNoise

DOF = 3
"""Degrees of freedom of the jitter: pitch, yaw, roll."""


class JitterEquations(NamedTuple):
    """What the jitter adds to the normal equations of N features over (ξ, η)."""

    cross: FloatArray
    """[6, 3], ξ × η."""
    hessian: FloatArray
    """[3, 3]."""
    gradient: FloatArray
    """The direction of descent, [3]."""

    @staticmethod
    def empty() -> JitterEquations:
        """Return space for them."""
        return JitterEquations(
            cross=np.empty((6, DOF)), hessian=np.empty((DOF, DOF)), gradient=np.empty(DOF)
        )


class LinearizedJitter(NamedTuple):
    """The jitter at the point where a solve stands."""

    basis: FloatArray
    """B, [N, 2, 3], px."""
    squared: FloatArray
    """s of each residual, [N]."""
    newton: bool
    """Whether to take the curvature of the loss into account."""


@compiled
def jitter_equations(
    T: FloatArray,
    camera: Intrinsics,
    curr: FloatArray,
    propagated: PropagatedNoise,
    loss: LossParameters,
    jitter: LinearizedJitter,
    equations: JitterEquations,
) -> None:
    """Fill in Σ w Jᵀ Σ⁻¹ B, Σ w Bᵀ Σ⁻¹ B and Σ w Bᵀ Σ⁻¹ e, and Newton's terms if asked for.

    They extend those of ``stereo_numba.normal_equations`` at the same motion and jitter.

    Args:
        T: T_curr_prev, [4, 4].
        camera: the intrinsics.
        curr: y' less the bias and the offset of the jitter, [N, 4], px.
        propagated: the noise of the residuals.
        loss: the robust loss.
        jitter: where it is linearised.
        equations: filled in; the prior of η is not part of it.
    """
    fu, fv, cu, cv, fb = camera
    basis = jitter.basis
    squared = jitter.squared
    newton = jitter.newton
    cross = equations.cross
    hessian = equations.hessian
    gradient = equations.gradient
    cross[:] = 0.0
    hessian[:] = 0.0
    gradient[:] = 0.0
    J = np.empty((3, 6))  # rows u_l, v, u_r: both rows of the image move alike
    white_e = np.empty(4)
    white_B = np.empty((4, DOF))
    pull_motion = np.empty(6)
    pull_jitter = np.empty(DOF)
    for n in range(len(curr)):
        W = propagated.information[n]
        X, Y, Z, rho = transfer(T, camera, propagated.refined[n])
        if Z < NEAREST or not W[0, 0] > 0.0:
            continue
        u = fu * X / Z
        v = fv * Y / Z
        d = fb * rho / Z
        e0 = curr[n, 0] - (u + cu) - propagated.offset[n, 0]
        e1 = curr[n, 1] - (v + cv) - propagated.offset[n, 1]
        e2 = curr[n, 2] - (u - d + cu) - propagated.offset[n, 2]
        e3 = curr[n, 3] - (v + cv) - propagated.offset[n, 3]
        weight = robust_weight(loss.kind, loss.parameter[n], squared[n])
        for i in range(4):
            white_e[i] = weight * (W[i, 0] * e0 + W[i, 1] * e1 + W[i, 2] * e2 + W[i, 3] * e3)
            for k in range(DOF):
                white_B[i, k] = weight * (W[i, 2] * basis[n, 0, k] + W[i, 3] * basis[n, 1, k])
        x_over_z = X / Z
        y_over_z = Y / Z
        for i in range(3):
            # A row of ∂f/∂q is (a, 0, b) for u_l and u_r, (0, a, b) for v, each over q_z; q moves
            # by ρ δt + φ × q.
            scale = fv if i == 1 else fu
            b = -scale * y_over_z if i == 1 else -scale * x_over_z
            if i == 2:
                b += d
            J[i, 0] = 0.0 if i == 1 else rho * scale / Z
            J[i, 1] = rho * scale / Z if i == 1 else 0.0
            J[i, 2] = rho * b / Z
            J[i, 3] = y_over_z * b - (scale if i == 1 else 0.0)
            J[i, 4] = (0.0 if i == 1 else scale) - x_over_z * b
            J[i, 5] = x_over_z * scale if i == 1 else -y_over_z * scale
        for k in range(DOF):
            pull_jitter[k] = basis[n, 0, k] * white_e[2] + basis[n, 1, k] * white_e[3]
            gradient[k] += pull_jitter[k]
            row_v = white_B[1, k] + white_B[3, k]
            for i in range(6):
                cross[i, k] += J[0, i] * white_B[0, k] + J[1, i] * row_v + J[2, i] * white_B[2, k]
            for j in range(DOF):
                hessian[j, k] += basis[n, 0, j] * white_B[2, k] + basis[n, 1, j] * white_B[3, k]
        if newton:
            bend = robust_bend(loss.kind, loss.parameter[n], squared[n])
            for i in range(6):
                pull_motion[i] = (
                    J[0, i] * white_e[0]
                    + J[1, i] * (white_e[1] + white_e[3])
                    + J[2, i] * white_e[2]
                )
            for k in range(DOF):
                for i in range(6):
                    cross[i, k] -= bend * pull_motion[i] * pull_jitter[k]
                for j in range(DOF):
                    hessian[j, k] -= bend * pull_jitter[j] * pull_jitter[k]


@compiled
def jitter_information(
    motion: FloatArray,
    information: FloatArray,
    weight: FloatArray,
    basis: FloatArray,
    translation_share: FloatArray,
    equations: JitterEquations,
) -> None:
    """Fill in Σ a Jᵀ Σ⁻¹ B and Σ a Bᵀ Σ⁻¹ B; the gradient is left alone.

    Args:
        motion: J, [N, 4, 6].
        information: Σ⁻¹, [N, 4, 4].
        weight: a, [N].
        basis: B, [N, 2, 3].
        translation_share: by which the translation's columns of J are scaled, [N].
        equations: filled in.
    """
    cross = equations.cross
    hessian = equations.hessian
    cross[:] = 0.0
    hessian[:] = 0.0
    white_B = np.empty((4, DOF))
    for n in range(len(motion)):
        W = information[n]
        for i in range(4):
            for k in range(DOF):
                white_B[i, k] = weight[n] * (W[i, 2] * basis[n, 0, k] + W[i, 3] * basis[n, 1, k])
        for k in range(DOF):
            for i in range(6):
                total = 0.0
                for r in range(4):
                    total += motion[n, r, i] * white_B[r, k]
                cross[i, k] += total * translation_share[n] if i < 3 else total
            for j in range(DOF):
                hessian[j, k] += basis[n, 0, j] * white_B[2, k] + basis[n, 1, j] * white_B[3, k]


@compiled
def without_jitter(
    curr: FloatArray, basis: FloatArray, eta: FloatArray, shifted: FloatArray
) -> None:
    """Fill ``shifted`` [N, 4] with y' less the offset (0, 0, B η) of the jitter."""
    for n in range(len(curr)):
        shifted[n, 0] = curr[n, 0]
        shifted[n, 1] = curr[n, 1]
        for r in range(2):
            offset = 0.0
            for k in range(DOF):
                offset += basis[n, r, k] * eta[k]
            shifted[n, 2 + r] = curr[n, 2 + r] - offset
