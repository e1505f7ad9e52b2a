"""The compiled loops over the rig's jitter: unknowns that move all features of a step together.

The residual is e = y' − h(s) − D η, with h(s) = f(T g(s)). Of η = (η', η°) ~ N(0, I), η' is the
jitter of the current frame in units of its standard deviation, which moves the right observations
by B η', and η° what is not known of the jitter of the previous frame. The latter moves
(s, δ) = (u, v, d, δ) by V η°, and so D = (B, H V), with H = (∂h/∂s, −(0, 0, 1, 0)).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.transfer_numba import NEAREST, Intrinsics, transfer
from probevo.compiled import compiled
from probevo.measurements.robust_loss_numba import robust_bend, robust_weight
from probevo.measurements.stereo_numba import LossParameters, PropagatedNoise

AXES = 3
"""Degrees of freedom of the jitter in one frame: pitch, yaw, roll."""
DOF = 2 * AXES
"""Of η: those of the current frame, then those of the previous one."""


class JitterEquations(NamedTuple):
    """What the jitter adds to the normal equations of N features over (ξ, η)."""

    cross: FloatArray
    """[6, 6], ξ × η."""
    hessian: FloatArray
    """[6, 6]."""
    gradient: FloatArray
    """The direction of descent, [6]."""

    @staticmethod
    def empty() -> JitterEquations:
        """Return space for them."""
        return JitterEquations(
            cross=np.empty((6, DOF)), hessian=np.empty((DOF, DOF)), gradient=np.empty(DOF)
        )


class LinearizedJitter(NamedTuple):
    """The jitter at the point where a solve stands."""

    columns: FloatArray
    """D, [N, 4, 6], px."""
    squared: FloatArray
    """s of each residual, [N]."""
    newton: bool
    """Whether to take the curvature of the loss into account."""


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
    move = np.empty(3)
    for n in range(len(refined)):
        columns[n] = 0.0
        X, Y, Z, rho = transfer(T, camera, refined[n])
        if Z < NEAREST:
            continue
        x = X / Z
        y = Y / Z
        d = fb * rho / Z
        for k in range(AXES):
            columns[n, 2, k] = basis[n, 0, k]
            columns[n, 3, k] = basis[n, 1, k]
            for i in range(3):
                move[i] = (
                    T[i, 0] * sensitivity[n, 0, k] / fu
                    + T[i, 1] * sensitivity[n, 1, k] / fv
                    + T[i, 3] * sensitivity[n, 2, k] / fb
                ) / Z
            u_move = fu * (move[0] - x * move[2])
            v_move = fv * (move[1] - y * move[2])
            d_move = sensitivity[n, 2, k] / Z - d * move[2]
            columns[n, 0, AXES + k] = u_move
            columns[n, 1, AXES + k] = v_move
            columns[n, 2, AXES + k] = u_move - d_move - sensitivity[n, 3, k]
            columns[n, 3, AXES + k] = v_move


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
    """Fill in Σ w Jᵀ Σ⁻¹ D, Σ w Dᵀ Σ⁻¹ D and Σ w Dᵀ Σ⁻¹ e, and Newton's terms if asked for.

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
    columns = jitter.columns
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
    white_D = np.empty((4, DOF))
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
                total = 0.0
                for r in range(4):
                    total += W[i, r] * columns[n, r, k]
                white_D[i, k] = weight * total
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
            pull_jitter[k] = 0.0
            for r in range(4):
                pull_jitter[k] += columns[n, r, k] * white_e[r]
            gradient[k] += pull_jitter[k]
            row_v = white_D[1, k] + white_D[3, k]
            for i in range(6):
                cross[i, k] += J[0, i] * white_D[0, k] + J[1, i] * row_v + J[2, i] * white_D[2, k]
            for j in range(DOF):
                for r in range(4):
                    hessian[j, k] += columns[n, r, j] * white_D[r, k]
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
    columns: FloatArray,
    translation_share: FloatArray,
    equations: JitterEquations,
) -> None:
    """Fill in Σ a Jᵀ Σ⁻¹ D and Σ a Dᵀ Σ⁻¹ D; the gradient is left alone.

    Args:
        motion: J, [N, 4, 6].
        information: Σ⁻¹, [N, 4, 4].
        weight: a, [N].
        columns: D, [N, 4, 6].
        translation_share: by which the translation's columns of J are scaled, [N].
        equations: filled in.
    """
    cross = equations.cross
    hessian = equations.hessian
    cross[:] = 0.0
    hessian[:] = 0.0
    white_D = np.empty((4, DOF))
    for n in range(len(motion)):
        W = information[n]
        for i in range(4):
            for k in range(DOF):
                total = 0.0
                for r in range(4):
                    total += W[i, r] * columns[n, r, k]
                white_D[i, k] = weight[n] * total
        for k in range(DOF):
            for i in range(6):
                total = 0.0
                for r in range(4):
                    total += motion[n, r, i] * white_D[r, k]
                cross[i, k] += total * translation_share[n] if i < 3 else total
            for j in range(DOF):
                for r in range(4):
                    hessian[j, k] += columns[n, r, j] * white_D[r, k]


@compiled
def without_jitter(
    curr: FloatArray, columns: FloatArray, eta: FloatArray, shifted: FloatArray
) -> None:
    """Fill ``shifted`` [N, 4] with y' less D η."""
    for n in range(len(curr)):
        for r in range(4):
            offset = 0.0
            for k in range(DOF):
                offset += columns[n, r, k] * eta[k]
            shifted[n, r] = curr[n, r] - offset
