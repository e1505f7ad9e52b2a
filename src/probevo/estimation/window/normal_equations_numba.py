"""Compiled normal equations of a window; each landmark is eliminated as soon as it is added up.

For each landmark: its observations are linearised (``landmark_track_numba``), it is weighed
(``landmark_weights_numba``), and what it says of frames and rig is added up without it
(``landmark_sums_numba``). Once frames and rig have moved, the landmarks follow.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.compiled import compiled, factor, invert_symmetric_4
from probevo.estimation.window.equations import (
    FRAME,
    LANDMARK,
    PIXELS,
    RIG,
    LandmarkElimination,
    RobustNoise,
    WindowEquations,
    WindowGeometry,
    WindowLandmarks,
    WindowObservations,
)
from probevo.estimation.window.landmark_sums_numba import (
    SUMS_PER_STATE,
    Workspace,
    add_common,
    add_motions,
    add_pairs,
    couple,
    eliminate,
    factor_information,
)
from probevo.estimation.window.landmark_track_numba import (
    empty_track,
    linearize_track,
    window_problem,
)
from probevo.estimation.window.landmark_weights_numba import (
    TESTED,
    VELOCITY,
    robust_weight_of,
    static_weight,
    velocity_squared,
)

MIN_OBSERVATIONS = 3
"""Observations of a landmark that is tested: two of them show nothing but one velocity."""
MAX_SHIFT_PX = 30.0
"""No landmark lies farther than this from where its anchor frame has seen it. Where observations
contradict one another, a step may lead anywhere; so far off, rounding would spoil the sums."""


@compiled
def accumulate(
    geometry: WindowGeometry,
    observations: WindowObservations,
    landmarks: WindowLandmarks,
    noise: RobustNoise,
    equations: WindowEquations,
    elimination: LandmarkElimination,
) -> float:
    """Add the normal equations of all landmarks, each of them eliminated.

    Args:
        geometry: poses and rig.
        observations: M of them.
        landmarks: L of them.
        noise: robust loss and correlation.
        equations: receives the sums.
        elimination: receives what ``move_landmarks`` needs.

    Returns:
        The cost.
    """
    num_frames = len(geometry.T_cam_world)
    problem = window_problem(geometry, observations, landmarks, noise)
    track = empty_track(num_frames)
    work = Workspace(
        root=np.zeros((LANDMARK, LANDMARK)),
        wide=np.zeros((LANDMARK, FRAME * num_frames + RIG + 1)),
        unit=np.zeros(LANDMARK),
    )
    # A landmark moves with the motion from its anchor to a frame. What all landmarks say of one
    # such motion is summed first, so that adjoints are applied once a pair of frames.
    sums = np.zeros((num_frames, num_frames, FRAME, SUMS_PER_STATE))
    factors = np.zeros((PIXELS, SUMS_PER_STATE))
    cost = 0.0
    # Per landmark: linearise, weigh, add what involves motions and rig, and subtract what the
    # elimination of the landmark takes away.
    for row in range(len(landmarks.state)):
        squared = linearize_track(row, problem, track)
        robust = robust_weight_of(row, problem, squared)
        cost += robust.cost
        add_common(row, problem, track, robust, elimination, equations=equations)
        add_motions(row, problem, track, robust, factors, sums=sums, equations=equations)
        couple(row, problem, track, robust.curvature, elimination.coupling)
        factor_information(robust.curvature, track.common, work, elimination.inverse[row])
        eliminate(row, problem, work, elimination=elimination, equations=equations)
    # From motions between anchor and frame to the poses of both.
    add_pairs(sums, problem.adjoints, equations)
    # So far, only the lower triangle is complete.
    size = len(equations.gradient)
    for i in range(size):
        for j in range(i):
            equations.hessian[j, i] = equations.hessian[i, j]
    return cost


@compiled
def static_weights(
    geometry: WindowGeometry,
    observations: WindowObservations,
    landmarks: WindowLandmarks,
    noise: RobustNoise,
) -> FloatArray:
    """Return the weight of each landmark, [L], by a test whether it stands still.

    One with too few observations for the test keeps the weight that it has.

    Args:
        geometry: poses and rig.
        observations: M of them.
        landmarks: L of them.
        noise: robust loss and correlation.
    """
    problem = window_problem(geometry, observations, landmarks, noise)
    track = empty_track(len(geometry.T_cam_world))
    white = np.zeros((len(geometry.T_cam_world), PIXELS, VELOCITY))
    equations = np.zeros((TESTED, TESTED + 1))
    weights = landmarks.static_weight.copy()
    for row in range(len(weights)):
        count = observations.start[row + 1] - observations.start[row]
        if count >= MIN_OBSERVATIONS:
            error = landmarks.state[row, 3]
            total = linearize_track(row, problem, track)
            total += landmarks.error_information[row] * error * error
            velocity_part = velocity_squared(row, problem, track, white, equations)
            weights[row] = static_weight(row, problem, total, velocity_part)
    return weights


@compiled
def move_landmarks(
    state: FloatArray,
    observations: WindowObservations,
    elimination: LandmarkElimination,
    step: FloatArray,
    moved: FloatArray,
) -> None:
    """Fill the landmarks after a step of frames and rig, [L, 4], by back-substitution.

    Args:
        state: the landmarks before, [L, 4].
        observations: M observations of them.
        elimination: what ``accumulate`` left there.
        step: of frames and rig, [9K + 4].
        moved: receives the landmarks, [L, 4].
    """
    rig0 = len(step) - RIG
    rest = np.zeros(LANDMARK)
    for row in range(len(state)):
        # A Δ = g − B · step, with the landmark's step Δ, and the inverse of A that was left by
        # ``factor_information``.
        for i in range(LANDMARK):
            rest[i] = elimination.gradient[row, i]
            for j in range(RIG):
                rest[i] -= elimination.rig_coupling[row, i, j] * step[rig0 + j]
        for m in range(observations.start[row], observations.start[row + 1]):
            frame0 = FRAME * observations.slot[m]
            for i in range(LANDMARK):
                for j in range(FRAME):
                    rest[i] -= elimination.coupling[m, i, j] * step[frame0 + j]
        for i in range(LANDMARK):
            moved[row, i] = state[row, i]
            for j in range(LANDMARK):
                moved[row, i] += elimination.inverse[row, i, j] * rest[j]
        # Back to the first observation, where it has run away from it.
        first = observations.pixels[observations.start[row]]
        du = abs(moved[row, 0] - first[0])
        dv = abs(moved[row, 1] - first[1])
        dd = abs(moved[row, 2] - (first[0] - first[2]))
        # Negated, so that a step of NaN is caught, too.
        if not (du < MAX_SHIFT_PX and dv < MAX_SHIFT_PX and dd < MAX_SHIFT_PX):
            moved[row, 0] = first[0]
            moved[row, 1] = first[1]
            moved[row, 2] = first[0] - first[2]
            moved[row, 3] = 0.0


@compiled
def fill_roots(scale: FloatArray, root: FloatArray) -> bool:
    """Fill the Cholesky factors G of R⁻¹ = G Gᵀ, [N, 4, 4], of scale matrices R, [N, 4, 4], px².

    Returns:
        False if one is not positive definite to working precision.
    """
    inverse = np.empty((PIXELS, PIXELS))
    lower = np.zeros((PIXELS, PIXELS))
    for n in range(len(scale)):
        if not invert_symmetric_4(scale[n], inverse, lower):
            return False
        if not factor(inverse, PIXELS, root[n]):
            return False
    return True
