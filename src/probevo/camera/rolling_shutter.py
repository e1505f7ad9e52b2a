"""The readout time of a rolling shutter, whose rows are exposed one after the other.

Row v of an image of H rows is exposed s τ after the middle row, where τ is the readout time and
s = v/(H − 1) − ½. A frame has the time of its middle row. In the camera's frame a point p at rest
moves by ṗ = ω × p + v, where ξ = (v, ω) is the twist of T_curr_prev per second; with its rate of
change a, a point seen in that row was at

    p = Exp(−s τ ξ − ½ (s τ)² a) p_seen

at the time of the frame; left and right image of a point have the same rows. τ is estimated jointly
with the other errors of the images (``camera.image_errors``), from how well the features agree on
one motion: with the image velocity ẏ of a point in the current frame by the velocities of the
camera at either frame, the residual y' − f(T g(y)) of corrected observations changes with τ by

    ∂e/∂τ = s ẏ(Ad(T) (ξ + s τ a)) − s' ẏ(ξ' + s' τ a).

Errors of lenses do not look like this: they do not depend on the depth of a point. Where ξ' − ξ = a
Δt is not known either, as of a rig in a hand, the features show it, too
(``estimation.velocity_change``): with ξ and ξ' half of it before and after their mean,

    ∂e/∂(ξ' − ξ) = −½ (s τ − (s τ)²/Δt) ẏ(Ad(T) ·) − ½ (s' τ + (s' τ)²/Δt) ẏ(·).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer_numba import NEAREST, Intrinsics, move_point, velocity_over_depth
from probevo.compiled import compiled
from probevo.geometry import se3
from probevo.geometry.se3_numba import perturb

READOUT_SIGMA_S = 0.02
"""Prior standard deviation of the readout time. Usual rolling shutters take 10 to 30 ms."""
KNOWN_SIGMA_S = 0.0005
"""Prior standard deviation where the calibration gives the readout time."""
NOTICEABLE_S = 0.003
"""Smallest readout time that is corrected. Steps of a shorter one are as exact as they claim
(docs/degradation.md)."""
MIN_RATIO = 4.0
"""Smallest readout time, in standard deviations, that is corrected. Twelve recordings of global
shutters show at most 2.3 at any time (``benchmarks/rolling_shutter.py``)."""


class Twists(NamedTuple):
    """The velocities of the camera at the two frames of a step, between which they change
    evenly."""

    prev: FloatArray
    """Twist of T_curr_prev per second at the previous frame, in the axes of that frame, [6]."""
    curr: FloatArray
    """The same at the current frame."""
    duration_s: float = math.inf
    """Time between the two frames; infinite if neither velocity changes while a frame is read."""
    are_estimated: bool = False
    """Whether their change in this step has been estimated; otherwise it is taken from two
    steps."""

    @property
    def acceleration(self) -> FloatArray:
        """Rate of change a, [6], m/s² and rad/s²."""
        change: FloatArray = self.curr - self.prev
        return change / self.duration_s


class ReadoutTime(NamedTuple):
    """A Gaussian estimate of the readout time."""

    mean_s: float
    sigma_s: float

    @staticmethod
    def prior(known_s: float = 0.0) -> ReadoutTime:
        """Return the prior.

        Args:
            known_s: the readout time by the calibration; 0 if it does not give any.
        """
        return ReadoutTime(known_s, KNOWN_SIGMA_S if known_s else READOUT_SIGMA_S)

    @property
    def noticeable_s(self) -> float:
        """The readout time if it exceeds noise and what other errors look like, else 0."""
        threshold_s = max(NOTICEABLE_S, MIN_RATIO * self.sigma_s)
        return self.mean_s if abs(self.mean_s) > threshold_s else 0.0


def without_readout(
    pixels: FloatArray,
    readout_s: float,
    twist: FloatArray,
    camera: StereoCamera,
    acceleration: FloatArray | None = None,
) -> FloatArray:
    """Return observations [N, 4], px, moved from the time of their rows to the time of the frame.

    Args:
        pixels: the observations; left and right have the same time.
        readout_s: τ.
        twist: ξ at the time of the frame, [6], m/s and rad/s.
        camera: the rectified camera.
        acceleration: a, [6], m/s² and rad/s²; zero if not given.
    """
    corrected: FloatArray = np.array(pixels, np.float64, order="C")
    if readout_s:
        _remove_readout(
            corrected,
            twist,
            np.zeros(6) if acceleration is None else acceleration,
            camera=Intrinsics.of(camera),
            height=camera.extent_px[1],
            readout_s=readout_s,
        )
    return corrected


def readout_sensitivity(
    T: FloatArray,
    twists: Twists,
    camera: StereoCamera,
    refined: FloatArray,
    *,
    readout_s: float,
    sensitivity: FloatArray,
) -> None:
    """Fill in ∂e/∂τ, [N, 4], px/s, of e = y' − f(T g(y)).

    Args:
        T: T_curr_prev, [4, 4].
        twists: the velocities at the two frames.
        camera: the rectified camera.
        refined: the points in the previous frame, (u, v, d), [N, 3], px.
        readout_s: τ, by which the observations were corrected.
        sensitivity: filled in; zero behind the camera.
    """
    adjoint = se3.adjoint(T)
    _fill_sensitivity(
        T,
        Intrinsics.of(camera),
        camera.extent_px[1],
        refined=refined,
        row_twists=_RowTwists(
            prev=(adjoint @ twists.prev)[:, None],
            prev_rate=readout_s * (adjoint @ twists.acceleration)[:, None],
            curr=-twists.curr[:, None],
            curr_rate=-readout_s * twists.acceleration[:, None],
        ),
        sensitivity=sensitivity[:, :, None],
    )


def change_sensitivity(
    T: FloatArray,
    readout_s: float,
    duration_s: float,
    camera: StereoCamera,
    refined: FloatArray,
) -> FloatArray:
    """Return ∂e/∂(ξ' − ξ), [N, 4, 6], px/(m/s) and px/(rad/s), of e = y' − f(T g(y)); zero for
    points behind the camera.

    Args:
        T: T_curr_prev, [4, 4].
        readout_s: τ, by which the observations were corrected.
        duration_s: time between the two frames.
        camera: the rectified camera.
        refined: the points in the previous frame, (u, v, d), [N, 3], px.
    """
    sensitivity = np.empty((len(refined), 4, 6))
    adjoint = se3.adjoint(T)
    half = 0.5 * readout_s
    _fill_sensitivity(
        T,
        Intrinsics.of(camera),
        camera.extent_px[1],
        refined=refined,
        row_twists=_RowTwists(
            prev=-half * adjoint,
            prev_rate=half * readout_s / duration_s * adjoint,
            curr=-half * np.eye(6),
            curr_rate=-half * readout_s / duration_s * np.eye(6),
        ),
        sensitivity=sensitivity,
    )
    return sensitivity


class _RowTwists(NamedTuple):
    """K twists, in the axes of the current frame, by the rows of a point in either frame: s (prev +
    s prev_rate) + s' (curr + s' curr_rate), [6, K] each."""

    prev: FloatArray
    """Twists per row s of the previous frame."""
    prev_rate: FloatArray
    """Twists per s²."""
    curr: FloatArray
    """Twists per row s' of the current frame."""
    curr_rate: FloatArray
    """Twists per s'²."""


