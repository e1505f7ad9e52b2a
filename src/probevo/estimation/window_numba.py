"""Compiled normal equations of a window; each landmark is eliminated as soon as it is added up.

A landmark is (u, v, d, δ): its place in the left image and its disparity, both in its anchor frame
a, the first that saw it, and the disparity error δ that all its observations have in common (the
time-correlated one of the noise model). With m = ((u − c_u)/f_u, (v − c_v)/f_v, 1) and the inverse
depth ρ = d/(f_u b), it is h/ρ in frame k, where

    h = C_ka m + ρ t_ka,    prediction = (u_k, v_k, u_k − d/h_z − δ + β(x)ᵀb + δu_r, v_k + δv_r).

β(x) = (1, x, x²) and b are the disparity errors of the rig (``camera.rig_calibration``). Nothing is
divided by d, so that a landmark at infinity is nothing special.

In each frame the right camera is turned against the left one by a small jitter ω_k, which moves
what it sees by (δu_r, δv_r) = O ω_k (``camera.rig_jitter``).

Poses T_cam_world are perturbed on the left. Where ξ_ka moves a prediction by J, the poses of frame
and anchor move it by J and −J Ad(T_ka). The adjoint is that of fixed linearisation points, which
are also those of the marginalised information ("first-estimates Jacobians", Huang et al. 2010):
then a shift and turn of the whole window moves no residual, to rounding, and the window does not
gain information about where in the world it is.

Errors of successive observations of a landmark are alike: what the tracker got wrong in one frame,
it gets wrong in the next. They are taken for an AR(1) process with correlation ρ. The noise model
describes pairs of observations, R = M (1 − ρ) with M the variance of one, so that a pair counts as
it does for two frames, whatever ρ. With R_k⁻¹ = G_k G_kᵀ, the innovations (G_kᵀ e_k − ρ G_k₋₁ᵀ
e_k₋₁)/√(1 + ρ) are white, so that Σ⁻¹ is tridiagonal, with blocks G_k G_kᵀ times 1, 1 + ρ², …, 1 +
ρ², 1 on the diagonal and −ρ G_k G_k₋₁ᵀ beside it, over 1 + ρ. ρ = 0 is bundle adjustment with white
noise; ρ → 1 is a chain of frame-to-frame motions, a random walk of the track.

A landmark is trusted as a whole. With K observations and a prior variance τ² of δ, the sum s = eᵀ
Σ⁻¹ e + δ²/τ² has n = 4K − 3 degrees of freedom once u, v, d are fitted. All its
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
JITTER = 3
"""Those of the jitter of a frame, ω = (pitch, yaw, roll)."""
FRAME = POSE + JITTER
"""Those of a frame, its pose first."""
RIG = 3
"""Those of the rig's disparity errors."""
LANDMARK = 4
"""Those of a landmark."""
PIXELS = 4
"""Coordinates of an observation."""
LEAST_DEPTH = 1e-3
"""Share of its depth in the anchor frame at which a landmark counts as behind the camera."""
LARGEST_SHIFT_PX = 30.0
"""No landmark lies farther than this from where its anchor frame has seen it. Where observations
contradict one another, a step may lead anywhere; so far off, rounding would spoil the sums."""
BEHIND_CAMERA = 1e6
"""Cost, and squared distance, of an observation whose landmark has got behind the camera."""


class WindowGeometry(NamedTuple):
    """What the predictions of K frames depend on, beside the landmarks."""

    T_cam_world: FloatArray
    """Poses, [K, 4, 4], m."""
    adjoints: FloatArray
    """Ad(T_ka) at the linearisation points, for frame k and anchor a, [K, K, 9, 9]: how the
    anchor's pose enters (ξ_ka, ω_k). Zero for the jitters."""
    jitter: FloatArray
    """ω of each frame, [K, 3], rad."""
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
    """Inverse of the scale matrix R of each, at its own time, [M, 4, 4], px⁻²."""
    root: FloatArray
    """Its Cholesky factor G, R⁻¹ = G Gᵀ, [M, 4, 4], px⁻¹."""
    loss_parameter: FloatArray
    """ν of a Student-t, or the parameter of another loss, [M]."""


