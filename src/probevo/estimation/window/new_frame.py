"""How a window grows by a frame: its pose, and observations of the features that it sees."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.rig_calibration import disparity_basis
from probevo.camera.stereo import StereoCamera
from probevo.estimation.window.equations import (
    JITTER,
    LANDMARK,
    LENS,
    WindowLandmarks,
    WindowObservations,
)
from probevo.estimation.window.marginalization import with_pose
from probevo.estimation.window.normal_equations_numba import fill_roots
from probevo.estimation.window.window import Window, merged
from probevo.measurements.robust_loss import RobustLoss
from probevo.noise.base import StereoNoise
from probevo.tracking.tracks import Tracks

MIN_VARIANCE_PX2 = 1e-12
"""Variance of a time-correlated disparity error in a noise model that knows none."""


class ReacquiredFeatures(NamedTuple):
    """Features of a frame before a gap that are seen again."""

    slot: int
    """Slot of that frame."""
    ids: IntArray
    """Their identities, [N]."""


def with_new_pose(window: Window, frame: int, T_curr_prev: FloatArray, *, prev: int) -> Window:
    """Return the window with one more frame, which no feature connects with the others yet.

    Args:
        window: K frames.
        frame: index of the new one.
        T_curr_prev: a guess of the motion from an earlier frame, [4, 4].
        prev: slot of that frame.
    """
    # T_curr_world = T_curr_prev T_prev_world. The prior gets rows and columns of zeros for it,
    # so that the pose may still be linearised anew by the adjustment.
    T_new = T_curr_prev @ window.T_cam_world[prev]
    return replace(
        window,
        inertial=window.inertial.with_new_frame(),
        frames=np.append(window.frames, frame),
        T_cam_world=np.concatenate([window.T_cam_world, T_new[None]]),
        T_linear=np.concatenate([window.T_linear, T_new[None]]),
        is_blind=np.append(window.is_blind, True),
        calibration_effect=window.calibration_effect.with_new_frame(prev, T_curr_prev),
        jitter=np.concatenate([window.jitter, np.zeros((1, JITTER))]),
        prior=with_pose(window.prior),
    )


def with_tracks(
    window: Window,
    tracks: Tracks,
    noise: StereoNoise,
    *,
    prev: int,
    reacquired: ReacquiredFeatures | None = None,
    camera: StereoCamera,
    loss: RobustLoss,
) -> Window:
    """Return the window with observations of its newest frame.

    A track whose landmark the previous frame saw last adds an observation to it; any other begins a
    landmark with both of its observations. Noise that refers to residuals is halved: it is that of
    two observations.

    Args:
        window: K frames.
        tracks: N tracks from one of them to the newest, corrected by the rig's calibration but for
            b₁ and b₂.
        noise: of these N tracks.
        prev: slot of the frame where they start.
        reacquired: features of a frame before a gap; where a track is of one of these, its landmark
            goes on, and gets an observation in the previous frame, too.
        camera: the rectified camera.
        loss: the robust loss of the observations.
    """
    if not len(tracks):
        return window
    newest = len(window) - 1
    # The landmark of each track; new ones are numbered behind those of the window.
    rows = window.rows_seen_last(tracks.ids, prev)
    is_in_prev = rows >= 0
    if reacquired is not None:
        reacquired_rows = np.where(
            np.isin(tracks.ids, reacquired.ids),
            window.rows_seen_last(tracks.ids, reacquired.slot),
            -1,
        )
        rows = np.where(is_in_prev, rows, reacquired_rows)
    is_new = rows < 0
    rows[is_new] = len(window.ids) + np.arange(int(is_new.sum()))
    if noise.refers_to == "residual":
        noise = noise.scaled(0.5)
    parameters = loss.parameters(noise.dof)
    # Observations: all in the new frame, and in the frame before those that it does not have yet.
    # For new landmarks that is the anchor.
    first_px = tracks.prev_px[is_new]
    added = np.flatnonzero(~is_in_prev)
    # Each observation counts with the noise at its own time.
    scale = np.concatenate([noise.scale_of_prev[added], noise.scale])
    # A bias is the mean of a step's residual: an observation has those of all steps since the
    # first of its track in its error.
    bias = np.concatenate([window.landmarks.bias, np.zeros_like(first_px)])
    prev_px = tracks.prev_px - bias[rows]
    bias[rows] += noise.bias
    root = np.zeros_like(scale)
    if not fill_roots(scale, root):
        raise np.linalg.LinAlgError("the scale of an observation is not positive definite")
    new = WindowObservations(
        start=np.zeros(0, np.int64),
        slot=np.concatenate([np.full(len(added), prev), np.full(len(tracks), newest)]),
        pixels=np.concatenate([prev_px[added], tracks.curr_px - bias[rows]]),
        root=root,
        loss_parameter=np.concatenate([parameters[added], parameters]),
    )
    # Landmarks: the new ones as their first observation shows them, with the prior of δ, whose
    # information is 1/τ².
    variance = np.zeros(len(tracks))
    if noise.time_correlated is not None:
        variance = noise.time_correlated
    landmarks = WindowLandmarks(
        state=np.concatenate(
            [window.landmarks.state, first_states(first_px, window.rig_errors, camera)]
        ),
        error_information=np.concatenate(
            [
                window.landmarks.error_information,
                1.0 / np.maximum(variance[is_new], MIN_VARIANCE_PX2),
            ]
        ),
        static_weight=np.concatenate([window.landmarks.static_weight, np.ones(len(first_px))]),
        bias=bias,
    )
    # A frame that was dead-reckoned is no longer blind where features are found again.
    is_blind = window.is_blind.copy()
    is_blind[[prev, newest]] = False
    return replace(
        window,
        is_blind=is_blind,
        ids=np.concatenate([window.ids, tracks.ids[is_new]]),
        landmarks=landmarks,
        observations=merged(window.observations, new, np.concatenate([rows[added], rows])),
    )


def first_states(pixels: FloatArray, rig: FloatArray, camera: StereoCamera) -> FloatArray:
    """Return the landmarks that N observations, [N, 4], px, show by themselves, [N, 4]."""
    x, y = camera.normalized(pixels[:, 0], pixels[:, 1])
    x_r, _ = camera.normalized(pixels[:, 2], pixels[:, 3])
    # What the lenses move outwards is taken back at the observed place: it is only a start. The
    # disparity error of the rig is the true one minus the measured one, and added. δ starts at
    # zero, the mean of its prior.
    inwards = -rig[LENS] * (x * x + y * y)
    inwards_r = -rig[LENS] * (x_r * x_r + y * y)
    states = np.zeros((len(pixels), LANDMARK))
    states[:, 0] = pixels[:, 0] + camera.fu_px * x * inwards
    states[:, 1] = pixels[:, 1] + camera.fv_px * y * inwards
    states[:, 2] = states[:, 0] - (pixels[:, 2] + camera.fu_px * x_r * inwards_r)
    states[:, 2] += disparity_basis(pixels, camera) @ rig[:LENS]
    return states
