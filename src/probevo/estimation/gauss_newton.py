"""Levenberg–Marquardt over SE(3), from the normal equations to the optimum."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, copy_into, perturb, rotation_error, solve_positive_definite
from probevo.measurements.normal_equations_numba import normal_equations
from probevo.measurements.stereo_numba import linearize_noise

RENEW_AFTER = 1.0
"""Squared length of the way since Σ was last renewed, in standard deviations of the motion, that
makes it stale.

Within one, what is left of its age is below a hundredth of a standard deviation."""
MAX_RENEWALS = 10
"""How often Σ is computed at most; from a guess as good as RANSAC's it takes two or three."""


@compiled
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
    shared: FloatArray,
    squared: FloatArray,
) -> tuple[int, bool, float]:
    """Levenberg–Marquardt on SE(3) over Σ ρ(eᵀ Σ⁻¹ e) + ½ φᵀ Λ φ, with φ = Log(C C_priorᵀ).

    C and t are the guess on entry and the solution on return; refined, offset, information, shared
    and squared are those of ``linearize_noise`` and ``normal_equations`` there. Σ is renewed when
    the motion has moved by a good part of its own standard deviation, and else kept, so that the
    cost is one function near the optimum. Returns the iterations, whether the last step was shorter
    than the tolerance times its own standard deviation, and the cost. Without any iterations the
    guess stays, and all else is filled in at it.
    """
    hessian = np.empty((6, 6))
    gradient = np.empty(6)
    trial_hessian = np.empty((6, 6))
    trial_gradient = np.empty(6)
    trial_squared = np.empty(len(squared))
    lower = np.zeros((6, 6))
    step = np.zeros(6)
    damped = np.empty((6, 6))
    trial_C = np.empty((3, 3))
    trial_t = np.empty(3)
    phi = np.empty(3)
    damping = 1e-6
    accepted = 0
    cost = 0.0
    stale = True
    near = damping > 1.0  # False, but no literal: normal_equations would be compiled for that, too
    renewals = 0
    moved = math.inf
    for iteration in range(max(max_iterations, 1)):
        if stale:
            if moved > RENEW_AFTER and renewals < MAX_RENEWALS:
                renewals = renewals + 1
                moved = 0.0
                linearize_noise(
                    C,
                    t,
                    camera,
                    seen=seen,
                    point_cov=point_cov,
                    curr=curr,
                    scale=scale,
                    refined=refined,
                    offset=offset,
                    information=information,
                    shared=shared,
                )
            cost = normal_equations(
                C,
                t,
                camera,
                refined=refined,
                offset=offset,
                curr=curr,
                information=information,
                kind=kind,
                parameter=parameter,
                near=near,
                hessian=hessian,
                gradient=gradient,
                squared=squared,
            ) + _add_rotation_prior(
                C, C_prior, prior_information, hessian=hessian, gradient=gradient, phi=phi
            )
            stale = False
        if max_iterations == 0:
            return 0, True, cost
        copy_into(damped, hessian)
        for i in range(6):
            damped[i, i] += damping * hessian[i, i]
        if not solve_positive_definite(damped, gradient, lower, solution=step):
            if not near:
                return iteration + 1, False, cost
            near = False
            stale = True
            continue
        perturb(step, C, t, C_out=trial_C, t_out=trial_t)
        trial_cost = normal_equations(
            trial_C,
            trial_t,
            camera,
            refined=refined,
            offset=offset,
            curr=curr,
            information=information,
            kind=kind,
            parameter=parameter,
            near=accepted > 1 and damping < 1e-3,
            hessian=trial_hessian,
            gradient=trial_gradient,
            squared=trial_squared,
        ) + _add_rotation_prior(
            trial_C,
            C_prior,
            prior_information,
            hessian=trial_hessian,
            gradient=trial_gradient,
            phi=phi,
        )
        if not trial_cost <= cost * (1.0 + 1e-12):
            if near:
                near = False
                stale = True
            else:
                damping = max(1e-3, 10.0 * damping)
            continue
        decrement = float(np.sum(step * gradient))
        copy_into(C, trial_C)
        copy_into(t, trial_t)
        copy_into(hessian, trial_hessian)
        copy_into(gradient, trial_gradient)
        copy_into(squared, trial_squared)
        cost, damping, accepted, near = (
            trial_cost,
            0.1 * damping,
            accepted + 1,
            accepted > 1 and damping < 1e-3,
        )
        moved += decrement
        stale = moved > RENEW_AFTER and renewals < MAX_RENEWALS
        if decrement < tolerance * tolerance and not stale:
            return iteration + 1, moved <= RENEW_AFTER, cost
    return max_iterations, False, cost


@compiled
def _add_rotation_prior(
    C: FloatArray,
    C_prior: FloatArray,
    prior_information: FloatArray,
    hessian: FloatArray,
    gradient: FloatArray,
    phi: FloatArray,
) -> float:
    """Add ½ φᵀ Λ φ to the normal equations; returns its cost. The Jacobian of Log is taken as 1: φ
    is small."""
    rotation_error(C, C_prior, phi)
    cost = 0.0
    for i in range(3):
        for j in range(3):
            hessian[3 + i, 3 + j] += prior_information[i, j]
            gradient[3 + i] -= prior_information[i, j] * phi[j]
            cost += 0.5 * phi[i] * prior_information[i, j] * phi[j]
    return cost
