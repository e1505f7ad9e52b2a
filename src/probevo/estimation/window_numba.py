"""Compiled normal equations of a window; each landmark is eliminated as soon as it is added up.

A landmark is (u, v, d, δ): its place in the left image and its disparity, both in its anchor frame
a, the first that saw it, and the disparity error δ that all its observations have in common (the
time-correlated one of the noise model). With m = ((u − c_u)/f_u, (v − c_v)/f_v, 1) and the inverse
depth ρ = d/(f_u b), it is h/ρ in frame k, where

    h = C_ka m + ρ t_ka,    prediction = (u_k, v_k, u_k − d/h_z − δ + β(x)ᵀb, v_k).

β(x) = (1, x, x²) and b are the disparity errors of the rig (``camera.rig_calibration``). Nothing is
divided by d, so that a landmark at infinity is nothing special.

Poses T_cam_world are perturbed on the left. Where ξ_ka moves a prediction by J, the poses of frame
and anchor move it by J and −J Ad(T_ka). The adjoint is that of fixed linearisation points, which
are also those of the marginalised information ("first-estimates Jacobians", Huang et al. 2010):
then a shift and turn of the whole window moves no residual, to rounding, and the window does not
gain information about where in the world it is.

A landmark is trusted as a whole. With K observations of scale R_k and a prior variance τ² of δ, the
sum s = Σ e_kᵀ R_k⁻¹ e_k + δ²/τ² has n = 4K − 3 degrees of freedom once u, v, d are fitted. All its
observations share one unknown factor of scale, as those of a Student-t in n dimensions do, and so
the weight (ν + n)/(ν + s). Weights of single observations would trust a landmark that its fit to
two observations has made look perfect: in Monte Carlo, covariances were then five times too small.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled
from probevo.measurements.robust_loss_numba import (
    STUDENT_T,
    robust_cost,
    robust_curvature,
    robust_weight,
)

POSE = 6
"""Degrees of freedom of a pose."""
RIG = 3
"""Those of the rig's disparity errors."""
LANDMARK = 4
"""Those of a landmark."""
PIXELS = 4
"""Coordinates of an observation."""
ROWS = 3
"""Those that are predicted differently: u_l, v and u_r. v_r has the prediction of v_l."""
LEAST_DEPTH = 1e-3
"""Share of its depth in the anchor frame at which a landmark counts as behind the camera."""
BEHIND_CAMERA = 1e6
"""Cost, and squared distance, of an observation whose landmark has got behind the camera."""


class WindowGeometry(NamedTuple):
    """What the predictions of K frames depend on, beside the landmarks."""

    T_cam_world: FloatArray
    """Poses, [K, 4, 4], m."""
    adjoints: FloatArray
    """Ad(T_ka) at the linearisation points, for frame k and anchor a, [K, K, 6, 6]."""
    rig: FloatArray
    """b, [3], px."""
    intrinsics: FloatArray
    """(f_u, f_v, c_u, c_v) in px and the baseline in m, [5]."""


class WindowObservations(NamedTuple):
    """M observations of L landmarks, sorted by landmark and then by frame: the first of each
    landmark is in its anchor frame."""

    start: IntArray
    """Where the observations of each landmark begin, and the end of all, [L + 1]."""
    slot: IntArray
    """Place of each observation's frame in the window, [M]."""
    pixels: FloatArray
    """(u_l, v_l, u_r, v_r), [M, 4], px; rows corrected by the rig's calibration."""
    information: FloatArray
    """Inverse of the scale matrix of each, at its own time, [M, 4, 4], px⁻²."""
    loss_parameter: FloatArray
    """ν of a Student-t, or the parameter of another loss, [M]."""


class WindowLandmarks(NamedTuple):
    """L landmarks."""

    state: FloatArray
    """(u, v, d, δ), [L, 4], px."""
    error_information: FloatArray
    """Prior information of δ around zero, [L], px⁻²."""


class NormalEquations(NamedTuple):
    """Normal equations of K poses and the rig: hessian · step = gradient."""

    hessian: FloatArray
    """[6K + 3, 6K + 3]."""
    gradient: FloatArray
    """[6K + 3]."""


