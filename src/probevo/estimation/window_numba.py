"""Compiled normal equations of a window; each landmark is eliminated as soon as it is added up.

A landmark is (u, v, d, δ): its place in the left image and its disparity, both in its anchor frame
a, the first that saw it, and the disparity error δ that all its observations have in common (the
time-correlated one of the noise model). With m = ((u − c_u)/f_u, (v − c_v)/f_v, 1) and the inverse
depth λ = d/(f_u b), it is h/λ in frame k, where

    h = C_ka m + λ t_ka,    prediction = (u_k, v_k, u_k − d/h_z − δ + β(x)ᵀb + δu_r, v_k + δv_r).

β(x) = (1, x, x²) and b are the disparity errors of the rig (``camera.rig_calibration``). Nothing is
divided by d, so that a landmark at infinity is nothing special.

What the rectification has left of the lenses' distortion moves both views of a point outwards by
κ r² of their distance from the principal point (the first radial term of Brown's model). It is
taken at the predicted place: at the observed one, whose noise is also in the error, κ and b₁ would
be biased (with white noise of 0.3 px, κ by eight times its scatter over drives).

In each frame the right camera is turned against the left one by a small jitter ω_k, which moves
what it sees by (δu_r, δv_r) = O ω_k (``camera.rig_jitter``).

Poses T_cam_world are perturbed on the left. Since T_ka = T_k T_a⁻¹, its perturbation is
ξ_ka = ξ_k − Ad(T_ka) ξ_a. Where ξ_ka moves a prediction by J, the poses of frame
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

A car or a person that moves is no landmark. Its track contradicts the motion of the camera by c t,
with t the frames since the anchor, which may be less than the noise in each frame, so that s hardly
shows it. So each landmark is tested for a velocity c of (u, v, d) in the image (a score test, Rao
1948). With its white derivatives L by its four states and C by c, of which the part in the span of
L is projected out, and its white errors e, a velocity explains s_c = eᵀ C (Cᵀ C)⁻¹ Cᵀ e of s. That
has three degrees of freedom if the landmark stands still. Where it is larger, the landmark is
trusted less, by the weight that the loss has for three errors, (ν + 3)/(ν + s_c). So is a feature
that slides along an edge.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.compiled import compiled, compiled_into_callers, factor, invert_symmetric_4
from probevo.measurements.robust_loss_numba import (
    INFINITE_DOF,
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
RIG = 4
"""Those of the rig: its disparity errors b₀, b₁, b₂ and the distortion κ of its lenses."""
LENS = 3
"""Which of these is κ."""
LANDMARK = 4
"""Those of a landmark."""
PIXELS = 4
"""Coordinates of an observation."""
# The columns of a linearised observation: ζ = (ξ_ka, ω_k) of its frame, the landmark, the rig, and
# the error.
_COLUMNS = FRAME + LANDMARK + RIG + 1
"""Columns of a linearised observation: frame, landmark, rig, and the error."""
_RIG = FRAME + LANDMARK
"""Where those of the rig begin among them."""
_ERROR = _RIG + RIG
"""Which of them is the error."""
_COMMON = LANDMARK + RIG + 1
"""Those of states that all observations of a landmark have in common, and the error."""
# The sums for each state of ζ_k: its information with ζ_k, with ζ of the frame before and with the
# rig, and its gradient.
_WITH_PREV = FRAME
"""Where the information between a motion and the one before it begins among the sums of pairs."""
_WITH_RIG = _WITH_PREV + FRAME
"""Where that between a motion and the rig begins."""
_GRADIENT = _WITH_RIG + RIG
"""Which of the sums of pairs is the gradient."""
VELOCITY = 3
"""Components of a velocity in the image: of u, v and d."""
_TESTED = LANDMARK + VELOCITY
"""States of a landmark that is tested for a velocity."""
FEWEST_TESTED = 3
"""Observations of a landmark that is tested: two of them show nothing but one velocity."""
_PAIR = 24
"""Number of sums for each state of a motion, rounded up to whole vectors of the processor."""
LEAST_DEPTH = 1e-3
"""Share of its depth in the anchor frame at which a landmark counts as behind the camera."""
LARGEST_SHIFT_PX = 30.0
"""No landmark lies farther than this from where its anchor frame has seen it. Where observations
contradict one another, a step may lead anywhere; so far off, rounding would spoil the sums."""
BEHIND_CAMERA = 1e6
"""Squared distance of an observation whose landmark has got behind the camera."""


class WindowGeometry(NamedTuple):
    """What the predictions of K frames depend on, beside the landmarks."""

    T_cam_world: FloatArray
    """Poses, [K, 4, 4], m."""
    T_linear: FloatArray
    """Linearisation points of the poses, [K, 4, 4], m."""
    jitter: FloatArray
    """ω of each frame, [K, 3], rad."""
    rig: FloatArray
    """(b₀, b₁, b₂) in px and κ, [4]."""
    intrinsics: FloatArray
    """(f_u, f_v, c_u, c_v) in px and the baseline in m, [5]."""


class WindowObservations(NamedTuple):
    """M observations of L landmarks, sorted by landmark and then by frame.

    The first of each landmark is in its anchor frame, and the others are in later frames, in their
    order. Frames between two of them, such as blind ones, may not have seen the landmark.
    """

    start: IntArray
    """Where the observations of each landmark begin, and the end of all, [L + 1]."""
    slot: IntArray
    """Place of each observation's frame in the window, [M]."""
    pixels: FloatArray
    """(u_l, v_l, u_r, v_r), [M, 4], px; rows corrected by the rig's calibration."""
    root: FloatArray
    """Cholesky factor G of R⁻¹ = G Gᵀ, with the scale matrix R of each at its own time, [M, 4, 4],
    px⁻¹."""
    loss_parameter: FloatArray
    """ν of a Student-t, or the parameter of another loss, [M]."""