class WindowLandmarks(NamedTuple):
    """L landmarks."""

    state: FloatArray
    """(u, v, d, δ), [L, 4], px."""
    error_information: FloatArray
    """Prior information of δ around zero, [L], px⁻²."""


class NormalEquations(NamedTuple):
    """Normal equations: hessian · step = gradient.

    Those of ``accumulate`` are for K frames, (ξ, ω) of each, and the rig: size S = 9K + 3. With
    the jitters eliminated, they are for K poses and the rig: S = 6K + 3.
    """

    hessian: FloatArray
    """[S, S]."""
    gradient: FloatArray
    """[S]."""


class Elimination(NamedTuple):
    """What finds the L landmarks once the poses are known, and how well their observations fit."""

    coupling: FloatArray
    """Information between a landmark and the frame of each of its M observations, [M, 4, 9]; the
    first is the anchor's."""
    rig_coupling: FloatArray
    """The same for the rig, [L, 4, 3]."""
    inverse: FloatArray
    """Inverse information of each landmark for given poses, [L, 4, 4]."""
    gradient: FloatArray
    """Gradient of each landmark, [L, 4]."""
    squared: FloatArray
    """Squared Mahalanobis distance of each observation from its prediction, [M]."""


class RobustNoise(NamedTuple):
    """What all observations have in common."""

    loss: int
    """Kind of the robust loss."""
    correlation: float
    """ρ of successive errors of a landmark, 0 … 1."""


class _Problem(NamedTuple):
    """What stays the same while the landmarks are added up."""

    geometry: WindowGeometry
    observations: WindowObservations
    landmarks: WindowLandmarks
    noise: RobustNoise
    T_ka: FloatArray
    """Motions between all pairs of frames, [K, K, 4, 4], m."""


class _Track(NamedTuple):
    """The observations of one landmark, linearised; work space for up to K of them."""

    ray: FloatArray
    """h, [K, 3]: the direction to the landmark, its depth in the anchor frame being 1."""
    error: FloatArray
    """Measured minus predicted, [K, 4], px."""
    frame: FloatArray
    """Jacobian of the prediction for ζ = (ξ_ka, ω_k), [K, 4, 9]."""
    landmark: FloatArray
    """The same for the landmark, [K, 4, 4]."""
    rig: FloatArray
    """The same for the rig, of u_r alone, [K, 3]."""
    information: FloatArray
    """Diagonal blocks of Σ⁻¹, [K, 4, 4]."""
    cross: FloatArray
    """Blocks of Σ⁻¹ between an observation and the one before it, [K, 4, 4]."""
    pull: FloatArray
    """Σ⁻¹ e, [K, 4]."""
    weighted_landmark: FloatArray
    """Σ⁻¹ times the Jacobians for the landmark, [K, 4, 4]."""
    weighted_rig: FloatArray
    """Σ⁻¹ times the Jacobians for the rig, [K, 4, 3]."""


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
    """Normal equations of ζ = (ξ_ka, ω_k) for all pairs of frame and anchor.

    In its anchor frame, a landmark is where it is, whatever the pose: only the jitter counts.
    """

    hessian: FloatArray
    """[K, K, 9, 9]; lower triangles."""
    gradient: FloatArray
    """[K, K, 9]."""
    rig: FloatArray
    """Information between ζ and the rig, [K, K, 9, 3]."""
    cross: FloatArray
    """Information between ζ of a frame and that of the frame before it, [K, K, 9, 9]."""