class Elimination(NamedTuple):
    """What finds the L landmarks once the poses are known, and how well their observations fit."""

    coupling: FloatArray
    """Information between a landmark and the pose of each of its M observations, [M, 4, 6]; the
    first is the anchor's."""
    rig_coupling: FloatArray
    """The same for the rig, [L, 4, 3]."""
    inverse: FloatArray
    """Inverse information of each landmark for given poses, [L, 4, 4]."""
    gradient: FloatArray
    """Gradient of each landmark, [L, 4]."""
    squared: FloatArray
    """Squared Mahalanobis distance of each observation from its prediction, [M]."""


class _Problem(NamedTuple):
    """What stays the same while the landmarks are added up."""

    geometry: WindowGeometry
    observations: WindowObservations
    landmarks: WindowLandmarks
    loss: int
    """Kind of the robust loss."""
    T_ka: FloatArray
    """Motions between all pairs of frames, [K, K, 4, 4], m."""


class _Observation(NamedTuple):
    """One observation, linearised; both its v have the same prediction, and are added up."""

    ray: FloatArray
    """h, [3]: the direction to the landmark, its depth in the anchor frame being 1."""
    error: FloatArray
    """Measured minus predicted, [4], px."""
    pose: FloatArray
    """Jacobian of the predicted (u_l, v, u_r) for ξ_ka, [3, 6]."""
    landmark: FloatArray
    """The same for the landmark, [3, 4]."""
    rig: FloatArray
    """The same for the rig, of u_r alone, [3]."""
    information: FloatArray
    """Information about (u_l, v, u_r), weighted by the robust loss, [3, 3]."""
    pull: FloatArray
    """Information times error, weighted, [3]."""


class _Trust(NamedTuple):
    """How far a landmark is trusted."""

    cost: float
    """Of all its observations, nats."""
    weight: float
    """IRLS weight: the factor of each pull."""
    curvature: float
    """Factor of its information. Its mean is that of the Fisher information, so that Gauss–Newton
    with it is Fisher scoring, and the inverse of what adds up is a covariance."""


class _Pairs(NamedTuple):
    """Normal equations of the relative motions ξ_ka of all pairs of frame and anchor."""

    hessian: FloatArray
    """[K, K, 6, 6]; lower triangles."""
    gradient: FloatArray
    """[K, K, 6]."""
    rig: FloatArray
    """Information between motion and rig, [K, K, 6, 3]."""


@compiled
def accumulate(
    geometry: WindowGeometry,
    observations: WindowObservations,
    landmarks: WindowLandmarks,
    loss: int,
    equations: NormalEquations,
    elimination: Elimination,
) -> float:
    """Add the normal equations of all landmarks, each of them eliminated.

    Args:
        geometry: poses and rig.
        observations: M of them.
        landmarks: L of them.
        loss: kind of the robust loss.
        equations: receives the sums.
        elimination: receives what ``move_landmarks`` needs.

    Returns:
        The cost.
    """
    num_frames = len(geometry.T_cam_world)
    problem = _Problem(
        geometry=geometry,
        observations=observations,
        landmarks=landmarks,
        loss=loss,
        T_ka=_relative_poses(geometry.T_cam_world),
    )
    one = _Observation(
        ray=np.zeros(3),
        error=np.zeros(PIXELS),
        pose=np.zeros((ROWS, POSE)),
        landmark=np.zeros((ROWS, LANDMARK)),
        rig=np.zeros(RIG),
        information=np.zeros((ROWS, ROWS)),
        pull=np.zeros(ROWS),
    )
    pairs = _Pairs(
        hessian=np.zeros((num_frames, num_frames, POSE, POSE)),
        gradient=np.zeros((num_frames, num_frames, POSE)),
        rig=np.zeros((num_frames, num_frames, POSE, RIG)),
    )
    own = np.zeros((LANDMARK, LANDMARK))
    wide = np.zeros((LANDMARK, POSE * num_frames + RIG))
    cost = 0.0
    for row in range(len(landmarks.state)):
        first = observations.start[row]
        end = observations.start[row + 1]
        anchor = observations.slot[first]
        state = landmarks.state[row]
        trust = _trust(row, problem, one, squared=elimination.squared)
        cost += trust.cost
        # The prior of δ.
        own[:] = 0.0
        own[3, 3] = trust.curvature * landmarks.error_information[row]
        gradient = elimination.gradient[row]
        gradient[:] = 0.0
        gradient[3] = -trust.weight * landmarks.error_information[row] * state[3]
        elimination.coupling[first:end] = 0.0
        elimination.rig_coupling[row] = 0.0
        for m in range(first, end):
            slot = observations.slot[m]
            T = problem.T_ka[slot, anchor]
            if not _project(state, T, geometry, observations.pixels[m], one):
                continue
            _linearize(state, T, geometry, one)
            _weigh(one, observations.information[m], trust)
            _add_landmark_and_rig(one, own, gradient, elimination.rig_coupling[row], equations)
            # In its anchor frame, a landmark is where it is, whatever the pose.
            if slot != anchor:
                _add_motion(one, slot, anchor, pairs)
                _couple(
                    one,
                    geometry.adjoints[slot, anchor],
                    own=elimination.coupling[m],
                    of_anchor=elimination.coupling[first],
                )
        _eliminate(row, problem, own, wide=wide, elimination=elimination, equations=equations)
    _add_pairs(pairs, geometry.adjoints, equations)
    size = len(equations.gradient)
    for i in range(size):
        for j in range(i):
            equations.hessian[j, i] = equations.hessian[i, j]
    return cost