class WindowLandmarks(NamedTuple):
    """L landmarks."""

    state: FloatArray
    """(u, v, d, δ), [L, 4], px."""
    error_information: FloatArray
    """Prior information of δ around zero, [L], px⁻²."""
    standing: FloatArray
    """Factor of how far each is trusted, [L]: 1, and less for one that seems to move by itself
    (``standing_factors``)."""
    bias: FloatArray
    """Mean error of the last observation of each, [L, 4], px, which was taken off: the noise
    model's mean of each step's residual, summed up along the track."""


class WindowEquations(NamedTuple):
    """Normal equations: hessian · step = gradient.

    Those of ``accumulate`` are for K frames, (ξ, ω) of each, and the rig: size S = 9K + 4. With
    the jitters eliminated, they are for K poses and the rig: S = 6K + 4.
    """

    hessian: FloatArray
    """[S, S]."""
    gradient: FloatArray
    """[S]."""


class Elimination(NamedTuple):
    """What finds the L landmarks once the poses are known."""

    coupling: FloatArray
    """Information between a landmark and the frame of each of its M observations, [M, 4, 9]; the
    first is the anchor's."""
    rig_coupling: FloatArray
    """The same for the rig, [L, 4, 4]."""
    inverse: FloatArray
    """Inverse information of each landmark for given poses, [L, 4, 4]."""
    gradient: FloatArray
    """Gradient of each landmark, [L, 4]."""


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
    adjoints: FloatArray
    """Ad(T_ka) at the linearisation points, for frame k and anchor a, [K, K, 6, 6]."""


class _Track(NamedTuple):
    """The observations of one landmark, linearised; work space for up to K of them.

    The columns are the derivatives of a prediction for ζ = (ξ_ka, ω_k), for the landmark and for
    the rig, and the error, measured minus predicted. All but the first nine are of states that
    successive observations have in common.
    """

    ray: FloatArray
    """h, [3]: the direction to the landmark, its depth in the anchor frame being 1."""
    raw: FloatArray
    """In pixels, [K, 4, 18]."""
    white: FloatArray
    """The same times Gᵀ, so that each observation by itself has unit covariance, [K, 4, 18]."""
    innovation: FloatArray
    """White along the track, too: the common columns of the innovations, [K, 4, 9]."""
    weighted: FloatArray
    """The transpose of what makes innovations, times the innovations, [K, 4, 9]: its product with
    the transpose of a white column is one with Σ⁻¹."""
    common: FloatArray
    """Products of the common columns, summed over the innovations, [9, 9]; lower triangle."""


class _Trust(NamedTuple):
    """How far a landmark is trusted."""

    cost: float
    """Of all its observations, nats."""
    weight: float
    """IRLS weight: the factor of each pull."""
    curvature: float
    """Factor of its information. Its mean is that of the Fisher information, so that Gauss–Newton
    with it is Fisher scoring, and the inverse of what adds up is a covariance. So it is if the loss
    is that of the noise. Huber, Cauchy and Tukey weigh ordinary errors by less than 1, too, and
    the covariance is then larger than the scatter of the estimates."""


class _Workspace(NamedTuple):
    """Arrays for the elimination of one landmark."""

    root: FloatArray
    """Cholesky factor R of its information, [4, 4]."""
    wide: FloatArray
    """R⁻¹ times its coupling to frames, rig and gradient, [4, 9K + 5]."""
    unit: FloatArray
    """[4]."""