@compiled
def accumulate(
    geometry: WindowGeometry,
    observations: WindowObservations,
    landmarks: WindowLandmarks,
    noise: RobustNoise,
    equations: NormalEquations,
    elimination: Elimination,
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
    problem = _Problem(
        geometry=geometry,
        observations=observations,
        landmarks=landmarks,
        noise=noise,
        T_ka=_relative_poses(geometry.T_cam_world),
    )
    track = _Track(
        ray=np.zeros((num_frames, 3)),
        error=np.zeros((num_frames, PIXELS)),
        frame=np.zeros((num_frames, PIXELS, FRAME)),
        landmark=np.zeros((num_frames, PIXELS, LANDMARK)),
        rig=np.zeros((num_frames, RIG)),
        information=np.zeros((num_frames, PIXELS, PIXELS)),
        cross=np.zeros((num_frames, PIXELS, PIXELS)),
        pull=np.zeros((num_frames, PIXELS)),
        weighted_landmark=np.zeros((num_frames, PIXELS, LANDMARK)),
        weighted_rig=np.zeros((num_frames, PIXELS, RIG)),
    )
    pairs = _Pairs(
        hessian=np.zeros((num_frames, num_frames, FRAME, FRAME)),
        gradient=np.zeros((num_frames, num_frames, FRAME)),
        rig=np.zeros((num_frames, num_frames, FRAME, RIG)),
        cross=np.zeros((num_frames, num_frames, FRAME, FRAME)),
    )
    own = np.zeros((LANDMARK, LANDMARK))
    wide = np.zeros((LANDMARK, FRAME * num_frames + RIG))
    cost = 0.0
    for row in range(len(landmarks.state)):
        squared = _linearize_track(row, problem, track, elimination.squared)
        trust = _trust(row, problem, squared)
        cost += trust.cost
        _add_landmark_and_rig(
            row, problem, track, trust=trust, own=own, elimination=elimination, equations=equations
        )
        _add_motions(row, problem, track, trust, pairs)
        _couple(row, problem, track, trust.curvature, elimination.coupling)
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
    slot: int,
    pixels: FloatArray,
    ray: FloatArray,
    error: FloatArray,
) -> bool:
    """Fill ray and error of one observation; False if its landmark is behind the camera."""
    fu, fv, cu, cv, baseline = geometry.intrinsics
    mx = (state[0] - cu) / fu
    my = (state[1] - cv) / fv
    disparity = state[2]
    inverse_depth = disparity / (fu * baseline)
    for i in range(3):
        ray[i] = T_ka[i, 0] * mx + T_ka[i, 1] * my + T_ka[i, 2] + T_ka[i, 3] * inverse_depth
    hz = ray[2]
    if not hz > LEAST_DEPTH:
        return False
    x = ray[0] / hz
    u = fu * x + cu
    v = fv * ray[1] / hz + cv
    rig = geometry.rig
    rig_error = rig[0] + x * (rig[1] + x * rig[2])
    u_r = u - disparity / hz - state[3] + rig_error
    # The jitter of the right camera, which sees the landmark at (x_r, y).
    x_r = x - disparity / (hz * fu)
    y = ray[1] / hz
    pitch, yaw, roll = geometry.jitter[slot]
    u_r += fu * (-x_r * y * pitch + (1.0 + x_r * x_r) * yaw - y * roll)
    v_r = v + fv * (-(1.0 + y * y) * pitch + x_r * y * yaw + x_r * roll)
    error[0] = pixels[0] - u
    error[1] = pixels[1] - v
    error[2] = pixels[2] - u_r
    error[3] = pixels[3] - v_r
    return True