@compiled
def _relative_poses(T_cam_world: FloatArray) -> FloatArray:
    """Return T_ka for all pairs of frames, [K, K, 4, 4]."""
    count = len(T_cam_world)
    relative = np.zeros((count, count, 4, 4))
    for k in range(count):
        for a in range(count):
            T_ka = relative[k, a]
            T_ka[3, 3] = 1.0
            for i in range(3):
                for j in range(3):
                    for n in range(3):
                        T_ka[i, j] += T_cam_world[k, i, n] * T_cam_world[a, j, n]
                T_ka[i, 3] = T_cam_world[k, i, 3]
                for j in range(3):
                    T_ka[i, 3] -= T_ka[i, j] * T_cam_world[a, j, 3]
    return relative


@compiled
def _project(
    state: FloatArray,
    T_ka: FloatArray,
    geometry: WindowGeometry,
    pixels: FloatArray,
    one: _Observation,
) -> bool:
    """Fill ray and error of one observation; False if its landmark is behind the camera."""
    fu, fv, cu, cv, baseline = geometry.intrinsics
    mx = (state[0] - cu) / fu
    my = (state[1] - cv) / fv
    disparity = state[2]
    inverse_depth = disparity / (fu * baseline)
    for i in range(3):
        one.ray[i] = T_ka[i, 0] * mx + T_ka[i, 1] * my + T_ka[i, 2] + T_ka[i, 3] * inverse_depth
    hz = one.ray[2]
    if not hz > LEAST_DEPTH:
        return False
    x = one.ray[0] / hz
    u = fu * x + cu
    v = fv * one.ray[1] / hz + cv
    rig = geometry.rig
    rig_error = rig[0] + x * (rig[1] + x * rig[2])
    one.error[0] = pixels[0] - u
    one.error[1] = pixels[1] - v
    one.error[2] = pixels[2] - (u - disparity / hz - state[3] + rig_error)
    one.error[3] = pixels[3] - v
    return True


@compiled
def _trust(row: int, problem: _Problem, one: _Observation, squared: FloatArray) -> _Trust:
    """Weigh a landmark by how well it fits all its observations; fill their squared distances."""
    observations = problem.observations
    landmarks = problem.landmarks
    loss = problem.loss
    state = landmarks.state[row]
    first = observations.start[row]
    end = observations.start[row + 1]
    anchor = observations.slot[first]
    total = landmarks.error_information[row] * state[3] * state[3]
    parameter = 0.0
    for m in range(first, end):
        squared[m] = BEHIND_CAMERA
        T = problem.T_ka[observations.slot[m], anchor]
        if _project(state, T, problem.geometry, observations.pixels[m], one):
            squared[m] = 0.0
            for i in range(PIXELS):
                for j in range(PIXELS):
                    squared[m] += one.error[i] * observations.information[m, i, j] * one.error[j]
        total += squared[m]
        parameter += observations.loss_parameter[m] / (end - first)
    free = PIXELS * (end - first) - 3
    if loss == STUDENT_T and parameter < 1e300:
        weight = (parameter + free) / (parameter + total)
        share = 1.0 - 2.0 / free * total / (parameter + total)
        return _Trust(
            cost=0.5 * (parameter + free) * math.log1p(total / parameter),
            weight=weight,
            curvature=weight * max(0.25, share),
        )
    # Other losses are made for one observation, and take the mean.
    scale = free / PIXELS
    return _Trust(
        cost=scale * robust_cost(loss, parameter, total / scale),
        weight=robust_weight(loss, parameter, total / scale),
        curvature=robust_curvature(loss, parameter, total / scale),
    )


