"""What the normal equations of a window are made of, and their sizes."""

from __future__ import annotations

from typing import NamedTuple

from probevo.arrays import FloatArray, IntArray
from probevo.camera.transfer_numba import Intrinsics

POSE = 6
"""Degrees of freedom of a pose."""
JITTER = 3
"""Degrees of freedom of the jitter of a frame, ω = (pitch, yaw, roll)."""
FRAME = POSE + JITTER
"""Degrees of freedom of a frame, its pose first."""
RIG = 4
"""Degrees of freedom of the rig: its disparity errors b₀, b₁, b₂ and the distortion k₁ of its
lenses."""
LENS = 3
"""Index of k₁ among the errors of the rig."""
LANDMARK = 4
"""Degrees of freedom of a landmark: (u, v, d) and its time-correlated disparity error δ."""
PIXELS = 4
"""Coordinates of an observation."""


class WindowGeometry(NamedTuple):
    """What the predictions of K frames depend on, beside the landmarks."""

    T_cam_world: FloatArray
    """Poses, [K, 4, 4], m."""
    T_linear: FloatArray
    """Linearisation points of the poses, [K, 4, 4], m."""
    jitter: FloatArray
    """ω of each frame, [K, 3], rad."""
    rig_errors: FloatArray
    """(b₀, b₁, b₂) in px and k₁, [4]."""
    camera: Intrinsics


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
    """(u_l, v_l, u_r, v_r), [M, 4], px, corrected by the rig's calibration but for its disparity
    error b, and by the accumulated bias of the noise model."""
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
    static_weight: FloatArray
    """Weight of each, [L]: 1, and less for one that seems to move by itself
    (``static_weights``)."""
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


class LandmarkElimination(NamedTuple):
    """What finds the L landmarks once the poses are known."""

    coupling: FloatArray
    """Information between a landmark and the frame of each of its M observations, [M, 4, 9]; the
    first is the anchor's."""
    rig_coupling: FloatArray
    """Information between each landmark and the rig, [L, 4, 4]."""
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