@compiled
def _linearize_track(row: int, problem: _Problem, track: _Track, squared: FloatArray) -> float:
    """Fill the linearised observations of a landmark, and Σ⁻¹ times each of them.

    Args:
        row: the landmark.
        problem: all of them.
        track: receives the observations.
        squared: receives the squared distance of each observation by itself, [M].

    Returns:
        eᵀ Σ⁻¹ e.
    """
    observations = problem.observations
    state = problem.landmarks.state[row]
    first = observations.start[row]
    count = observations.start[row + 1] - first
    anchor = observations.slot[first]
    rho = problem.noise.correlation
    total = 0.0
    for k in range(count):
        m = first + k
        T = problem.T_ka[observations.slot[m], anchor]
        error = track.error[k]
        information = observations.information[m]
        track.pull[k] = 0.0
        track.cross[k] = 0.0
        if not _project(
            state,
            T,
            problem.geometry,
            slot=observations.slot[m],
            pixels=observations.pixels[m],
            ray=track.ray[k],
            error=error,
        ):
            # What is behind the camera says nothing.
            squared[m] = BEHIND_CAMERA
            total += BEHIND_CAMERA
            error[:] = 0.0
            track.information[k] = 0.0
            continue
        _linearize(state, T, problem.geometry, track, k)
        squared[m] = _product(error, information, error)
        is_inner = 0 < k < count - 1
        diagonal = (1.0 + rho * rho if is_inner else 1.0) / (1.0 + rho)
        total += diagonal * squared[m]
        _fill_scaled(information, diagonal, track.information[k])
        _add_pull(information, diagonal, error, track.pull[k])
        if k == 0 or rho == 0.0 or squared[m - 1] == BEHIND_CAMERA:
            continue
        beside = -rho / (1.0 + rho)
        between = observations.root[m] @ observations.root[m - 1].T
        total += 2.0 * beside * _product(error, between, track.error[k - 1])
        _fill_scaled(between, beside, track.cross[k])
        _add_pull(between, beside, track.error[k - 1], track.pull[k])
        _add_pull(between.T, beside, error, track.pull[k - 1])
    _weigh_jacobians(track, count)
    return total


@compiled
def _product(left: FloatArray, information: FloatArray, right: FloatArray) -> float:
    """Return leftᵀ W right of two vectors [4]."""
    total = 0.0
    for i in range(PIXELS):
        for j in range(PIXELS):
            total += left[i] * information[i, j] * right[j]
    return total


@compiled
def _fill_scaled(information: FloatArray, scale: float, scaled: FloatArray) -> None:
    """Fill a matrix, [4, 4], times a factor."""
    for i in range(PIXELS):
        for j in range(PIXELS):
            scaled[i, j] = scale * information[i, j]


@compiled
def _add_pull(information: FloatArray, scale: float, error: FloatArray, pull: FloatArray) -> None:
    """Add scale · W e, [4]."""
    for i in range(PIXELS):
        for j in range(PIXELS):
            pull[i] += scale * information[i, j] * error[j]


@compiled
def _weigh_jacobians(track: _Track, count: int) -> None:
    """Fill Σ⁻¹ times the Jacobians for landmark and rig."""
    for k in range(count):
        for i in range(PIXELS):
            for j in range(LANDMARK):
                total = 0.0
                for n in range(PIXELS):
                    total += track.information[k, i, n] * track.landmark[k, n, j]
                    if k > 0:
                        total += track.cross[k, i, n] * track.landmark[k - 1, n, j]
                    if k + 1 < count:
                        total += track.cross[k + 1, n, i] * track.landmark[k + 1, n, j]
                track.weighted_landmark[k, i, j] = total
            for j in range(RIG):
                total = track.information[k, i, 2] * track.rig[k, j]
                if k > 0:
                    total += track.cross[k, i, 2] * track.rig[k - 1, j]
                if k + 1 < count:
                    total += track.cross[k + 1, 2, i] * track.rig[k + 1, j]
                track.weighted_rig[k, i, j] = total