@compiled
def _linearize(
    state: FloatArray, T_ka: FloatArray, geometry: WindowGeometry, one: _Observation
) -> None:
    """Fill the Jacobians of one observation, at the ray where it was projected to."""
    fu, fv, _, _, baseline = geometry.intrinsics
    per_disparity = 1.0 / (fu * baseline)
    disparity = state[2]
    inverse_depth = disparity * per_disparity
    hx = one.ray[0]
    hy = one.ray[1]
    hz = one.ray[2]
    x = hx / hz
    y = hy / hz
    # β(x) is taken where the landmark is seen; that it moves with the pose is ignored.
    one.rig[0] = 1.0
    one.rig[1] = x
    one.rig[2] = x * x
    # ∂u/∂h, ∂v/∂h and ∂(d/h_z)/∂h.
    u_x = fu / hz
    u_z = -u_x * x
    v_y = fv / hz
    v_z = -v_y * y
    d_z = -disparity / (hz * hz)
    r_z = u_z - d_z  # ∂u_r/∂h_z
    # A motion moves h by ρ δt + φ × h.
    pose = one.pose
    pose[0, 0] = u_x * inverse_depth
    pose[0, 2] = u_z * inverse_depth
    pose[0, 3] = u_z * hy
    pose[0, 4] = u_x * hz - u_z * hx
    pose[0, 5] = -u_x * hy
    pose[1, 1] = v_y * inverse_depth
    pose[1, 2] = v_z * inverse_depth
    pose[1, 3] = v_z * hy - v_y * hz
    pose[1, 4] = -v_z * hx
    pose[1, 5] = v_y * hx
    pose[2, 0] = pose[0, 0]
    pose[2, 2] = r_z * inverse_depth
    pose[2, 3] = r_z * hy
    pose[2, 4] = u_x * hz - r_z * hx
    pose[2, 5] = -u_x * hy
    # u, v and d of the landmark move h along columns of T_ka.
    landmark = one.landmark
    for j in range(3):
        column = 3 if j == 2 else j
        scale = per_disparity if j == 2 else (1.0 / fu if j == 0 else 1.0 / fv)
        h_z = scale * T_ka[2, column]
        landmark[0, j] = u_x * scale * T_ka[0, column] + u_z * h_z
        landmark[1, j] = v_y * scale * T_ka[1, column] + v_z * h_z
        landmark[2, j] = landmark[0, j] - d_z * h_z
    landmark[2, 2] -= 1.0 / hz
    landmark[2, 3] = -1.0


@compiled
def _weigh(one: _Observation, information: FloatArray, trust: _Trust) -> None:
    """Fill the weighted information and pull of an observation."""
    pull_v_r = 0.0
    for i in range(PIXELS):
        pull = 0.0
        for j in range(PIXELS):
            pull += information[i, j] * one.error[j]
        if i < ROWS:
            one.pull[i] = pull
        else:
            pull_v_r = pull
    one.pull[1] += pull_v_r
    for i in range(ROWS):
        one.pull[i] *= trust.weight
        for j in range(ROWS):
            one.information[i, j] = information[i, j]
    # v_r adds to the row and the column of v_l.
    for j in range(ROWS):
        one.information[1, j] += information[3, j]
    for i in range(ROWS):
        one.information[i, 1] += information[i, 3]
    one.information[1, 1] += information[3, 3]
    for i in range(ROWS):
        for j in range(ROWS):
            one.information[i, j] *= trust.curvature