@compiled
def _remove_readout(
    pixels: FloatArray,
    twist: FloatArray,
    acceleration: FloatArray,
    *,
    camera: Intrinsics,
    height: float,
    readout_s: float,
) -> None:
    """Move observations, [N, 4], px, to the time of the frame.

    Those that would be behind the camera stay as they are.
    """
    identity = np.eye(4)
    T = np.empty((4, 4))
    point = np.empty(3)
    for n in range(len(pixels)):
        row_time_s = readout_s * (pixels[n, 1] / (height - 1.0) - 0.5)
        perturb(-row_time_s * (twist + 0.5 * row_time_s * acceleration), identity, T)
        point[0] = pixels[n, 0]
        point[1] = pixels[n, 1]
        point[2] = pixels[n, 0] - pixels[n, 2]
        X, Y, Z, rho = move_point(T, camera, point)
        if Z < NEAREST:
            continue
        between_rows_px = pixels[n, 3] - pixels[n, 1]
        pixels[n, 0] = camera.cu + camera.fu * X / Z
        pixels[n, 1] = camera.cv + camera.fv * Y / Z
        pixels[n, 2] = pixels[n, 0] - camera.fb * rho / Z
        pixels[n, 3] = pixels[n, 1] + between_rows_px


@compiled
def _fill_sensitivity(
    T: FloatArray,
    camera: Intrinsics,
    height: float,
    *,
    refined: FloatArray,
    row_twists: _RowTwists,
    sensitivity: FloatArray,
) -> None:
    """Fill in the image velocity ẏ by each of K twists, [N, 4, K]."""
    twist = np.empty(6)
    for n in range(len(refined)):
        X, Y, Z, rho = move_point(T, camera, refined[n])
        if Z < NEAREST:
            sensitivity[n] = 0.0
            continue
        x = X / Z
        y = Y / Z
        inverse_depth = rho / Z
        share = refined[n, 1] / (height - 1.0) - 0.5
        share_curr = (camera.fv * y + camera.cv) / (height - 1.0) - 0.5
        # ẏ is linear in the twist.
        for k in range(sensitivity.shape[2]):
            for i in range(len(twist)):
                prev = row_twists.prev[i, k] + share * row_twists.prev_rate[i, k]
                curr = row_twists.curr[i, k] + share_curr * row_twists.curr_rate[i, k]
                twist[i] = share * prev + share_curr * curr
            rate_x, rate_y, rate_z = velocity_over_depth(x, y, inverse_depth, twist)
            u_move = camera.fu * (rate_x - x * rate_z)
            v_move = camera.fv * (rate_y - y * rate_z)
            d_move = -camera.fb * inverse_depth * rate_z
            sensitivity[n, 0, k] = u_move
            sensitivity[n, 1, k] = v_move
            sensitivity[n, 2, k] = u_move - d_move
            sensitivity[n, 3, k] = v_move