@compiled
def _trust(row: int, problem: _Problem, squared: float) -> _Trust:
    """Weigh a landmark by how well it fits all its observations, eᵀ Σ⁻¹ e."""
    observations = problem.observations
    loss = problem.noise.loss
    first = observations.start[row]
    end = observations.start[row + 1]
    error = problem.landmarks.state[row, 3]
    total = squared + problem.landmarks.error_information[row] * error * error
    parameter = 0.0
    for m in range(first, end):
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
    state: FloatArray, T_ka: FloatArray, geometry: WindowGeometry, track: _Track, k: int
) -> None:
    """Fill the Jacobians of observation k, at the ray where it was projected to."""
    fu, fv, _, _, baseline = geometry.intrinsics
    per_disparity = 1.0 / (fu * baseline)
    disparity = state[2]
    inverse_depth = disparity * per_disparity
    hx = track.ray[k, 0]
    hy = track.ray[k, 1]
    hz = track.ray[k, 2]
    x = hx / hz
    y = hy / hz
    # β(x) is taken where the landmark is seen; that it moves with the pose is ignored.
    track.rig[k, 0] = 1.0
    track.rig[k, 1] = x
    track.rig[k, 2] = x * x
    # ∂u/∂h, ∂v/∂h and ∂(d/h_z)/∂h.
    u_x = fu / hz
    u_z = -u_x * x
    v_y = fv / hz
    v_z = -v_y * y
    d_z = -disparity / (hz * hz)
    r_z = u_z - d_z  # ∂u_r/∂h_z
    frame = track.frame[k]
    if k > 0:
        # A motion moves h by ρ δt + φ × h.
        frame[0, 0] = u_x * inverse_depth
        frame[0, 2] = u_z * inverse_depth
        frame[0, 3] = u_z * hy
        frame[0, 4] = u_x * hz - u_z * hx
        frame[0, 5] = -u_x * hy
        frame[1, 1] = v_y * inverse_depth
        frame[1, 2] = v_z * inverse_depth
        frame[1, 3] = v_z * hy - v_y * hz
        frame[1, 4] = -v_z * hx
        frame[1, 5] = v_y * hx
        frame[2, 0] = frame[0, 0]
        frame[2, 2] = r_z * inverse_depth
        frame[2, 3] = r_z * hy
        frame[2, 4] = u_x * hz - r_z * hx
        frame[2, 5] = -u_x * hy
        for j in range(1, POSE):
            frame[3, j] = frame[1, j]
    # The jitter moves what the right camera sees; that this depends on the pose is ignored.
    x_r = x - disparity / (hz * fu)
    frame[2, 6] = -fu * x_r * y
    frame[2, 7] = fu * (1.0 + x_r * x_r)
    frame[2, 8] = -fu * y
    frame[3, 6] = -fv * (1.0 + y * y)
    frame[3, 7] = fv * x_r * y
    frame[3, 8] = fv * x_r
    # u, v and d of the landmark move h along columns of T_ka.
    landmark = track.landmark[k]
    for j in range(3):
        column = 3 if j == 2 else j
        scale = per_disparity if j == 2 else (1.0 / fu if j == 0 else 1.0 / fv)
        h_z = scale * T_ka[2, column]
        landmark[0, j] = u_x * scale * T_ka[0, column] + u_z * h_z
        landmark[1, j] = v_y * scale * T_ka[1, column] + v_z * h_z
        landmark[2, j] = landmark[0, j] - d_z * h_z
        landmark[3, j] = landmark[1, j]
    landmark[2, 2] -= 1.0 / hz
    landmark[2, 3] = -1.0