@compiled
def _add_landmark_and_rig(
    one: _Observation,
    own: FloatArray,
    gradient: FloatArray,
    rig_coupling: FloatArray,
    equations: NormalEquations,
) -> None:
    """Add an observation to the information of landmark and rig, and to that between them."""
    rig0 = len(equations.gradient) - RIG
    for i in range(LANDMARK):
        for n in range(ROWS):
            gradient[i] += one.landmark[n, i] * one.pull[n]
        weighted_right = 0.0
        for k in range(ROWS):
            weighted = 0.0
            for n in range(ROWS):
                weighted += one.landmark[n, i] * one.information[n, k]
            for j in range(i + 1):
                own[i, j] += weighted * one.landmark[k, j]
            if k == 2:
                weighted_right = weighted
        for j in range(RIG):
            rig_coupling[i, j] += weighted_right * one.rig[j]
    for i in range(RIG):
        equations.gradient[rig0 + i] += one.rig[i] * one.pull[2]
        for j in range(i + 1):
            equations.hessian[rig0 + i, rig0 + j] += one.rig[i] * one.information[2, 2] * one.rig[j]


@compiled
def _add_motion(one: _Observation, slot: int, anchor: int, pairs: _Pairs) -> None:
    """Add an observation to the equations of the motion from its anchor frame to its own."""
    hessian = pairs.hessian[slot, anchor]
    gradient = pairs.gradient[slot, anchor]
    rig = pairs.rig[slot, anchor]
    for i in range(POSE):
        for k in range(ROWS):
            gradient[i] += one.pose[k, i] * one.pull[k]
            weighted = 0.0
            for n in range(ROWS):
                weighted += one.pose[n, i] * one.information[n, k]
            for j in range(i + 1):
                hessian[i, j] += weighted * one.pose[k, j]
            if k == 2:
                for j in range(RIG):
                    rig[i, j] += weighted * one.rig[j]


@compiled
def _couple(one: _Observation, adjoint: FloatArray, own: FloatArray, of_anchor: FloatArray) -> None:
    """Fill the information between a landmark and a pose, [4, 6], and add that with the anchor."""
    for i in range(LANDMARK):
        for j in range(POSE):
            own[i, j] = 0.0
        for k in range(ROWS):
            weighted = 0.0
            for n in range(ROWS):
                weighted += one.landmark[n, i] * one.information[n, k]
            for j in range(POSE):
                own[i, j] += weighted * one.pose[k, j]
        for n in range(POSE):
            for j in range(POSE):
                of_anchor[i, j] -= own[i, n] * adjoint[n, j]


@compiled
def _eliminate(
    row: int,
    problem: _Problem,
    own: FloatArray,
    wide: FloatArray,
    elimination: Elimination,
    equations: NormalEquations,
) -> None:
    """Eliminate one landmark: subtract Bᵀ A⁻¹ B of its information A, [4, 4], and its coupling B.

    With A = R Rᵀ and Y = R⁻¹ B that is Yᵀ Y; only blocks of poses that saw it, and of the rig, are
    touched.
    """
    slots = problem.observations.slot
    first = problem.observations.start[row]
    end = problem.observations.start[row + 1]
    root = np.zeros((LANDMARK, LANDMARK))
    for i in range(LANDMARK):
        for j in range(i + 1):
            total = own[i, j]
            for n in range(j):
                total -= root[i, n] * root[j, n]
            root[i, j] = math.sqrt(max(total, 1e-12)) if i == j else total / root[j, j]
    _fill_inverse(root, elimination.inverse[row])
    num_poses = end - first
    width = POSE * num_poses + RIG
    for i in range(LANDMARK):
        for m in range(num_poses):
            for j in range(POSE):
                wide[i, POSE * m + j] = elimination.coupling[first + m, i, j]
        for j in range(RIG):
            wide[i, POSE * num_poses + j] = elimination.rig_coupling[row, i, j]
    reduced = np.zeros(LANDMARK)
    for i in range(LANDMARK):
        reduced[i] = elimination.gradient[row, i]
        for n in range(i):
            reduced[i] -= root[i, n] * reduced[n]
            for j in range(width):
                wide[i, j] -= root[i, n] * wide[n, j]
        reduced[i] /= root[i, i]
        for j in range(width):
            wide[i, j] /= root[i, i]
    # Frames ascend, so that this fills the lower triangle; the rig comes last.
    rig0 = len(equations.gradient) - RIG
    for p in range(num_poses + 1):
        row0 = rig0 if p == num_poses else POSE * slots[first + p]
        for i in range(RIG if p == num_poses else POSE):
            y0 = wide[0, POSE * p + i]
            y1 = wide[1, POSE * p + i]
            y2 = wide[2, POSE * p + i]
            y3 = wide[3, POSE * p + i]
            equations.gradient[row0 + i] -= (
                y0 * reduced[0] + y1 * reduced[1] + y2 * reduced[2] + y3 * reduced[3]
            )
            target = equations.hessian[row0 + i]
            for q in range(p + 1):
                column0 = rig0 if q == num_poses else POSE * slots[first + q]
                for j in range(RIG if q == num_poses else POSE):
                    k = POSE * q + j
                    target[column0 + j] -= (
                        y0 * wide[0, k] + y1 * wide[1, k] + y2 * wide[2, k] + y3 * wide[3, k]
                    )


