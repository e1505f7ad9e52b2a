"""The equations of velocities, biases and gravity of a window's frames, and their marginalisation.

The Jacobians of a preintegration are taken at the linearisation points of poses, velocities and
gravity ("first-estimates Jacobians"). So a turn of the world together with gravity, and a shift of
it, remain unobservable; gravity held, these are four directions, a turn about it and the shifts.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.scaled_inverse import scaled_inverse, scaled_pseudo_inverse
from probevo.estimation.window.equations import POSE, RIG, WindowEquations
from probevo.estimation.window.inertial_states import (
    COMMON,
    STATE,
    InertialStates,
)
from probevo.estimation.window.window import MarginalPrior, Window
from probevo.geometry import so3
from probevo.measurements.preintegration import NUM_ERRORS, Preintegration
from probevo.sequences.imu_calibration import ImuCalibration

MIN_INFORMATION = 1e-6
"""Information of what nothing measures, such as the velocity at a frame without samples on either
side; it draws nowhere."""
MIN_WALK = 1e-14
"""Smallest variance of a bias's random walk over a step, for calibrations that know none. Its
standard deviation of 1e-7 rad/s or m/s² amounts to 1e-5 after 10,000 steps, less than any bias is
known to. Beside the information of factors, 1e2 to 1e7, its inverse is as large as doubles can
take: of 1e18, rounding would lose 1e2."""


class Intervals(NamedTuple):
    """The K − 1 intervals between successive frames of a window, with or without samples."""

    factors: Sequence[Preintegration | None]
    """The samples of each; None where there is no factor."""
    walk_variances: FloatArray
    """Variance of each bias's random walk over it, [K − 1, 6], (rad/s)², (m/s²)²."""


def walk_variances(calibration: ImuCalibration, durations_s: FloatArray) -> FloatArray:
    """Return the variance of each bias's random walk over intervals, [J] to [J, 6], (rad/s)²,
    (m/s²)².

    A random walk of density σ has the variance σ² T after a time T.
    """
    walks = [calibration.gyro_bias_walk_rad_s2_sqrt_hz, calibration.accel_bias_walk_m_s3_sqrt_hz]
    variances: FloatArray = durations_s[:, None] * np.repeat(np.square(walks), 3)
    return np.maximum(variances, MIN_WALK)