@compiled
def _add_landmark_and_rig(
    row: int,
    problem: _Problem,
    track: _Track,
    trust: _Trust,
    own: FloatArray,
    elimination: Elimination,
    equations: NormalEquations,
) -> None:
    """Fill the information of a landmark, and add to that of the rig."""
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    gradient = elimination.gradient[row]
    coupling = elimination.rig_coupling[row]
    prior = problem.landmarks.error_information[row]
    own[:] = 0.0
    own[3, 3] = trust.curvature * prior
    gradient[:] = 0.0
    gradient[3] = -trust.weight * prior * problem.landmarks.state[row, 3]
    coupling[:] = 0.0
    rig0 = len(equations.gradient) - RIG
    for k in range(count):
        for i in range(LANDMARK):
            for n in range(PIXELS):
                jacobian = track.landmark[k, n, i]
                gradient[i] += trust.weight * jacobian * track.pull[k, n]
                for j in range(i + 1):
                    own[i, j] += trust.curvature * jacobian * track.weighted_landmark[k, n, j]
                for j in range(RIG):
                    coupling[i, j] += trust.curvature * jacobian * track.weighted_rig[k, n, j]
        for i in range(RIG):
            equations.gradient[rig0 + i] += trust.weight * track.rig[k, i] * track.pull[k, 2]
            for j in range(i + 1):
                equations.hessian[rig0 + i, rig0 + j] += (
                    trust.curvature * track.rig[k, i] * track.weighted_rig[k, 2, j]
                )


@compiled
def _add_motions(row: int, problem: _Problem, track: _Track, trust: _Trust, pairs: _Pairs) -> None:
    """Add the observations of a landmark to the equations of the motions from its anchor frame,
    and of the jitters."""
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    anchor = problem.observations.slot[first]
    for k in range(count):
        slot = problem.observations.slot[first + k]
        hessian = pairs.hessian[slot, anchor]
        gradient = pairs.gradient[slot, anchor]
        rig = pairs.rig[slot, anchor]
        for i in range(FRAME):
            for n in range(PIXELS):
                jacobian = track.frame[k, n, i]
                gradient[i] += trust.weight * jacobian * track.pull[k, n]
                for j in range(RIG):
                    rig[i, j] += trust.curvature * jacobian * track.weighted_rig[k, n, j]
            for n in range(PIXELS):
                weighted = 0.0
                for q in range(PIXELS):
                    weighted += track.frame[k, q, i] * track.information[k, q, n]
                weighted *= trust.curvature
                for j in range(i + 1):
                    hessian[i, j] += weighted * track.frame[k, n, j]
        if k > 0 and problem.noise.correlation > 0.0:
            cross = pairs.cross[slot, anchor]
            for i in range(FRAME):
                for n in range(PIXELS):
                    weighted = 0.0
                    for q in range(PIXELS):
                        weighted += track.frame[k, q, i] * track.cross[k, q, n]
                    weighted *= trust.curvature
                    for j in range(FRAME):
                        cross[i, j] += weighted * track.frame[k - 1, n, j]


