"""The robust weight of a landmark: by how well it fits, and by whether it stands still.

All observations of a landmark have one weight. With K observations and a prior variance τ² of δ,
the sum s = eᵀ Σ⁻¹ e + δ²/τ² has n = 4K − 3 degrees of freedom once u, v, d are fitted. All of them
share one unknown factor of scale, as those of a Student-t in n dimensions do, and so the weight
(ν + n)/(ν + s). With a weight for each observation, a landmark would look perfect that was fitted
to two of them: in Monte Carlo, covariances were then five times too small.

A car or a person that moves is no landmark. Its track contradicts the motion of the camera by c t,
with t the frames since the anchor, which may be less than the noise in each frame, so that s hardly
shows it. So each landmark is tested for a velocity c of (u, v, d) in the image (a score test, Rao
1948). With its white derivatives L by its four states and C by c, of which the part in the span of
L is projected out, and its white errors e, a velocity explains s_c = eᵀ C (Cᵀ C)⁻¹ Cᵀ e of s. That
has three degrees of freedom if the landmark stands still. Where it is larger, the weight is
multiplied by that which the loss has for three errors, (ν + 3)/(ν + s_c). So it is for a feature
that slides along an edge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled_into_callers
from probevo.estimation.window.equations import LANDMARK, PIXELS, WindowObservations
from probevo.estimation.window.landmark_track_numba import (
    COMMON_COLUMNS,
    LinearizedTrack,
    WindowProblem,
    share_of_own,
)
from probevo.measurements.robust_loss_numba import (
    INFINITE_DOF,
    STUDENT_T,
    robust_cost,
    robust_curvature,
    robust_weight,
)

VELOCITY = 3
"""Components of a velocity in the image: of u, v and d."""
TESTED = LANDMARK + VELOCITY
"""States of a landmark that is tested for a velocity."""
MIN_CURVATURE = 0.75
"""Least curvature of a landmark, over its weight. The residual of the best fit is orthogonal to its
own states, so that the Hessian along these is the weight, and steps with less than half of it
diverge. The mean curvature is less where there is one observation, with one degree of freedom."""


class RobustWeight(NamedTuple):
    """The weight of a landmark under the robust loss, with cost and curvature."""

    cost: float
    """Cost of all its observations, nats."""
    weight: float
    """IRLS weight: the factor of each pull."""
    curvature: float
    """Factor of its information. Its mean is that of the Fisher information, so that Gauss–Newton
    with it is Fisher scoring, and the inverse of what adds up is a covariance. So it is if the loss
    is that of the noise. Huber, Cauchy and Tukey weigh ordinary errors by less than 1, too, and
    the covariance is then larger than the scatter of the estimates."""


@compiled_into_callers
def robust_weight_of(row: int, problem: WindowProblem, squared: float) -> RobustWeight:
    """Weigh a landmark by how well it fits all its observations, eᵀ Σ⁻¹ e."""
    observations = problem.observations
    loss = problem.noise.loss
    count = observations.start[row + 1] - observations.start[row]
    # s = eᵀ Σ⁻¹ e + δ²/τ².
    error = problem.landmarks.state[row, 3]
    total = squared + problem.landmarks.error_information[row] * error * error
    parameter = _loss_parameter(row, observations)
    static_weight = problem.landmarks.static_weight[row]
    # n: residuals and the prior of δ, less the four states of the landmark.
    free = PIXELS * count - 3
    weight = _weight(loss, parameter, free, total)
    if loss == STUDENT_T and parameter < INFINITE_DOF:
        # With s = rᵀ r, the cost ½ (ν + n) log(1 + s/ν) has the Hessian w (I − 2 r rᵀ/(ν + s)) in
        # the white residual r. The curvature is the mean of its n eigenvalues, if that is enough.
        share = 1.0 - 2.0 / free * total / (parameter + total)
        return RobustWeight(
            cost=static_weight * 0.5 * (parameter + free) * math.log1p(total / parameter),
            weight=static_weight * weight,
            curvature=static_weight * weight * max(MIN_CURVATURE, share),
        )
    scale = free / PIXELS
    return RobustWeight(
        cost=static_weight * scale * robust_cost(loss, parameter, total / scale),
        weight=static_weight * weight,
        curvature=static_weight * robust_curvature(loss, parameter, total / scale, dimension=free),
    )


@compiled_into_callers
def _loss_parameter(row: int, observations: WindowObservations) -> float:
    """Return the one ν of a landmark: the mean of those that its observations were predicted
    with."""
    first = observations.start[row]
    end = observations.start[row + 1]
    parameter = 0.0
    for m in range(first, end):
        parameter += observations.loss_parameter[m] / (end - first)
    return parameter


@compiled_into_callers
def _weight(loss: int, parameter: float, count: int, squared: float) -> float:
    """Return the IRLS weight of n errors with one common scale, by their squared length s."""
    if loss == STUDENT_T and parameter < INFINITE_DOF:
        return (parameter + count) / (parameter + squared)
    # n/4 observations that each have the distance s/(n/4): other losses are made for one
    # observation, and take the mean.
    return robust_weight(loss, parameter, squared / (count / PIXELS))


@compiled_into_callers
def velocity_squared(
    row: int,
    problem: WindowProblem,
    track: LinearizedTrack,
    white: FloatArray,
    equations: FloatArray,
) -> float:
    """Return s_c, how much of a landmark's squared errors a velocity in the image would explain.

    Args:
        row: the landmark.
        problem: all of them.
        track: its observations.
        white: work space for the white derivatives by the velocity, [K, 4, 3].
        equations: work space for the normal equations of landmark and velocity, [7, 8].
    """
    observations = problem.observations
    first = observations.start[row]
    count = observations.start[row + 1] - first
    correlation = problem.noise.correlation
    neighbour_factor = -correlation / math.sqrt(1.0 + correlation)
    error = COMMON_COLUMNS - 1
    equations[:] = 0.0
    tested = np.empty(TESTED + 1)
    for k in range(count):
        # Derivatives of (u_l, v_l, u_r, v_r) by the velocities of u, v and d.
        m = first + k
        root = observations.root[m]
        time = float(observations.slot[m] - observations.slot[first])
        own = share_of_own(k, correlation)
        for i in range(PIXELS):
            white[k, i, 0] = time * (root[0, i] + root[2, i])
            white[k, i, 1] = time * (root[1, i] + root[3, i])
            white[k, i, 2] = -time * root[2, i]
            # The innovation of the landmark's columns, of these, and of the error.
            for j in range(LANDMARK):
                tested[j] = track.innovation[k, i, j]
            for j in range(VELOCITY):
                tested[LANDMARK + j] = own * white[k, i, j]
                if k > 0:
                    tested[LANDMARK + j] += neighbour_factor * white[k - 1, i, j]
            tested[TESTED] = track.innovation[k, i, error]
            for p in range(TESTED):
                for q in range(p + 1):
                    equations[p, q] += tested[p] * tested[q]
                equations[p, TESTED] += tested[p] * tested[TESTED]
    # The prior of the time-correlated error, δ ~ N(0, τ²).
    prior = problem.landmarks.error_information[row]
    equations[3, 3] += prior
    equations[3, TESTED] -= prior * problem.landmarks.state[row, 3]
    # With the Cholesky factor R of all seven states, the components of R⁻¹ g for the last three are
    # those of the error along the velocity that the landmark's own states do not explain.
    squared = 0.0
    for p in range(TESTED):
        for q in range(p + 1):
            rest = equations[p, q]
            for n in range(q):
                rest -= equations[p, n] * equations[q, n]
            equations[p, q] = math.sqrt(max(rest, 1e-12)) if p == q else rest / equations[q, q]
        rest = equations[p, TESTED]
        for n in range(p):
            rest -= equations[p, n] * equations[n, TESTED]
        equations[p, TESTED] = rest / equations[p, p]
        if p >= LANDMARK:
            squared += equations[p, TESTED] ** 2
    return squared


@compiled_into_callers
def static_weight(row: int, problem: WindowProblem, total: float, velocity_part: float) -> float:
    """Return the weight of a landmark with squared errors ``total``, of which a velocity explains
    ``velocity_part``: 1 if it stands still, less the more of them a velocity explains."""
    observations = problem.observations
    count = observations.start[row + 1] - observations.start[row]
    loss = problem.noise.loss
    parameter = _loss_parameter(row, observations)
    # What a velocity does not explain shows the scale of the landmark's errors, which is taken for
    # no smaller than the noise model's: few errors may be small by chance.
    others = PIXELS * count + 1 - LANDMARK - VELOCITY
    precision = min(1.0, _weight(loss, parameter, others, max(0.0, total - velocity_part)))
    return min(1.0, _weight(loss, parameter, VELOCITY, precision * velocity_part))