class InertialSystem(NamedTuple):
    """The normal equations of poses, rig and inertial states, without the window's own prior.

    Over p = 6K + 4 degrees of freedom of poses and rig, and q = 11 + 9K inertial ones."""

    cost: float
    hessian: FloatArray
    """[p + q, p + q]."""
    gradient: FloatArray
    """[p + q]."""
    gain: FloatArray
    """H_ii⁻¹ H_ip, [q, p]."""
    own: FloatArray
    """H_ii⁻¹, [q, q]."""

    @property
    def num_poses(self) -> int:
        """Return p."""
        return int(self.gain.shape[1])

    def reduced(self) -> tuple[FloatArray, FloatArray]:
        """Return Hessian, [p, p], and gradient, [p], after the inertial states are eliminated."""
        p = self.num_poses
        hessian = self.hessian[:p, :p] - self.hessian[:p, p:] @ self.gain
        return 0.5 * (hessian + hessian.T), self.gradient[:p] - self.gain.T @ self.gradient[p:]

    def increment(self, pose_increment: FloatArray) -> FloatArray:
        """Return the increment of the inertial states, [q], given that of poses and rig, [p]."""
        own_gradient = self.gradient[self.num_poses :]
        increment: FloatArray = self.own @ own_gradient - self.gain @ pose_increment
        return increment

    def covariances(self, pose_cov: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the covariance of the inertial states, [q, q], and their cross-covariance with
        poses and rig, [q, p], given the covariance of the latter, [p, p]."""
        # Block inverse: Σ_ip = −G Σ_pp, Σ_ii = H_ii⁻¹ + G Σ_pp Gᵀ with the gain G = H_ii⁻¹ H_ip.
        cross_cov = -self.gain @ pose_cov
        return self.own - cross_cov @ self.gain.T, cross_cov


def inertial_system(
    window: Window,
    states: InertialStates,
    intervals: Intervals,
    *,
    num_pairs: int | None = None,
) -> InertialSystem:
    """Form the normal equations at the current values.

    Args:
        window: K poses.
        states: of these K frames.
        intervals: between these frames.
        num_pairs: how many of the intervals count, with their random walks, from the first on; all,
            by default.
    """
    factors = intervals.factors
    num_pairs = len(factors) if num_pairs is None else num_pairs
    count = len(window)
    p = POSE * count + RIG
    q = COMMON + STATE * count
    hessian = np.zeros((p + q, p + q))
    gradient = np.zeros(p + q)
    # The joint prior, but for the part of poses and rig alone, which is the window's own.
    x = states.joint()
    offsets = window.offsets()
    hessian[p:, p:] = states.information
    hessian[p:, :p] = states.coupling
    hessian[:p, p:] = states.coupling.T
    # With y of poses and rig, the prior's cost is ½ xᵀ Λ_ii x + xᵀ Λ_ip y − ηᵀ x; its gradients of
    # descent are η − Λ_ii x − Λ_ip y for x, and −Λ_ipᵀ x for y.
    prior_gradient = states.vector - states.information @ x
    gradient[p:] = prior_gradient - states.coupling @ offsets
    gradient[:p] = -states.coupling.T @ x
    cost = -0.5 * float(x @ (states.vector + prior_gradient)) + float(
        x @ (states.coupling @ offsets)
    )
    # The preintegrations: ½ rᵀ W r each, Hessian Jᵀ W J, gradient of descent −Jᵀ W r.
    present = [at for at, factor in enumerate(factors[:num_pairs]) if factor is not None]
    used = [factor for factor in factors[:num_pairs] if factor is not None]
    if used:
        residual, jacobian = linearized(window, states, used, np.array(present))
        weight = np.linalg.inv(np.stack([factor.cov for factor in used]))
        weighted = jacobian.mT @ weight
        hessians = weighted @ jacobian
        gradients = -(weighted @ residual[..., None])[..., 0]
        cost += 0.5 * float(np.einsum("fi,fij,fj->", residual, weight, residual))
        for at, hessian_of_factor, descent in zip(present, hessians, gradients, strict=True):
            joint = _places(at, p)
            hessian[np.ix_(joint, joint)] += hessian_of_factor
            gradient[joint] += descent
    # The random walks of the biases connect successive frames, with or without samples between.
    variances = intervals.walk_variances[:num_pairs]
    cost += _add_walks(states, variances, hessian[p:, p:], gradient[p:])
    # What nothing measures must not make the block singular that is eliminated.
    inertial = hessian[p:, p:].copy()
    diagonal = np.diagonal(inertial)
    unmeasured = np.flatnonzero(diagonal < MIN_INFORMATION)
    inertial[unmeasured, unmeasured] = MIN_INFORMATION
    # Without any pair the prior is all there is, and need not know every combination of the states:
    # of one frame that has been marginalised, it holds the single factor that connected it.
    own = scaled_inverse(inertial) if num_pairs else scaled_pseudo_inverse(inertial)
    return InertialSystem(
        cost=cost, hessian=hessian, gradient=gradient, gain=own @ hessian[p:, :p], own=own
    )


def _places(at: int, p: int) -> IntArray:
    """Return where the columns of the Jacobian from frame ``at`` to the next lie in the vector."""
    return np.concatenate(
        [
            np.arange(POSE * at, POSE * (at + 2)),
            p + COMMON + np.arange(STATE * at, STATE * (at + 2)),
            p + np.arange(COMMON),
        ]
    )


def _add_walks(
    states: InertialStates, variances: FloatArray, hessian: FloatArray, gradient: FloatArray
) -> float:
    """Add the random walks of the biases to the equations of x, and return their cost."""
    cost = 0.0
    for at, variance in enumerate(variances):
        change = states.bias[at + 1] - states.bias[at]
        first = COMMON + STATE * at + 3 + np.arange(6)
        second = first + STATE
        hessian[first, first] += 1.0 / variance
        hessian[second, second] += 1.0 / variance
        hessian[first, second] -= 1.0 / variance
        hessian[second, first] -= 1.0 / variance
        gradient[first] += change / variance
        gradient[second] -= change / variance
        cost += 0.5 * float(np.sum(change**2 / variance))
    return cost


def linearized(
    window: Window, states: InertialStates, factors: Sequence[Preintegration], first: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Return residuals and Jacobians of F preintegrations.

    Args:
        window: K poses.
        states: of these K frames.
        factors: F of them.
        first: place in the window of the frame where each starts, [F].

    Between frames i and j, with T_cam_world = (C, t), R_ij = C_i C_jᵀ, velocities v in the world,
    gravity g, time T, and Δ the preintegration at the present bias, they are

        δφ = Log(ΔRᵀ R_ij),
        δv = C_i (v_j − v_i − g T) − Δv,
        δp = R_ij (l − t_j) − (l − t_i) − C_i (v_i T + ½ g T²) − Δp,

    where the IMU is at l in the camera's frame, and so at Cᵀ (l − t) in the world.

    Returns:
        Residuals (δφ, δv, δp), [F, 9], at the current values, and Jacobians with respect to both
        poses, velocity and biases at both ends, gravity, and the errors of the calibration,
        [F, 9, 6 + 6 + 9 + 9 + 11], at the linearisation points.
    """
    measured = _Factors.stacked(factors, states.calibration_errors[NUM_ERRORS:])
    current = _kinematics(
        measured, window.T_cam_world, first, velocity=states.velocity, gravity=states.gravity
    )
    # The samples were summed up with another bias, and without errors of the calibration; what that
    # changes is taken to first order, as (δφ, δv, δp), [F, 9]: ΔR Exp(δφ), Δv + δv, Δp + δp.
    bias = states.bias[first]
    correction = _products(measured.bias_jacobian, bias - measured.bias)
    correction += _products(measured.bias_change_jacobian, states.bias[first + 1] - bias)
    correction += measured.error_jacobian @ states.calibration_errors[:NUM_ERRORS]
    residual = _residuals(measured, current, correction)
    linear = _kinematics(
        measured,
        window.T_linear,
        first,
        velocity=states.velocity_linear,
        gravity=states.gravity_linear,
    )
    # g = Exp(B δ) ḡ moves by −ḡ^ B δ.
    gravity_change = -so3.wedge(states.gravity_linear) @ states.across
    return residual, _jacobians(measured, linear, residual[:, :3], gravity_change)


class _Factors(NamedTuple):
    """F preintegrations (``Preintegration``), stacked."""

    duration_s: FloatArray
    """T, [F, 1]."""
    rotation: FloatArray
    """ΔR, [F, 3, 3]."""
    velocity: FloatArray
    """Δv, [F, 3], m/s."""
    position: FloatArray
    """Δp, [F, 3], m."""
    bias_jacobian: FloatArray
    """Derivative of (δφ, δv, δp) with respect to ``bias``, [F, 9, 6]."""
    bias_change_jacobian: FloatArray
    """The same with respect to its change from the start to the end, [F, 9, 6]."""
    error_jacobian: FloatArray
    """The same with respect to the errors of the calibration, [F, 9, 6]."""
    bias: FloatArray
    """Biases that were taken off the samples, [F, 6], rad/s and m/s²."""
    lever_m: FloatArray
    """l: position of the IMU in the camera's frame, [F, 3], m."""

    @staticmethod
    def stacked(factors: Sequence[Preintegration], lever_error_m: FloatArray) -> _Factors:
        """Return the arrays of all factors, with the lever corrected, [3], m."""
        return _Factors(
            duration_s=np.array([factor.duration_s for factor in factors])[:, None],
            rotation=np.stack([factor.rotation for factor in factors]),
            velocity=np.stack([factor.velocity for factor in factors]),
            position=np.stack([factor.position for factor in factors]),
            bias_jacobian=np.stack([factor.bias_jacobian for factor in factors]),
            bias_change_jacobian=np.stack([factor.bias_change_jacobian for factor in factors]),
            error_jacobian=np.stack([factor.error_jacobian for factor in factors]),
            bias=np.stack([factor.bias for factor in factors]),
            lever_m=np.stack([factor.lever_m for factor in factors]) + lever_error_m,
        )


class _Kinematics(NamedTuple):
    """What poses, velocities and gravity say of F intervals, along the axes of camera i at their
    start."""

    C_i: FloatArray
    """Rotation from the world to camera i, [F, 3, 3]."""
    t_i: FloatArray
    """Translation from the world to camera i, [F, 3], m."""
    rotation: FloatArray
    """R_ij, [F, 3, 3]."""
    displacement: FloatArray
    """R_ij (l − t_j) − (l − t_i): of the IMU, [F, 3], m."""
    ballistic: FloatArray
    """C_i (v_i T + ½ g T²): the part of it that is due to the velocity at the start and to gravity,
    [F, 3], m."""
    velocity_change: FloatArray
    """C_i (v_j − v_i − g T): the change of velocity that is not due to gravity, [F, 3], m/s."""


def _kinematics(
    factors: _Factors,
    T_cam_world: FloatArray,
    first: IntArray,
    *,
    velocity: FloatArray,
    gravity: FloatArray,
) -> _Kinematics:
    """Return the kinematics of F intervals.

    Args:
        factors: their durations, and the place of the IMU.
        T_cam_world: K poses, [K, 4, 4].
        first: place of the frame where each interval starts, [F].
        velocity: at the K frames, [K, 3], m/s.
        gravity: in the world, [3], m/s².
    """
    T_i = T_cam_world[first]
    T_j = T_cam_world[first + 1]
    C_i = T_i[:, :3, :3]
    rotation = C_i @ T_j[:, :3, :3].mT
    lever_m = factors.lever_m
    dt = factors.duration_s
    v_i = velocity[first]
    return _Kinematics(
        C_i=C_i,
        t_i=T_i[:, :3, 3],
        rotation=rotation,
        displacement=_products(rotation, lever_m - T_j[:, :3, 3]) - (lever_m - T_i[:, :3, 3]),
        ballistic=_products(C_i, dt * v_i + 0.5 * dt**2 * gravity),
        velocity_change=_products(C_i, velocity[first + 1] - v_i - dt * gravity),
    )


def _residuals(factors: _Factors, current: _Kinematics, correction: FloatArray) -> FloatArray:
    """Return (δφ, δv, δp), [F, 9]: what the states say minus what the samples say.

    Args:
        factors: F preintegrations.
        current: kinematics at the current values.
        correction: of the preintegrations, by biases and calibration, (δφ, δv, δp), [F, 9].
    """
    rotation = factors.rotation @ so3.exp(correction[:, :3])
    residual = np.empty((len(correction), 9))
    residual[:, :3] = so3.log(rotation.mT @ current.rotation)
    residual[:, 3:6] = current.velocity_change - correction[:, 3:6] - factors.velocity
    residual[:, 6:] = current.displacement - current.ballistic - correction[:, 6:]
    residual[:, 6:] -= factors.position
    return residual


def _jacobians(
    factors: _Factors, linear: _Kinematics, delta_phi: FloatArray, gravity_change: FloatArray
) -> FloatArray:
    """Return the Jacobians of the residuals, [F, 9, 6 + 6 + 9 + 9 + 11].

    All is at the linearisation points, but for the Jacobians of Log: they are factors of the
    columns of both poses alike, so that what is unobservable remains so.

    Args:
        factors: F preintegrations.
        linear: kinematics at the linearisation points.
        delta_phi: δφ at the current values, [F, 3].
        gravity_change: derivative of gravity with respect to its offset, [3, 2].
    """
    C_i = linear.C_i
    R_ij = linear.rotation
    dt = factors.duration_s[..., None]
    jacobian = np.zeros((len(delta_phi), 9, 2 * POSE + 2 * STATE + COMMON))
    # Rows: δφ, δv, δp. Columns: ξ = [ρ; φ] of both poses, then (v, bias) of both, then what all
    # frames have in common: gravity, errors of the samples, lever.
    rows_r = slice(0, 3)
    rows_v = slice(3, 6)
    rows_p = slice(6, 9)
    rho_i = slice(0, 3)
    phi_i = slice(3, 6)
    rho_j = slice(6, 9)
    phi_j = slice(9, 12)
    v_i = slice(12, 15)
    bias_i = slice(15, 21)
    v_j = slice(21, 24)
    bias_j = slice(24, 30)
    gravity = slice(30, 32)
    errors = slice(32, 38)
    lever = slice(38, 41)
    # C ← Exp(φ) C at both ends, so that R_ij ← Exp(φ_i) R_ij Exp(−φ_j) = R_ij Exp(R_ijᵀ φ_i − φ_j).
    # So δφ = Log(ΔRᵀ R_ij) moves by J_r⁻¹(δφ) (R_ijᵀ φ_i − φ_j), with J_r(φ) = J(−φ).
    inverse_right = np.linalg.inv(so3.left_jacobian(-delta_phi))
    jacobian[:, rows_r, phi_i] = inverse_right @ R_ij.mT
    jacobian[:, rows_r, phi_j] = -inverse_right
    # What C_i turns moves by φ_i × itself.
    jacobian[:, rows_v, phi_i] = -so3.wedge(linear.velocity_change)
    jacobian[:, rows_p, rho_i] = np.eye(3)
    # t_i moves by ρ_i + φ_i × t_i. δp = R_ij (l − t_j) − l + t_i − C_i (v_i T + ½ g T²) − Δp: all
    # of it but l and Δp turns with φ_i, and a × b = −b^ a gives the sign.
    to_imu_j = linear.displacement + factors.lever_m - linear.t_i  # R_ij (l − t_j)
    jacobian[:, rows_p, phi_i] = so3.wedge(linear.ballistic - to_imu_j - linear.t_i)
    # In R_ij (l − t_j), the turns of C_jᵀ and t_j by φ_j cancel but for that of l.
    jacobian[:, rows_p, rho_j] = -R_ij
    jacobian[:, rows_p, phi_j] = R_ij @ so3.wedge(factors.lever_m)
    # ∂δv/∂v and ∂δp/∂v; δp does not depend on v_j.
    jacobian[:, rows_v, v_i] = -C_i
    jacobian[:, rows_p, v_i] = -dt * C_i
    jacobian[:, rows_v, v_j] = C_i
    # The bias goes from that of the first frame to that of the second. It turns ΔR on its right,
    # and so ΔRᵀ R_ij on its left: by −J⁻¹(δφ).
    jacobian[:, :, bias_i] = factors.bias_change_jacobian - factors.bias_jacobian
    jacobian[:, :, bias_j] = -factors.bias_change_jacobian
    jacobian[:, :, errors] = -factors.error_jacobian
    inverse_left = np.linalg.inv(so3.left_jacobian(delta_phi))
    for columns in (bias_i, bias_j, errors):
        jacobian[:, rows_r, columns] = inverse_left @ jacobian[:, rows_r, columns]
    jacobian[:, rows_p, lever] = R_ij - np.eye(3)
    # δv has −C_i g T, and δp has −½ C_i g T².
    gravity_jacobian = C_i @ gravity_change
    jacobian[:, rows_v, gravity] = -dt * gravity_jacobian
    jacobian[:, rows_p, gravity] = -0.5 * dt**2 * gravity_jacobian
    return jacobian


def _products(matrices: FloatArray, vectors: FloatArray) -> FloatArray:
    """Return the products of matrices, [F, R, C], and vectors, [F, C]."""
    products: FloatArray = (matrices @ vectors[..., None])[..., 0]
    return products


def without_first_frame(
    states: InertialStates, others: WindowEquations, system: InertialSystem, x: FloatArray
) -> tuple[MarginalPrior, InertialStates]:
    """Marginalise the first pose, velocity and biases.

    Args:
        states: of K frames.
        others: equations of poses and rig from all but ``system``, at the current values.
        system: what inertial states and their prior add, with the first factor alone.
        x: offsets of poses and rig, [6K + 4], and the inertial vector, [11 + 9K].

    Returns:
        The prior of the poses that remain and the rig, and the states that remain, with the rest
        of the joint prior.
    """
    p = system.num_poses
    hessian = system.hessian.copy()
    hessian[:p, :p] += others.hessian
    gradient = system.gradient.copy()
    gradient[:p] += others.gradient
    # At the offsets x, gradient = η − Λ x of the prior that includes what goes.
    vector = gradient + hessian @ x
    # What goes is its block of the joint prior over (poses, rig, what frames have in common, states
    # of each frame).
    goes = np.zeros(len(x), np.bool_)
    goes[:POSE] = True
    goes[p + COMMON : p + COMMON + STATE] = True
    gone = hessian[np.ix_(goes, goes)]
    unmeasured = np.flatnonzero(np.diagonal(gone) < MIN_INFORMATION)
    gone[unmeasured, unmeasured] = MIN_INFORMATION
    gain = scaled_inverse(gone) @ hessian[np.ix_(goes, ~goes)]
    rest = hessian[np.ix_(~goes, ~goes)] - hessian[np.ix_(~goes, goes)] @ gain
    rest = 0.5 * (rest + rest.T)
    # η' = η_r − Λ_rg Λ_gg⁻¹ η_g.
    rest_vector = vector[~goes] - gain.T @ vector[goes]
    # The rest is a prior of all that remains, of which the window holds the part of poses and rig.
    poses = slice(None, p - POSE)
    inertial = slice(p - POSE, None)
    remaining = ~goes[p:]
    kept = replace(
        states,
        velocity=states.velocity[1:],
        velocity_linear=states.velocity_linear[1:],
        bias=states.bias[1:],
        coupling=rest[inertial, poses],
        information=rest[inertial, inertial],
        vector=rest_vector[inertial],
        cov=states.cov[np.ix_(remaining, remaining)],
        cross_cov=states.cross_cov[remaining, POSE:],
    )
    return MarginalPrior(rest[poses, poses], rest_vector[poses]), kept