@compiled
def _couple(
    row: int, problem: _Problem, track: _Track, curvature: float, coupling: FloatArray
) -> None:
    """Fill the information between a landmark and the frames of its observations, [M, 4, 9]."""
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    anchor = problem.observations.slot[first]
    of_anchor = coupling[first]
    for k in range(count):
        own = coupling[first + k]
        own[:] = 0.0
        adjoint = problem.geometry.adjoints[problem.observations.slot[first + k], anchor]
        for i in range(LANDMARK):
            for n in range(PIXELS):
                weighted = curvature * track.weighted_landmark[k, n, i]
                for j in range(FRAME):
                    own[i, j] += weighted * track.frame[k, n, j]
            if k == 0:
                continue  # its pose does not matter there
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

    With A = R Rᵀ and Y = R⁻¹ B that is Yᵀ Y; only blocks of frames that saw it, and of the rig, are
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
    num_frames = end - first
    width = FRAME * num_frames + RIG
    for i in range(LANDMARK):
        for m in range(num_frames):
            for j in range(FRAME):
                wide[i, FRAME * m + j] = elimination.coupling[first + m, i, j]
        for j in range(RIG):
            wide[i, FRAME * num_frames + j] = elimination.rig_coupling[row, i, j]
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
    for p in range(num_frames + 1):
        row0 = rig0 if p == num_frames else FRAME * slots[first + p]
        for i in range(RIG if p == num_frames else FRAME):
            y0 = wide[0, FRAME * p + i]
            y1 = wide[1, FRAME * p + i]
            y2 = wide[2, FRAME * p + i]
            y3 = wide[3, FRAME * p + i]
            equations.gradient[row0 + i] -= (
                y0 * reduced[0] + y1 * reduced[1] + y2 * reduced[2] + y3 * reduced[3]
            )
            target = equations.hessian[row0 + i]
            for q in range(p + 1):
                column0 = rig0 if q == num_frames else FRAME * slots[first + q]
                for j in range(RIG if q == num_frames else FRAME):
                    k = FRAME * q + j
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
    """Add the equations of pairs to those of frames: ξ_ka = ξ_k − Ad(T_ka) ξ_a."""
    rig0 = len(equations.gradient) - RIG
    num_frames = len(adjoints)
    for k in range(num_frames):
        for a in range(k + 1):
            of_motion = pairs.hessian[k, a]
            if of_motion[-1, -1] == 0.0:
                continue  # no landmark of this anchor was seen there
            for i in range(FRAME):
                for j in range(i):
                    of_motion[j, i] = of_motion[i, j]
            adjoint = adjoints[k, a]
            of_both = of_motion @ adjoint
            of_anchor = adjoint.T @ of_both
            gradient = adjoint.T @ pairs.gradient[k, a]
            rig = adjoint.T @ pairs.rig[k, a]
            for i in range(FRAME):
                equations.gradient[FRAME * k + i] += pairs.gradient[k, a, i]
                equations.gradient[FRAME * a + i] -= gradient[i]
                for j in range(FRAME):
                    equations.hessian[FRAME * k + i, FRAME * k + j] += of_motion[i, j]
                    equations.hessian[FRAME * a + i, FRAME * a + j] += of_anchor[i, j]
                    equations.hessian[FRAME * k + i, FRAME * a + j] -= of_both[i, j]
                for j in range(RIG):
                    equations.hessian[rig0 + j, FRAME * k + i] += pairs.rig[k, a, i, j]
                    equations.hessian[rig0 + j, FRAME * a + i] -= rig[i, j]
            if a < k:
                _add_neighbours(k, a, pairs.cross[k, a], adjoints, equations)


@compiled
def _add_neighbours(
    k: int, a: int, cross: FloatArray, adjoints: FloatArray, equations: NormalEquations
) -> None:
    """Add the information between the motions from frame a to frame k and to the one before it."""
    p = k - 1
    of_prev = cross @ adjoints[p, a]
    of_curr = cross.T @ adjoints[k, a]
    of_anchor = adjoints[k, a].T @ of_prev
    for i in range(FRAME):
        for j in range(FRAME):
            equations.hessian[FRAME * k + i, FRAME * p + j] += cross[i, j]
            equations.hessian[FRAME * k + i, FRAME * a + j] -= of_prev[i, j]
            equations.hessian[FRAME * p + i, FRAME * a + j] -= of_curr[i, j]
            equations.hessian[FRAME * a + i, FRAME * a + j] += of_anchor[i, j] + of_anchor[j, i]


@compiled
def move_landmarks(
    state: FloatArray,
    observations: WindowObservations,
    elimination: Elimination,
    step: FloatArray,
    moved: FloatArray,
) -> None:
    """Fill the landmarks after a step of frames and rig, [L, 4], by back-substitution.

    Args:
        state: the landmarks before, [L, 4].
        observations: M observations of them.
        elimination: what ``accumulate`` left there.
        step: of frames and rig, [9K + 3].
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
        if not (du < LARGEST_SHIFT_PX and dv < LARGEST_SHIFT_PX and dd < LARGEST_SHIFT_PX):
            moved[row, 0] = first[0]
            moved[row, 1] = first[1]
            moved[row, 2] = first[0] - first[2]
            moved[row, 3] = 0.0