@compiled
def accumulate(
    geometry: WindowGeometry,
    observations: WindowObservations,
    landmarks: WindowLandmarks,
    noise: RobustNoise,
    equations: WindowEquations,
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
    problem = _problem_of(geometry, observations, landmarks, noise)
    track = _empty_track(num_frames)
    work = _Workspace(
        root=np.zeros((LANDMARK, LANDMARK)),
        wide=np.zeros((LANDMARK, FRAME * num_frames + RIG + 1)),
        unit=np.zeros(LANDMARK),
    )
    # A landmark moves with the motion from its anchor to a frame. What all landmarks say of one
    # such motion is summed first, so that adjoints are applied once a pair of frames.
    sums = np.zeros((num_frames, num_frames, FRAME, _PAIR))
    factors = np.zeros((PIXELS, _PAIR))
    cost = 0.0
    # Per landmark: linearise, weigh, add what involves motions and rig, and subtract what the
    # elimination of the landmark takes away.
    for row in range(len(landmarks.state)):
        squared = _linearize_track(row, problem, track)
        trust = _trust(row, problem, squared)
        cost += trust.cost
        _add_common(row, problem, track, trust, elimination, equations=equations)
        _add_motions(row, problem, track, trust, factors, sums=sums, equations=equations)
        _couple(row, problem, track, trust.curvature, elimination.coupling)
        _factor(trust.curvature, track.common, work, elimination.inverse[row])
        _eliminate(row, problem, work, elimination=elimination, equations=equations)
    # From motions between anchor and frame to the poses of both.
    _add_pairs(sums, problem.adjoints, equations)
    # So far, only the lower triangle is complete.
    size = len(equations.gradient)
    for i in range(size):
        for j in range(i):
            equations.hessian[j, i] = equations.hessian[i, j]
    return cost


@compiled
def standing_factors(
    geometry: WindowGeometry,
    observations: WindowObservations,
    landmarks: WindowLandmarks,
    noise: RobustNoise,
) -> FloatArray:
    """Return the factor of how far each landmark is trusted to stand still, [L].

    One with too few observations for the test keeps the factor that it has.

    Args:
        geometry: poses and rig.
        observations: M of them.
        landmarks: L of them.
        noise: robust loss and correlation.
    """
    problem = _problem_of(geometry, observations, landmarks, noise)
    track = _empty_track(len(geometry.T_cam_world))
    white = np.zeros((len(geometry.T_cam_world), PIXELS, VELOCITY))
    equations = np.zeros((_TESTED, _TESTED + 1))
    factors = landmarks.standing.copy()
    for row in range(len(factors)):
        count = observations.start[row + 1] - observations.start[row]
        if count >= FEWEST_TESTED:
            error = landmarks.state[row, 3]
            total = _linearize_track(row, problem, track)
            total += landmarks.error_information[row] * error * error
            of_velocity = _velocity_squared(row, problem, track, white, equations)
            factors[row] = _standing_factor(row, problem, total, of_velocity)
    return factors


@compiled_into_callers
def _velocity_squared(
    row: int, problem: _Problem, track: _Track, white: FloatArray, equations: FloatArray
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
    of_neighbour = -correlation / math.sqrt(1.0 + correlation)
    error = _COMMON - 1
    equations[:] = 0.0
    tested = np.empty(_TESTED + 1)
    for k in range(count):
        # Derivatives of (u_l, v_l, u_r, v_r) by the velocities of u, v and d.
        m = first + k
        root = observations.root[m]
        time = float(observations.slot[m] - observations.slot[first])
        own = _share_of_own(k, correlation)
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
                    tested[LANDMARK + j] += of_neighbour * white[k - 1, i, j]
            tested[_TESTED] = track.innovation[k, i, error]
            for p in range(_TESTED):
                for q in range(p + 1):
                    equations[p, q] += tested[p] * tested[q]
                equations[p, _TESTED] += tested[p] * tested[_TESTED]
    # The prior of the time-correlated error, δ ~ N(0, τ²).
    prior = problem.landmarks.error_information[row]
    equations[3, 3] += prior
    equations[3, _TESTED] -= prior * problem.landmarks.state[row, 3]
    # With the Cholesky factor R of all seven states, the components of R⁻¹ g for the last three are
    # those of the error along the velocity that the landmark's own states do not explain.
    squared = 0.0
    for p in range(_TESTED):
        for q in range(p + 1):
            rest = equations[p, q]
            for n in range(q):
                rest -= equations[p, n] * equations[q, n]
            equations[p, q] = math.sqrt(max(rest, 1e-12)) if p == q else rest / equations[q, q]
        rest = equations[p, _TESTED]
        for n in range(p):
            rest -= equations[p, n] * equations[n, _TESTED]
        equations[p, _TESTED] = rest / equations[p, p]
        if p >= LANDMARK:
            squared += equations[p, _TESTED] ** 2
    return squared


@compiled_into_callers
def _standing_factor(row: int, problem: _Problem, total: float, of_velocity: float) -> float:
    """Return the factor of a landmark with squared errors ``total``, s_c of which a velocity
    explains."""
    observations = problem.observations
    count = observations.start[row + 1] - observations.start[row]
    loss = problem.noise.loss
    parameter = _loss_parameter(row, observations)
    # What a velocity does not explain shows the scale of the landmark's errors, which is taken for
    # no smaller than the noise model's: few errors may be small by chance.
    others = PIXELS * count + 1 - LANDMARK - VELOCITY
    precision = min(1.0, _weight(loss, parameter, others, max(0.0, total - of_velocity)))
    return min(1.0, _weight(loss, parameter, VELOCITY, precision * of_velocity))


@compiled
def _problem_of(
    geometry: WindowGeometry,
    observations: WindowObservations,
    landmarks: WindowLandmarks,
    noise: RobustNoise,
) -> _Problem:
    return _Problem(
        geometry=geometry,
        observations=observations,
        landmarks=landmarks,
        noise=noise,
        T_ka=_relative_poses(geometry.T_cam_world),
        adjoints=_adjoints(_relative_poses(geometry.T_linear)),
    )


@compiled
def _empty_track(num_frames: int) -> _Track:
    """Return work space for the observations of one landmark."""
    return _Track(
        ray=np.zeros(3),
        raw=np.zeros((num_frames, PIXELS, _COLUMNS)),
        white=np.zeros((num_frames, PIXELS, _COLUMNS)),
        innovation=np.zeros((num_frames, PIXELS, _COMMON)),
        weighted=np.zeros((num_frames, PIXELS, _COMMON)),
        common=np.zeros((_COMMON, _COMMON)),
    )


@compiled
def _relative_poses(T_cam_world: FloatArray) -> FloatArray:
    """Return T_ka for all pairs of frames, [K, K, 4, 4]."""
    count = len(T_cam_world)
    relative = np.zeros((count, count, 4, 4))
    for k in range(count):
        for a in range(count):
            # C_ka = C_k C_aᵀ, t_ka = t_k − C_ka t_a.
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
def _adjoints(T: FloatArray) -> FloatArray:
    """Return Ad(T) = [[C, t^ C], [0, C]] of motions, [K, K, 4, 4] to [K, K, 6, 6]."""
    count = len(T)
    adjoints = np.zeros((count, count, POSE, POSE))
    for k in range(count):
        for a in range(count):
            T_ka = T[k, a]
            adjoint = adjoints[k, a]
            x = T_ka[0, 3]
            y = T_ka[1, 3]
            z = T_ka[2, 3]
            for j in range(3):
                for i in range(3):
                    adjoint[i, j] = adjoint[3 + i, 3 + j] = T_ka[i, j]
                adjoint[0, 3 + j] = y * T_ka[2, j] - z * T_ka[1, j]
                adjoint[1, 3 + j] = z * T_ka[0, j] - x * T_ka[2, j]
                adjoint[2, 3 + j] = x * T_ka[1, j] - y * T_ka[0, j]
    return adjoints


@compiled_into_callers
def _linearize_track(row: int, problem: _Problem, track: _Track) -> float:
    """Fill the linearised observations of a landmark and their innovations.

    Args:
        row: the landmark.
        problem: all of them.
        track: receives the observations.

    Returns:
        eᵀ Σ⁻¹ e.
    """
    observations = problem.observations
    state = problem.landmarks.state[row]
    intrinsics = problem.geometry.intrinsics
    # Observation m = first + k of the window is the k-th of this landmark, k = 0 that of its
    # anchor.
    first = observations.start[row]
    count = observations.start[row + 1] - first
    anchor = observations.slot[first]
    total = 0.0
    # Each observation by itself: Jacobians and error, and the same white.
    for k in range(count):
        m = first + k
        slot = observations.slot[m]
        T_ka = problem.T_ka[slot, anchor]
        white = track.white[k]
        if not _project(state, T_ka, problem.geometry, track.ray):
            # What is behind the camera says nothing.
            total += BEHIND_CAMERA
            white[:] = 0.0
            continue
        _linearize(state, T_ka, intrinsics, k == 0, ray=track.ray, raw=track.raw[k])
        _fill_errors(
            state,
            problem.geometry,
            problem.geometry.jitter[slot],
            pixels=observations.pixels[m],
            ray=track.ray,
            raw=track.raw[k],
        )
        _whiten(observations.root[m], track.raw[k], white)
    # All of them together: the squared length of the innovations.
    _fill_innovations(count, problem.noise.correlation, track)
    # The last common column is the error, so that this sums eᵀ Σ⁻¹ e.
    last = _COMMON - 1
    for k in range(count):
        for n in range(PIXELS):
            total += track.innovation[k, n, last] * track.innovation[k, n, last]
    return total


@compiled_into_callers
def _project(
    state: FloatArray, T_ka: FloatArray, geometry: WindowGeometry, ray: FloatArray
) -> bool:
    """Fill the direction to a landmark in a frame; False if it is behind the camera."""
    intrinsics = geometry.intrinsics
    # h = C_ka m + λ t_ka, with λ = d/(f_u b): the point in frame k, over its depth in the anchor
    # frame. So h_z is the ratio of the depths in both frames.
    mx = (state[0] - intrinsics[2]) / intrinsics[0]
    my = (state[1] - intrinsics[3]) / intrinsics[1]
    inverse_depth = state[2] / (intrinsics[0] * intrinsics[4])
    for i in range(3):
        ray[i] = T_ka[i, 0] * mx + T_ka[i, 1] * my + T_ka[i, 2] + T_ka[i, 3] * inverse_depth
    return bool(ray[2] > LEAST_DEPTH)


@compiled_into_callers
def _fill_errors(
    state: FloatArray,
    geometry: WindowGeometry,
    jitter: FloatArray,
    pixels: FloatArray,
    ray: FloatArray,
    raw: FloatArray,
) -> None:
    """Fill the errors of an observation, measured minus predicted, px; the Jacobians are filled."""
    fu = geometry.intrinsics[0]
    fv = geometry.intrinsics[1]
    cu = geometry.intrinsics[2]
    cv = geometry.intrinsics[3]
    # The rectified camera without any errors: normalised (x, y), disparity d/h_z, and pixels.
    per_depth = 1.0 / ray[2]
    x = ray[0] * per_depth
    y = ray[1] * per_depth
    disparity = state[2] * per_depth
    u = fu * x + cu
    v = fv * y + cv
    u_r = u - disparity
    # β(x)ᵀ b is true minus measured disparity: it makes the measured one smaller, and u_r larger.
    rig = geometry.rig
    rig_error = rig[0] + x * (rig[1] + x * rig[2])
    # The jitter of the right camera, which sees the landmark at (x_r, y).
    x_r = x - disparity / fu
    pitch = jitter[0]
    yaw = jitter[1]
    roll = jitter[2]
    of_jitter_u = fu * (-x_r * y * pitch + (1.0 + x_r * x_r) * yaw - y * roll)
    of_jitter_v = fv * (-(1.0 + y * y) * pitch + x_r * y * yaw + x_r * roll)
    # Predictions are linear in κ, so that its effect is κ times its Jacobian column.
    u += rig[LENS] * raw[0, _RIG + LENS]
    v += rig[LENS] * raw[1, _RIG + LENS]
    u_r += rig[LENS] * raw[2, _RIG + LENS]
    raw[0, _ERROR] = pixels[0] - u
    raw[1, _ERROR] = pixels[1] - v
    raw[2, _ERROR] = pixels[2] - (u_r - state[3] + rig_error + of_jitter_u)
    raw[3, _ERROR] = pixels[3] - (v + of_jitter_v)


@compiled_into_callers
def _whiten(root: FloatArray, raw: FloatArray, white: FloatArray) -> None:
    """Fill Gᵀ times the columns of an observation, [4, 18], for its R⁻¹ = G Gᵀ."""
    for i in range(PIXELS):
        g0 = root[0, i]
        g1 = root[1, i]
        g2 = root[2, i]
        g3 = root[3, i]
        for j in range(_COLUMNS):
            white[i, j] = g0 * raw[0, j] + g1 * raw[1, j] + g2 * raw[2, j] + g3 * raw[3, j]


@compiled_into_callers
def _fill_innovations(count: int, correlation: float, track: _Track) -> None:
    """Fill the innovations of the common columns, and these weighted.

    z_k = s_k a_k − ρ s a_k₋₁ of the white columns a_k, and in turn s_k z_k − ρ s z_k₊₁.
    """
    # s = 1/√(1 + ρ); the innovation of the anchor's observation, which none precedes, is √(1 − ρ)
    # a₀. Its square and the ρ²/(1 + ρ) of the next one add up to the first block of Σ⁻¹, 1/(1 + ρ).
    scale = 1.0 / math.sqrt(1.0 + correlation)
    of_neighbour = -correlation * scale
    for k in range(count):
        own = _share_of_own(k, correlation)
        for n in range(PIXELS):
            for j in range(_COMMON):
                track.innovation[k, n, j] = own * track.white[k, n, FRAME + j]
        if k > 0:
            for n in range(PIXELS):
                for j in range(_COMMON):
                    track.innovation[k, n, j] += of_neighbour * track.white[k - 1, n, FRAME + j]
    # The transposed map, since aᵀ Σ⁻¹ b = (L a)ᵀ (L b) for the map L to innovations.
    for k in range(count):
        own = _share_of_own(k, correlation)
        for n in range(PIXELS):
            for j in range(_COMMON):
                track.weighted[k, n, j] = own * track.innovation[k, n, j]
        if k + 1 < count:
            for n in range(PIXELS):
                for j in range(_COMMON):
                    track.weighted[k, n, j] += of_neighbour * track.innovation[k + 1, n, j]


@compiled
def _share_of_own(k: int, correlation: float) -> float:
    """Return s_k, the factor of observation k in its innovation."""
    if k == 0:
        return math.sqrt(1.0 - correlation)
    return 1.0 / math.sqrt(1.0 + correlation)


@compiled_into_callers
def _trust(row: int, problem: _Problem, squared: float) -> _Trust:
    """Weigh a landmark by how well it fits all its observations, eᵀ Σ⁻¹ e."""
    observations = problem.observations
    loss = problem.noise.loss
    count = observations.start[row + 1] - observations.start[row]
    # s = eᵀ Σ⁻¹ e + δ²/τ².
    error = problem.landmarks.state[row, 3]
    total = squared + problem.landmarks.error_information[row] * error * error
    parameter = _loss_parameter(row, observations)
    standing = problem.landmarks.standing[row]
    # n: residuals and the prior of δ, less the four states of the landmark.
    free = PIXELS * count - 3
    weight = _weight(loss, parameter, free, total)
    if loss == STUDENT_T and parameter < INFINITE_DOF:
        # With s = rᵀ r, the cost ½ (ν + n) log(1 + s/ν) has the Hessian w (I − 2 r rᵀ/(ν + s)) in
        # the white residual r. The curvature is the mean of its n eigenvalues, kept positive.
        share = 1.0 - 2.0 / free * total / (parameter + total)
        return _Trust(
            cost=standing * 0.5 * (parameter + free) * math.log1p(total / parameter),
            weight=standing * weight,
            curvature=standing * weight * max(0.25, share),
        )
    scale = free / PIXELS
    return _Trust(
        cost=standing * scale * robust_cost(loss, parameter, total / scale),
        weight=standing * weight,
        curvature=standing * robust_curvature(loss, parameter, total / scale, dimension=free),
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
def _linearize(
    state: FloatArray,
    T_ka: FloatArray,
    intrinsics: FloatArray,
    is_anchor: bool,
    ray: FloatArray,
    raw: FloatArray,
) -> None:
    """Fill the Jacobians of an observation, [4, 18], at the ray where it was projected to.

    Only entries that are not always zero are written. The first observation of every track is that
    of the anchor, so that the columns of ξ_ka remain zero there.
    """
    fu = intrinsics[0]
    fv = intrinsics[1]
    per_u = 1.0 / fu
    per_v = 1.0 / fv
    per_disparity = per_u / intrinsics[4]
    disparity = state[2]
    inverse_depth = disparity * per_disparity
    hx = ray[0]
    hy = ray[1]
    hz = ray[2]
    per_depth = 1.0 / hz
    x = hx * per_depth
    y = hy * per_depth
    # β(x) is taken where the landmark is seen; that it moves with the pose is ignored.
    raw[2, _RIG] = 1.0
    raw[2, _RIG + 1] = x
    raw[2, _RIG + 2] = x * x
    # u = f_u h_x/h_z + c_u, v = f_v h_y/h_z + c_v.
    # ∂u/∂h, ∂v/∂h and ∂(d/h_z)/∂h.
    u_x = fu * per_depth
    u_z = -u_x * x
    v_y = fv * per_depth
    v_z = -v_y * y
    d_z = -disparity * per_depth * per_depth
    r_z = u_z - d_z  # ∂u_r/∂h_z
    if not is_anchor:
        # A motion moves h by λ δt + φ × h.
        raw[0, 0] = u_x * inverse_depth
        raw[0, 2] = u_z * inverse_depth
        raw[0, 3] = u_z * hy
        raw[0, 4] = u_x * hz - u_z * hx
        raw[0, 5] = -u_x * hy
        raw[1, 1] = v_y * inverse_depth
        raw[1, 2] = v_z * inverse_depth
        raw[1, 3] = v_z * hy - v_y * hz
        raw[1, 4] = -v_z * hx
        raw[1, 5] = v_y * hx
        raw[2, 0] = raw[0, 0]
        raw[2, 2] = r_z * inverse_depth
        raw[2, 3] = r_z * hy
        raw[2, 4] = u_x * hz - r_z * hx
        raw[2, 5] = raw[0, 5]
        for j in range(1, POSE):  # v_r moves as v does
            raw[3, j] = raw[1, j]
    x_r = x - disparity * per_depth * per_u
    # κ moves both views outwards; rows are calibrated apart, so that v_r moves as v does.
    squared = x * x + y * y
    squared_r = x_r * x_r + y * y
    raw[0, _RIG + LENS] = fu * x * squared
    raw[1, _RIG + LENS] = fv * y * squared
    raw[2, _RIG + LENS] = fu * x_r * squared_r
    raw[3, _RIG + LENS] = raw[1, _RIG + LENS]
    # The jitter moves what the right camera sees; that this depends on the pose is ignored.
    raw[2, POSE] = -fu * x_r * y
    raw[2, POSE + 1] = fu * (1.0 + x_r * x_r)
    raw[2, POSE + 2] = -fu * y
    raw[3, POSE] = -fv * (1.0 + y * y)
    raw[3, POSE + 1] = fv * x_r * y
    raw[3, POSE + 2] = fv * x_r
    # u, v and d of the landmark move h along columns of T_ka: ∂h/∂u = C e_x/f_u, ∂h/∂v = C e_y/f_v,
    # ∂h/∂d = t/(f_u b).
    for j in range(3):
        column = 3 if j == 2 else j  # d moves h along the translation
        scale = per_disparity
        if j == 0:
            scale = per_u
        elif j == 1:
            scale = per_v
        h_z = scale * T_ka[2, column]
        of_u = u_x * scale * T_ka[0, column] + u_z * h_z
        of_v = v_y * scale * T_ka[1, column] + v_z * h_z
        raw[0, FRAME + j] = of_u
        raw[1, FRAME + j] = of_v
        raw[2, FRAME + j] = of_u - d_z * h_z
        raw[3, FRAME + j] = of_v
    # u_r = u − d/h_z − δ depends on d and δ directly, too.
    raw[2, FRAME + 2] -= per_depth
    raw[2, FRAME + 3] = -1.0


@compiled_into_callers
def _add_common(
    row: int,
    problem: _Problem,
    track: _Track,
    trust: _Trust,
    elimination: Elimination,
    equations: WindowEquations,
) -> None:
    """Fill the gradient of a landmark and its information with the rig; add to those of the rig."""
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    # Innovations z are white, so that products with Σ⁻¹ are sums of z zᵀ.
    common = track.common
    common[:] = 0.0
    for k in range(count):
        z = track.innovation[k]
        for i in range(_COMMON):
            z0 = z[0, i]
            z1 = z[1, i]
            z2 = z[2, i]
            z3 = z[3, i]
            for j in range(_COMMON):
                common[i, j] += z0 * z[0, j] + z1 * z[1, j] + z2 * z[2, j] + z3 * z[3, j]
    error = _COMMON - 1
    # The prior of the time-correlated error, δ ~ N(0, τ²).
    prior = problem.landmarks.error_information[row]
    common[3, 3] += prior
    common[3, error] -= prior * problem.landmarks.state[row, 3]
    for i in range(LANDMARK):
        elimination.gradient[row, i] = trust.weight * common[i, error]
        for j in range(RIG):
            elimination.rig_coupling[row, i, j] = trust.curvature * common[i, LANDMARK + j]
    # Gradients have the IRLS weight, Hessians the curvature; of the latter, only the lower
    # triangle.
    rig0 = len(equations.gradient) - RIG
    for i in range(RIG):
        equations.gradient[rig0 + i] += trust.weight * common[LANDMARK + i, error]
        for j in range(i + 1):
            equations.hessian[rig0 + i, rig0 + j] += (
                trust.curvature * common[LANDMARK + i, LANDMARK + j]
            )


@compiled_into_callers
def _add_motions(
    row: int,
    problem: _Problem,
    track: _Track,
    trust: _Trust,
    factors: FloatArray,
    sums: FloatArray,
    equations: WindowEquations,
) -> None:
    """Add the observations of a landmark to the equations of the motions from its anchor frame,
    and of the jitters.

    What correlates an observation with the one before it is part of the sums where that is of the
    frame before. Behind frames that did not see the landmark it is added by itself.

    Args:
        row: the landmark.
        problem: all of them.
        track: its observations.
        trust: its weights.
        factors: work space, [4, 24].
        sums: receives the sums over frame and anchor, [K, K, 9, 24] (``_add_pairs``).
        equations: receives what the sums have no place for.
    """
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    anchor = problem.observations.slot[first]
    correlation = problem.noise.correlation
    # Blocks of Σ⁻¹ (above): s_k² + ρ²/(1 + ρ) on the diagonal, the last one without the second
    # term, and −ρ/(1 + ρ) beside it.
    from_next = correlation * correlation / (1.0 + correlation)
    off_diagonal = -correlation / (1.0 + correlation)
    for k in range(count):
        # What the columns of ζ_k are multiplied with below: themselves times their block of Σ⁻¹,
        # and those of the rig and of the error times their row of it.
        white = track.white[k]
        diagonal = _share_of_own(k, correlation) ** 2
        if k + 1 < count:
            diagonal += from_next
        for n in range(PIXELS):
            for j in range(FRAME):
                factors[n, j] = trust.curvature * diagonal * white[n, j]
            for j in range(RIG):
                factors[n, _WITH_RIG + j] = trust.curvature * track.weighted[k, n, LANDMARK + j]
            factors[n, _GRADIENT] = trust.weight * track.weighted[k, n, _COMMON - 1]
        # With the observation before, −ρ/(1 + ρ) times the white columns of both: in the sums, if
        # that is of the frame before.
        slot = problem.observations.slot[first + k]
        prev_slot = problem.observations.slot[first + k - 1] if k > 0 else slot - 1
        is_next = prev_slot == slot - 1
        for n in range(PIXELS):
            for j in range(FRAME):
                prev = track.white[k - 1, n, j] if k > 0 and is_next else 0.0
                factors[n, _WITH_PREV + j] = trust.curvature * off_diagonal * prev
        if not is_next:
            cross = np.zeros((FRAME, FRAME))
            for n in range(PIXELS):
                for i in range(FRAME):
                    for j in range(FRAME):
                        product = white[n, i] * track.white[k - 1, n, j]
                        cross[i, j] += trust.curvature * off_diagonal * product
            adjoints = problem.adjoints
            _add_neighbours(
                slot, prev_slot, anchor, cross=cross, adjoints=adjoints, equations=equations
            )
        target = sums[slot, anchor]
        # All sums at once: white columns of ζ_k, transposed, times the factors, [9, 4] by [4, 24].
        # In its anchor frame, no motion moves the landmark, only the jitter.
        for i in range(POSE if k == 0 else 0, FRAME):
            w0 = white[0, i]
            w1 = white[1, i]
            w2 = white[2, i]
            w3 = white[3, i]
            for j in range(_PAIR):
                target[i, j] += (
                    w0 * factors[0, j]
                    + w1 * factors[1, j]
                    + w2 * factors[2, j]
                    + w3 * factors[3, j]
                )


@compiled_into_callers
def _couple(
    row: int, problem: _Problem, track: _Track, curvature: float, coupling: FloatArray
) -> None:
    """Fill the information between a landmark and the frames of its observations, [M, 4, 9]."""
    first = problem.observations.start[row]
    count = problem.observations.start[row + 1] - first
    anchor = problem.observations.slot[first]
    of_anchor = coupling[first]
    for k in range(count):
        # Rows (u, v, d, δ), columns ζ_k: those of the landmark in Σ⁻¹ times the white columns of
        # this observation.
        own = coupling[first + k]
        white = track.white[k]
        for i in range(LANDMARK):
            w0 = curvature * track.weighted[k, 0, i]
            w1 = curvature * track.weighted[k, 1, i]
            w2 = curvature * track.weighted[k, 2, i]
            w3 = curvature * track.weighted[k, 3, i]
            for j in range(FRAME):
                own[i, j] = (
                    w0 * white[0, j] + w1 * white[1, j] + w2 * white[2, j] + w3 * white[3, j]
                )
        if k == 0:
            continue  # its pose does not matter there
        # The anchor's pose moves the prediction by −J Ad(T_ka).
        adjoint = problem.adjoints[problem.observations.slot[first + k], anchor]
        for i in range(LANDMARK):
            for j in range(POSE):
                of_anchor[i, j] -= (
                    own[i, 0] * adjoint[0, j]
                    + own[i, 1] * adjoint[1, j]
                    + own[i, 2] * adjoint[2, j]
                    + own[i, 3] * adjoint[3, j]
                    + own[i, 4] * adjoint[4, j]
                    + own[i, 5] * adjoint[5, j]
                )


@compiled_into_callers
def _factor(
    curvature: float, information: FloatArray, work: _Workspace, inverse: FloatArray
) -> None:
    """Fill the Cholesky factor of a landmark's information, [4, 4], and its inverse.

    Args:
        curvature: factor of the information.
        information: its lower triangle.
        work: receives the factor.
        inverse: receives the inverse, [4, 4].
    """
    # The anchor frame always sees the landmark, and δ has a prior: the information is positive
    # definite but for rounding, against which a diagonal entry is bounded.
    root = work.root
    for i in range(LANDMARK):
        for j in range(i + 1):
            total = curvature * information[i, j]
            for n in range(j):
                total -= root[i, n] * root[j, n]
            root[i, j] = math.sqrt(max(total, 1e-12)) if i == j else total / root[j, j]
    # Column by column of R Rᵀ A⁻¹ = I: forwards with R, then backwards with Rᵀ.
    solved = work.unit
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


@compiled_into_callers
def _substitute(root: FloatArray, columns: FloatArray, count: int, solved: FloatArray) -> None:
    """Set the first columns of ``solved``, [4, ≥ count], to R⁻¹ times as many given ones."""
    r10 = root[1, 0]
    r20 = root[2, 0]
    r21 = root[2, 1]
    r30 = root[3, 0]
    r31 = root[3, 1]
    r32 = root[3, 2]
    scale0 = 1.0 / root[0, 0]
    scale1 = 1.0 / root[1, 1]
    scale2 = 1.0 / root[2, 2]
    scale3 = 1.0 / root[3, 3]
    for j in range(count):
        y0 = columns[0, j] * scale0
        y1 = (columns[1, j] - r10 * y0) * scale1
        y2 = (columns[2, j] - r20 * y0 - r21 * y1) * scale2
        y3 = (columns[3, j] - r30 * y0 - r31 * y1 - r32 * y2) * scale3
        solved[0, j] = y0
        solved[1, j] = y1
        solved[2, j] = y2
        solved[3, j] = y3


@compiled_into_callers
def _eliminate(
    row: int,
    problem: _Problem,
    work: _Workspace,
    elimination: Elimination,
    equations: WindowEquations,
) -> None:
    """Eliminate one landmark: subtract Bᵀ A⁻¹ B of its information A, [4, 4], and its coupling B.

    With A = R Rᵀ and Y = R⁻¹ B that is Yᵀ Y; only blocks of frames that saw it, and of the rig, are
    touched.
    """
    first = problem.observations.start[row]
    end = problem.observations.start[row + 1]
    root = work.root
    wide = work.wide
    # The columns of Y are those of all frames from the first to the last that saw it.
    slot = problem.observations.slot
    span = slot[end - 1] - slot[first] + 1
    of_frames = FRAME * span
    width = of_frames + RIG
    if span > end - first:  # frames in between did not see it
        for i in range(LANDMARK):
            wide[i, :of_frames] = 0.0
    # Y = R⁻¹ B: the frames from the anchor on, then the rig; behind them, R⁻¹ times the gradient.
    for m in range(first, end):
        at = FRAME * (slot[m] - slot[first])
        _substitute(root, elimination.coupling[m], FRAME, wide[:, at:])
    _substitute(root, elimination.rig_coupling[row], RIG, wide[:, of_frames:])
    gradient = elimination.gradient[row].reshape(LANDMARK, 1)
    _substitute(root, gradient, 1, wide[:, width:])
    # H −= Yᵀ Y, g −= Yᵀ R⁻¹ g_landmark. Frames come in their order, the rig last: this fills the
    # lower triangle.
    frame0 = FRAME * slot[first]
    rig0 = len(equations.gradient) - RIG
    for p in range(width):
        y0 = wide[0, p]
        y1 = wide[1, p]
        y2 = wide[2, p]
        y3 = wide[3, p]
        at = frame0 + p if p < of_frames else rig0 + p - of_frames
        equations.gradient[at] -= (
            y0 * wide[0, width] + y1 * wide[1, width] + y2 * wide[2, width] + y3 * wide[3, width]
        )
        target = equations.hessian[at, frame0:]
        for q in range(min(p + 1, of_frames)):
            target[q] -= y0 * wide[0, q] + y1 * wide[1, q] + y2 * wide[2, q] + y3 * wide[3, q]
        for q in range(of_frames, p + 1):
            equations.hessian[at, rig0 + q - of_frames] -= (
                y0 * wide[0, q] + y1 * wide[1, q] + y2 * wide[2, q] + y3 * wide[3, q]
            )


@compiled
def _add_pairs(sums: FloatArray, adjoints: FloatArray, equations: WindowEquations) -> None:
    """Add the equations of motions to those of frames: ξ_ka = ξ_k − Ad(T_ka) ξ_a.

    In its anchor frame, a landmark is where it is, whatever the pose: only the jitter counts.

    Args:
        sums: equations of ζ = (ξ_ka, ω_k) for frame k and anchor a, [K, K, 9, 24]: its information
            by itself, with ζ of the frame before, and with the rig, and its gradient.
        adjoints: Ad(T_ka), [K, K, 6, 6].
        equations: receives the sums.
    """
    hessian = equations.hessian
    rig0 = len(equations.gradient) - RIG
    of_both = np.empty((FRAME, POSE))
    of_anchor = np.empty((POSE, POSE))
    num_frames = len(adjoints)
    for k in range(num_frames):
        for a in range(k + 1):
            # The roll of the jitter moves every observation: its information is zero only where
            # there was none.
            of_motion = sums[k, a]
            if of_motion[FRAME - 1, FRAME - 1] == 0.0:
                continue  # no landmark of this anchor was seen there
            adjoint = adjoints[k, a]
            _times_adjoint(of_motion, adjoint, of_both)
            _adjoint_transposed_times(adjoint, of_both, of_anchor)
            # of_both = H Ad, [9, 6], and of_anchor = Adᵀ H Ad, [6, 6]. The jitter's rows of H have
            # no part in the latter, as the anchor's pose moves ξ_ka alone. Information of (ζ_k,
            # ξ_a) by ζ = (ξ_k − Ad ξ_a, ω_k): [I, −Ad]ᵀ H [I, −Ad].
            of_k = FRAME * k
            of_a = FRAME * a
            for i in range(FRAME):
                equations.gradient[of_k + i] += of_motion[i, _GRADIENT]
                for j in range(FRAME):
                    hessian[of_k + i, of_k + j] += of_motion[i, j]
                for j in range(POSE):
                    hessian[of_k + i, of_a + j] -= of_both[i, j]
                for j in range(RIG):
                    hessian[rig0 + j, of_k + i] += of_motion[i, _WITH_RIG + j]
            for i in range(POSE):
                for j in range(POSE):
                    hessian[of_a + i, of_a + j] += of_anchor[i, j]
                for n in range(POSE):
                    equations.gradient[of_a + i] -= adjoint[n, i] * of_motion[n, _GRADIENT]
                    for j in range(RIG):
                        hessian[rig0 + j, of_a + i] -= adjoint[n, i] * of_motion[n, _WITH_RIG + j]
            if a < k:
                cross = of_motion[:, _WITH_PREV:_WITH_RIG]
                _add_neighbours(k, k - 1, a, cross=cross, adjoints=adjoints, equations=equations)


@compiled
def _add_neighbours(
    k: int, p: int, a: int, cross: FloatArray, adjoints: FloatArray, equations: WindowEquations
) -> None:
    """Add the information between the motions from frame a to frame k and to frame p before it.

    Args:
        k: place of the later frame.
        p: place of the earlier one.
        a: place of the anchor frame.
        cross: information between ζ_k and ζ_p, [9, 9]. Its transpose counts as well: of the blocks
            off the diagonal only the lower triangle is filled, in the anchor's own block both sum
            up.
        adjoints: Ad(T_ka), [K, K, 6, 6].
        equations: receives the sums.
    """
    # ζ_kᵀ X ζ_p with ξ_ka = ξ_k − Ad_k ξ_a and ξ_pa = ξ_p − Ad_p ξ_a: X couples k and p, −X Ad_p
    # couples k and a, −Xᵀ Ad_k couples p and a, and Ad_kᵀ X Ad_p is the anchor's own. Where the
    # earlier frame is the anchor itself, X has no columns of ξ_pa, only those of the jitter.
    hessian = equations.hessian
    of_prev = np.empty((FRAME, POSE))
    of_curr = np.empty((FRAME, POSE))
    of_anchor = np.empty((POSE, POSE))
    _times_adjoint(cross, adjoints[p, a], of_prev)
    _times_adjoint(cross.T, adjoints[k, a], of_curr)
    _adjoint_transposed_times(adjoints[k, a], of_prev, of_anchor)
    for i in range(FRAME):
        for j in range(FRAME):
            hessian[FRAME * k + i, FRAME * p + j] += cross[i, j]
        for j in range(POSE):
            hessian[FRAME * k + i, FRAME * a + j] -= of_prev[i, j]
            hessian[FRAME * p + i, FRAME * a + j] -= of_curr[i, j]
    for i in range(POSE):
        for j in range(POSE):
            hessian[FRAME * a + i, FRAME * a + j] += of_anchor[i, j] + of_anchor[j, i]


@compiled_into_callers
def _times_adjoint(matrix: FloatArray, adjoint: FloatArray, product: FloatArray) -> None:
    """Set product, [9, 6], to the columns of ξ of a matrix, [9, ≥ 6], times an adjoint, [6, 6].

    A call of BLAS would take longer than these few products.
    """
    for i in range(FRAME):
        m0 = matrix[i, 0]
        m1 = matrix[i, 1]
        m2 = matrix[i, 2]
        m3 = matrix[i, 3]
        m4 = matrix[i, 4]
        m5 = matrix[i, 5]
        for j in range(POSE):
            product[i, j] = (
                m0 * adjoint[0, j]
                + m1 * adjoint[1, j]
                + m2 * adjoint[2, j]
                + m3 * adjoint[3, j]
                + m4 * adjoint[4, j]
                + m5 * adjoint[5, j]
            )


@compiled_into_callers
def _adjoint_transposed_times(adjoint: FloatArray, matrix: FloatArray, product: FloatArray) -> None:
    """Set product, [6, 6], to the transpose of an adjoint times the rows of ξ of a matrix,
    [≥ 6, 6]."""
    for i in range(POSE):
        a0 = adjoint[0, i]
        a1 = adjoint[1, i]
        a2 = adjoint[2, i]
        a3 = adjoint[3, i]
        a4 = adjoint[4, i]
        a5 = adjoint[5, i]
        for j in range(POSE):
            product[i, j] = (
                a0 * matrix[0, j]
                + a1 * matrix[1, j]
                + a2 * matrix[2, j]
                + a3 * matrix[3, j]
                + a4 * matrix[4, j]
                + a5 * matrix[5, j]
            )


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
        step: of frames and rig, [9K + 4].
        moved: receives the landmarks, [L, 4].
    """
    rig0 = len(step) - RIG
    rest = np.zeros(LANDMARK)
    for row in range(len(state)):
        # A Δ = g − B · step, with the landmark's step Δ, and the inverse of A left by ``_factor``.
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
        if not (du < LARGEST_SHIFT_PX and dv < LARGEST_SHIFT_PX and dd < LARGEST_SHIFT_PX):
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
