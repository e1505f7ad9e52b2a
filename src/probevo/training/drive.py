"""A recording, tracked and solved once: all that training needs to know of it, without its images."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import islice
from pathlib import Path

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.noise import NoiseModel
from probevo.odometry import StereoOdometry
from probevo.predictors import PredictionSpace
from probevo.sequences.base import Sequence
from probevo.tracking.tracks import Tracks


@dataclass(frozen=True)
class Drive:
    """K frames, K − 1 steps between them, and the n features of all steps, one step after another."""

    stamps_ns: IntArray
    """[K]."""
    T_world_cam: FloatArray
    """True poses, [K, 4, 4]; NaN where unknown."""
    T_curr_prev: FloatArray
    """Motion of each step as all its features give it, [K − 1, 4, 4]."""
    first_of_step: IntArray
    """Where the features of each step begin, and the end of the last, [K]."""
    prev_px: FloatArray
    """(u_l, v_l, u_r, v_r) of each feature in the frame before, corrected, [n, 4]."""
    curr_px: FloatArray
    """The same in the current frame."""
    phi: FloatArray
    """Its place in the prediction space, [n, M]."""
    used: BoolArray
    """Whether the solve used it, or RANSAC or the pre-filter turned it away, [n]."""

    def rows(self, step: int) -> slice:
        """Where the features of a step are."""
        return slice(*self.first_of_step[step : step + 2].tolist())

    def tracks(self, step: int) -> Tracks:
        """The features of a step; their identities and ages are not kept."""
        rows = self.rows(step)
        nothing = np.zeros(rows.stop - rows.start, np.int64)
        return Tracks(self.prev_px[rows], self.curr_px[rows], nothing, nothing)

    @property
    def step_of_feature(self) -> IntArray:
        """The step that each feature belongs to, [n]."""
        return np.repeat(np.arange(len(self.T_curr_prev)), np.diff(self.first_of_step))


def record_drive(
    sequence: Sequence,
    space: PredictionSpace,
    noise: NoiseModel,
    config: OdometryConfig,
    *,
    max_frames: int | None = None,
    on_frame: Callable[[int, int], None] | None = None,
) -> Drive:
    """Run the odometry over a recording and keep every step's features with their predictors.

    Args:
        sequence: the recording.
        space: the predictors.
        noise: model for the motion of all features together; it must need no predictors.
        config: all settings of the odometry.
        max_frames: stop after so many.
        on_frame: called with how many frames are done, and how many there are.

    Raises:
        InputError: the recording has fewer than two frames, is faulty, or lacks what a predictor needs.
    """
    num_frames = min(len(sequence), max_frames or len(sequence))
    if num_frames < 2:
        raise InputError(sequence.path, "it has one frame, and so no motion to learn from.", "Give a longer recording.")
    odometry = StereoOdometry(sequence.camera, noise, sequence.imu, config, space)
    motions, steps = [], []
    for frame in islice(sequence, num_frames):
        motion = odometry.step(frame)
        if frame.index > 0:
            motions.append(motion.T_curr_prev)
            tracks = odometry.tracks
            steps.append((tracks.prev_px, tracks.curr_px, odometry.phi, odometry.used))
        if on_frame is not None:
            on_frame(frame.index + 1, num_frames)
    prev_px, curr_px, phi, used = (np.concatenate(part) for part in zip(*steps, strict=True))
    unknown = np.full((num_frames, 4, 4), np.nan)
    return Drive(
        stamps_ns=sequence.stamps_ns[:num_frames],
        T_world_cam=unknown if sequence.truth is None else sequence.truth.T_world_cam[:num_frames],
        T_curr_prev=np.array(motions),
        first_of_step=np.cumsum([0, *(len(step[0]) for step in steps)]),
        prev_px=prev_px,
        curr_px=curr_px,
        phi=phi,
        used=used,
    )


def save_drive(path: Path, drive: Drive) -> None:
    """Write a drive as an ``.npz`` file."""


def load_drive(path: Path) -> Drive:
    """Read what ``save_drive`` wrote."""
    with np.load(path, allow_pickle=False) as archive:
        return Drive(**{field.name: archive[field.name] for field in fields(Drive)})
