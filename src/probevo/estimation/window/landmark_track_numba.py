"""The observations of one landmark, linearised, and made white along its track.

A landmark is (u, v, d, δ): its place in the left image and its disparity, both in its anchor frame
a, the first that saw it, and the disparity error δ that all its observations have in common (the
time-correlated one of the noise model). With m = ((u − c_u)/f_u, (v − c_v)/f_v, 1) and the inverse
depth λ = d/(f_u b), it is h/λ in frame k, where

    h = C_ka m + λ t_ka,    prediction = (u_k, v_k, u_k − d/h_z − δ + β(x)ᵀb + δu_r, v_k + δv_r).

β(x) = (1, x, x²) and b are the disparity errors of the rig (``camera.rig_calibration``). Nothing is
divided by d, so that a landmark at infinity is nothing special.

What the rectification has left of the lenses' distortion moves both views of a point outwards by
k₁ r² of their distance from the principal point (the first radial term of Brown's model). It is
taken at the predicted place: at the observed one, whose noise is also in the error, k₁ and b₁ would
be biased (with white noise of 0.3 px, k₁ by eight times its scatter over drives).

In each frame the right camera is turned relative to the left one by a small jitter ω_k, which moves
what it sees by (δu_r, δv_r) = O ω_k (``camera.rig_jitter``).

Errors of successive observations of a landmark are alike: what the tracker got wrong in one frame,
it gets wrong in the next. They are taken for an AR(1) process with correlation ρ. The noise model
describes pairs of observations, R = M (1 − ρ) with M the variance of one, so that a pair counts as
it does for two frames, whatever ρ. With R_k⁻¹ = G_k G_kᵀ, the innovations (G_kᵀ e_k − ρ G_k₋₁ᵀ
e_k₋₁)/√(1 + ρ) are white, so that Σ⁻¹ is tridiagonal, with blocks G_k G_kᵀ times 1, 1 + ρ², …, 1 +
ρ², 1 on the diagonal and −ρ G_k G_k₋₁ᵀ beside it, over 1 + ρ. ρ = 0 is bundle adjustment with white
noise; ρ → 1 is a chain of frame-to-frame motions, a random walk of the track.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.transfer_numba import Intrinsics
from probevo.compiled import compiled, compiled_into_callers
from probevo.estimation.window.equations import (
    FRAME,
    LANDMARK,
    LENS,
    PIXELS,
    POSE,
    RIG,
    RobustNoise,
    WindowGeometry,
    WindowLandmarks,
    WindowObservations,
)
from probevo.geometry.se3_numba import adjoints

_COLUMNS = FRAME + LANDMARK + RIG + 1
"""Columns of a linearised observation: ζ = (ξ_ka, ω_k) of its frame, landmark, rig, error."""
_RIG = FRAME + LANDMARK
"""The first column of the rig in a linearised observation."""
_ERROR = _RIG + RIG
"""The column of the error in a linearised observation."""
COMMON_COLUMNS = LANDMARK + RIG + 1
"""Columns of the states that all observations of a landmark have in common, and of the error."""
MIN_DEPTH = 1e-3
"""Share of its depth in the anchor frame at which a landmark counts as behind the camera."""
BEHIND_CAMERA = 1e6
"""Squared distance of an observation whose landmark has got behind the camera."""


class WindowProblem(NamedTuple):
    """What stays the same while the landmarks are added up."""

    geometry: WindowGeometry
    observations: WindowObservations
    landmarks: WindowLandmarks
    noise: RobustNoise
    T_ka: FloatArray
    """Motions between all pairs of frames, [K, K, 4, 4], m."""
    adjoints: FloatArray
    """Ad(T_ka) at the linearisation points, for frame k and anchor a, [K, K, 6, 6]."""


class LinearizedTrack(NamedTuple):
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


@compiled
def window_problem(
    geometry: WindowGeometry,
    observations: WindowObservations,
    landmarks: WindowLandmarks,
    noise: RobustNoise,
) -> WindowProblem:
    """Return what all landmarks need, with the motions between all pairs of frames."""
    count = len(geometry.T_cam_world)
    T_linear = _relative_poses(geometry.T_linear)
    adjoint = np.zeros((count, count, POSE, POSE))
    adjoints(T_linear.reshape(-1, 4, 4), adjoint.reshape(-1, POSE, POSE))
    return WindowProblem(
        geometry=geometry,
        observations=observations,
        landmarks=landmarks,
        noise=noise,
        T_ka=_relative_poses(geometry.T_cam_world),
        adjoints=adjoint,
    )


@compiled
def empty_track(num_frames: int) -> LinearizedTrack:
    """Return work space for the observations of one landmark."""
    return LinearizedTrack(
        ray=np.zeros(3),
        raw=np.zeros((num_frames, PIXELS, _COLUMNS)),
        white=np.zeros((num_frames, PIXELS, _COLUMNS)),
        innovation=np.zeros((num_frames, PIXELS, COMMON_COLUMNS)),
        weighted=np.zeros((num_frames, PIXELS, COMMON_COLUMNS)),
        common=np.zeros((COMMON_COLUMNS, COMMON_COLUMNS)),
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


@compiled_into_callers
def linearize_track(row: int, problem: WindowProblem, track: LinearizedTrack) -> float:
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
    camera = problem.geometry.camera
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
        _linearize(state, T_ka, camera, k == 0, ray=track.ray, raw=track.raw[k])
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
    last = COMMON_COLUMNS - 1
    for k in range(count):
        for n in range(PIXELS):
            total += track.innovation[k, n, last] * track.innovation[k, n, last]
    return total


@compiled_into_callers
def _project(
    state: FloatArray, T_ka: FloatArray, geometry: WindowGeometry, ray: FloatArray
) -> bool:
    """Fill the direction to a landmark in a frame; False if it is behind the camera."""
    camera = geometry.camera
    # h = C_ka m + λ t_ka, with λ = d/(f_u b): the point in frame k, over its depth in the anchor
    # frame. So h_z is the ratio of the depths in both frames.
    mx = (state[0] - camera.cu) / camera.fu
    my = (state[1] - camera.cv) / camera.fv
    inverse_depth = state[2] / camera.fb
    for i in range(3):
        ray[i] = T_ka[i, 0] * mx + T_ka[i, 1] * my + T_ka[i, 2] + T_ka[i, 3] * inverse_depth
    return bool(ray[2] > MIN_DEPTH)


@compiled_into_callers
def _linearize(
    state: FloatArray,
    T_ka: FloatArray,
    camera: Intrinsics,
    is_anchor: bool,
    ray: FloatArray,
    raw: FloatArray,
) -> None:
    """Fill the Jacobians of an observation, [4, 18], at the ray where it was projected to.

    Only entries that are not always zero are written. The first observation of every track is that
    of the anchor, so that the columns of ξ_ka remain zero there.
    """
    fu = camera.fu
    fv = camera.fv
    per_u = 1.0 / fu
    per_v = 1.0 / fv
    per_disparity = 1.0 / camera.fb
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
    # k₁ moves both views outwards; rows are calibrated apart, so that v_r moves as v does.
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
        u_shift = u_x * scale * T_ka[0, column] + u_z * h_z
        v_shift = v_y * scale * T_ka[1, column] + v_z * h_z
        raw[0, FRAME + j] = u_shift
        raw[1, FRAME + j] = v_shift
        raw[2, FRAME + j] = u_shift - d_z * h_z
        raw[3, FRAME + j] = v_shift
    # u_r = u − d/h_z − δ depends on d and δ directly, too.
    raw[2, FRAME + 2] -= per_depth
    raw[2, FRAME + 3] = -1.0


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
    fu = geometry.camera.fu
    fv = geometry.camera.fv
    # The rectified camera without any errors: normalised (x, y), disparity d/h_z, and pixels.
    per_depth = 1.0 / ray[2]
    x = ray[0] * per_depth
    y = ray[1] * per_depth
    disparity = state[2] * per_depth
    u = fu * x + geometry.camera.cu
    v = fv * y + geometry.camera.cv
    u_r = u - disparity
    # β(x)ᵀ b is true minus measured disparity: it makes the measured one smaller, and u_r larger.
    rig = geometry.rig_errors
    rig_error = rig[0] + x * (rig[1] + x * rig[2])
    # The jitter of the right camera, which sees the landmark at (x_r, y).
    x_r = x - disparity / fu
    pitch = jitter[0]
    yaw = jitter[1]
    roll = jitter[2]
    u_jitter = fu * (-x_r * y * pitch + (1.0 + x_r * x_r) * yaw - y * roll)
    v_jitter = fv * (-(1.0 + y * y) * pitch + x_r * y * yaw + x_r * roll)
    # Predictions are linear in k₁, so that its effect is k₁ times its Jacobian column.
    u += rig[LENS] * raw[0, _RIG + LENS]
    v += rig[LENS] * raw[1, _RIG + LENS]
    u_r += rig[LENS] * raw[2, _RIG + LENS]
    raw[0, _ERROR] = pixels[0] - u
    raw[1, _ERROR] = pixels[1] - v
    raw[2, _ERROR] = pixels[2] - (u_r - state[3] + rig_error + u_jitter)
    raw[3, _ERROR] = pixels[3] - (v + v_jitter)


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
def _fill_innovations(count: int, correlation: float, track: LinearizedTrack) -> None:
    """Fill the innovations of the common columns, and these weighted.

    z_k = s_k a_k − ρ s a_k₋₁ of the white columns a_k, and in turn s_k z_k − ρ s z_k₊₁.
    """
    # s = 1/√(1 + ρ); the innovation of the anchor's observation, which none precedes, is √(1 − ρ)
    # a₀. Its square and the ρ²/(1 + ρ) of the next one add up to the first block of Σ⁻¹, 1/(1 + ρ).
    scale = 1.0 / math.sqrt(1.0 + correlation)
    neighbour_factor = -correlation * scale
    for k in range(count):
        own = share_of_own(k, correlation)
        for n in range(PIXELS):
            for j in range(COMMON_COLUMNS):
                track.innovation[k, n, j] = own * track.white[k, n, FRAME + j]
        if k > 0:
            for n in range(PIXELS):
                for j in range(COMMON_COLUMNS):
                    track.innovation[k, n, j] += neighbour_factor * track.white[k - 1, n, FRAME + j]
    # The transposed map, since aᵀ Σ⁻¹ b = (L a)ᵀ (L b) for the map L to innovations.
    for k in range(count):
        own = share_of_own(k, correlation)
        for n in range(PIXELS):
            for j in range(COMMON_COLUMNS):
                track.weighted[k, n, j] = own * track.innovation[k, n, j]
        if k + 1 < count:
            for n in range(PIXELS):
                for j in range(COMMON_COLUMNS):
                    track.weighted[k, n, j] += neighbour_factor * track.innovation[k + 1, n, j]


@compiled
def share_of_own(k: int, correlation: float) -> float:
    """Return s_k, the factor of observation k in its innovation."""
    if k == 0:
        return math.sqrt(1.0 - correlation)
    return 1.0 / math.sqrt(1.0 + correlation)