@compiled
def _fill_inverse(root: FloatArray, inverse: FloatArray) -> None:
    """Fill the inverse of R Rᵀ, [4, 4], for a lower triangular R."""
    solved = np.zeros(LANDMARK)
    for column in range(LANDMARK):
        for i in range(LANDMARK):
            total = 1.0 if i == column else 0.0
            for n in range(i):
                total -= root[i, n] * solved[n]
            solved[i] = total / root[i, i]
        for i in range(LANDMARK - 1, -1, -1):
            total = solved[i]
            for n in range(i + 1, LANDMARK):
                total -= root[n, i] * inverse[n, column]
            inverse[i, column] = total / root[i, i]


@compiled
def _add_pairs(pairs: _Pairs, adjoints: FloatArray, equations: NormalEquations) -> None:
    """Add the equations of relative motions to those of poses: ξ_ka = ξ_k − Ad(T_ka) ξ_a."""
    rig0 = len(equations.gradient) - RIG
    num_frames = len(adjoints)
    for k in range(num_frames):
        for a in range(k):
            of_motion = pairs.hessian[k, a]
            if of_motion[0, 0] == 0.0:
                continue  # no landmark of this anchor was seen there
            for i in range(POSE):
                for j in range(i):
                    of_motion[j, i] = of_motion[i, j]
            adjoint = adjoints[k, a]
            of_both = of_motion @ adjoint
            of_anchor = adjoint.T @ of_both
            gradient = adjoint.T @ pairs.gradient[k, a]
            rig = adjoint.T @ pairs.rig[k, a]
            for i in range(POSE):
                equations.gradient[POSE * k + i] += pairs.gradient[k, a, i]
                equations.gradient[POSE * a + i] -= gradient[i]
                for j in range(POSE):
                    equations.hessian[POSE * k + i, POSE * k + j] += of_motion[i, j]
                    equations.hessian[POSE * a + i, POSE * a + j] += of_anchor[i, j]
                    equations.hessian[POSE * k + i, POSE * a + j] -= of_both[i, j]
                for j in range(RIG):
                    equations.hessian[rig0 + j, POSE * k + i] += pairs.rig[k, a, i, j]
                    equations.hessian[rig0 + j, POSE * a + i] -= rig[i, j]


@compiled
def move_landmarks(
    state: FloatArray,
    observations: WindowObservations,
    elimination: Elimination,
    step: FloatArray,
    moved: FloatArray,
) -> None:
    """Fill the landmarks after a step of poses and rig, [L, 4], by back-substitution.

    Args:
        state: the landmarks before, [L, 4].
        observations: M observations of them.
        elimination: what ``accumulate`` left there.
        step: of poses and rig, [6K + 3].
        moved: receives the landmarks, [L, 4].
    """
    rig0 = len(step) - RIG
    rest = np.zeros(LANDMARK)
    for row in range(len(state)):
        for i in range(LANDMARK):
            rest[i] = elimination.gradient[row, i]
            for j in range(RIG):
                rest[i] -= elimination.rig_coupling[row, i, j] * step[rig0 + j]
        for m in range(observations.start[row], observations.start[row + 1]):
            pose0 = POSE * observations.slot[m]
            for i in range(LANDMARK):
                for j in range(POSE):
                    rest[i] -= elimination.coupling[m, i, j] * step[pose0 + j]
        for i in range(LANDMARK):
            moved[row, i] = state[row, i]
            for j in range(LANDMARK):
                moved[row, i] += elimination.inverse[row, i, j] * rest[j]
