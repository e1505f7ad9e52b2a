"""A recording, tracked and solved once: all that training needs to know of it, without its images."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Callable
from dataclasses import dataclass, fields
from itertools import islice
from pathlib import Path
from typing import Protocol

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray
from probevo.config import OdometryConfig
from probevo.motion.estimate import Status
from probevo.noise import StudentT
from probevo.odometry import StereoOdometry
from probevo.output.files import write_atomically
from probevo.predictors import PredictionSpace
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame
from probevo.sequences.left_right import FRAMES_TO_SEE, check_left_right, count_matches
from probevo.tracking.tracks import Tracks


class Digest(Protocol):
    """What hashlib's objects do."""

    def update(self, data: bytes, /) -> None:
        """Take in more bytes."""


@dataclass(frozen=True)
class Drive:
    """K frames, K − 1 steps between them, and the n features of all steps, one step after another."""

    digest: str
    """SHA-256 of all that the odometry was given: stamps, images or features, IMU samples."""
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
    """Whether the step was solved and this one had a part in it, [n]; RANSAC and the pre-filter turn some away."""

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
    config: OdometryConfig,
    num_frames: int,
    on_frame: Callable[[int], None] | None = None,
) -> Drive:
    """Run the odometry with static robust noise over a recording, and keep every step's features with their predictors.

    Args:
        sequence: the recording.
        space: the predictors.
        config: all settings of the odometry.
        num_frames: how many of its frames, at least 2.
        on_frame: called with how many frames are done.

    Raises:
        InputError: the recording is faulty, its left and right images are swapped, or it lacks what a predictor needs.
    """
    odometry = StereoOdometry(sequence.camera, StudentT(), sequence.imu, config, space)
    digest, motions, steps = hashlib.sha256(), [], []
    matches = np.zeros(2, np.int64)
    for frame in islice(sequence, num_frames):
        _take_in(digest, frame)
        motion = odometry.step(frame)
        if frame.index > 0:
            motions.append(motion.T_curr_prev)
            tracks = odometry.tracks
            used = odometry.used & (motion.status is Status.OK)  # a step that was carried on teaches nothing
            steps.append((tracks.prev_px, tracks.curr_px, odometry.phi, used))
        matches += count_matches(odometry.tracks)
        if frame.index == min(FRAMES_TO_SEE, num_frames - 1):
            check_left_right(int(matches[0]), int(matches[1]), sequence.path)
        if on_frame is not None:
            on_frame(frame.index + 1)
    prev_px, curr_px, phi, used = (np.concatenate(part) for part in zip(*steps, strict=True))
    return Drive(
        digest=digest.hexdigest(),
        T_curr_prev=np.array(motions),
        first_of_step=np.cumsum([0, *(len(step[0]) for step in steps)]),
        prev_px=prev_px,
        curr_px=curr_px,
        phi=phi,
        used=used,
    )


def _take_in(digest: Digest, frame: Frame) -> None:
    digest.update(np.int64(frame.stamp_ns).tobytes())
    arrays: list[AnyArray | None] = [frame.left, frame.right]
    if frame.features is not None:
        arrays += [frame.features.ids, frame.features.pixels]
    if frame.imu is not None:
        arrays += [frame.imu.stamps_ns, frame.imu.gyro_rad_s, frame.imu.accel_m_s2]
    for array in arrays:
        if array is not None:
            digest.update(np.ascontiguousarray(array).tobytes())


def save_drive(path: Path, drive: Drive) -> None:
    """Write a drive as an ``.npz`` file, whole or not at all."""
    buffer = io.BytesIO()
    np.savez(
        buffer, allow_pickle=False, **{field.name: np.asarray(getattr(drive, field.name)) for field in fields(Drive)}
    )
    write_atomically(path, buffer.getvalue())


def load_drive(path: Path) -> Drive:
    """Read what ``save_drive`` wrote."""
    with np.load(path, allow_pickle=False) as archive:
        arrays = {field.name: archive[field.name] for field in fields(Drive)}
    return Drive(**arrays | {"digest": str(arrays["digest"])})
