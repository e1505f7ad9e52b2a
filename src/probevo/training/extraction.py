"""Recording → drive: the odometry runs over the recording once, and the drive is yielded in parts.

At most one part is held in memory.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.config import OdometryConfig
from probevo.estimation.motion_estimate import Status
from probevo.noise import StudentT
from probevo.noise.metric import check_defined
from probevo.odometry import StereoOdometry
from probevo.predictors import PredictionSpace
from probevo.sequences.base import Sequence, first_frames
from probevo.sequences.content import hash_frame
from probevo.sequences.frame import Frame
from probevo.tracking.left_right import LeftRightCheck
from probevo.tracking.repeated_images import are_repeated
from probevo.tracking.tracks import Tracks
from probevo.training.drive import Drive
from probevo.training.sources import calibration

MAX_STEPS = 1000
"""Largest number of steps in a part."""
MAX_BYTES = 32_000_000
"""Largest size of a part on disk; a single step may be larger."""


class Extraction:
    """A walk through a recording with static robust noise, which keeps the features of every step.

    Args:
        sequence: the recording.
        space: the predictors.
        config: all settings of the odometry.
        num_frames: how many of its frames to use, at least 2.
        on_frame: called with how many frames are done.
    """

    def __init__(
        self,
        sequence: Sequence,
        space: PredictionSpace,
        config: OdometryConfig,
        num_frames: int,
        on_frame: Callable[[int], None] | None = None,
    ) -> None:
        self.sequence = sequence
        self.space = space
        self.num_frames = num_frames
        self.on_frame = on_frame
        # Under noise that fits the recording, the robust loss drops the worst tracks before
        # anything can be learned from them.
        solver = config.solver.model_copy(update={"noise_scale": "model"})
        self._odometry = StereoOdometry(
            sequence.camera,
            StudentT(),
            sequence.imu,
            config=config.model_copy(update={"solver": solver}),
            predictors=space,
        )
        self._digest = hashlib.sha256(json.dumps(calibration(sequence)).encode())
        self._left_right = LeftRightCheck(sequence.path, num_frames)
        self._prev_frame: Frame | None = None

    @property
    def digest(self) -> str:
        """SHA-256 of all that the odometry was given so far: calibration, stamps, images or
        features, IMU samples."""
        return self._digest.hexdigest()

    def __iter__(self) -> Iterator[Drive]:
        """Yield the parts, each of at most MAX_STEPS and MAX_BYTES.

        Raises:
            InputError: the recording is faulty, its left and right images are swapped, it lacks
                what a predictor needs, or a predictor is undefined where it must not be.
        """
        part = _Part(first_step=0)
        part_bytes = 0
        for frame in first_frames(self.sequence, self.num_frames):
            motion = self._step(frame)
            if motion is None:
                continue
            T_curr_prev, can_teach = motion

            # Begin a new part where this step would make the current one too large.
            step_bytes = _bytes(self._odometry.phi)
            is_full = len(part) == MAX_STEPS or part_bytes + step_bytes > MAX_BYTES
            if len(part) and is_full:
                yield part.drive()
                part = _Part(first_step=part.first_step + len(part))
                part_bytes = 0

            used = self._odometry.used & can_teach
            part.add(T_curr_prev, self._odometry.tracks, self._odometry.phi, used)
            part_bytes += step_bytes
        yield part.drive()

    def _step(self, frame: Frame) -> tuple[FloatArray, bool] | None:
        """Return the motion to this frame and whether it can be learned from; None for the first
        frame."""
        # The digest identifies the training data in the model's metadata.
        hash_frame(self._digest, frame)
        motion = self._odometry.step(frame)
        odometry = self._odometry
        check_defined(odometry.phi, self.space.columns, self.space.may_be_undefined)

        self._left_right.see(frame, odometry.tracks)
        if self.on_frame is not None:
            self.on_frame(frame.index + 1)
        prev_frame = self._prev_frame
        self._prev_frame = frame
        if prev_frame is None:
            return None
        # Nothing is learned from dead reckoning, nor from errors that repeat with the images.
        can_teach = motion.status is Status.OK and not _repeats(prev_frame, frame)
        return motion.T_curr_prev, can_teach


@dataclass(frozen=True)
class _Step:
    """A step of a part."""

    T_curr_prev: FloatArray
    tracks: Tracks
    phi: FloatArray
    used: BoolArray


@dataclass
class _Part:
    """Steps that are gathered for a part of a drive."""

    first_step: int
    """Number of its first step in the recording."""
    steps: list[_Step] = field(default_factory=list)

    def __len__(self) -> int:
        """Return the number of steps."""
        return len(self.steps)

    def add(
        self, T_curr_prev: FloatArray, tracks: Tracks, phi: FloatArray, used: BoolArray
    ) -> None:
        """Append a step."""
        self.steps.append(_Step(T_curr_prev=T_curr_prev, tracks=tracks, phi=phi, used=used))

    def drive(self) -> Drive:
        """Return the steps as arrays."""
        counts = [len(step.tracks) for step in self.steps]
        return Drive(
            T_curr_prev=np.array([step.T_curr_prev for step in self.steps]),
            numbers=np.arange(self.first_step, self.first_step + len(self.steps)),
            first_of_step=np.cumsum([0, *counts]),
            prev_px=np.concatenate([step.tracks.prev_px for step in self.steps]),
            curr_px=np.concatenate([step.tracks.curr_px for step in self.steps]),
            ids=np.concatenate([step.tracks.ids for step in self.steps]),
            phi=np.concatenate([step.phi for step in self.steps]),
            used=np.concatenate([step.used for step in self.steps]),
        )


def _repeats(prev: Frame, curr: Frame) -> bool:
    """Return whether the images of a frame, or the pixels of all its features, are the previous
    frame's."""
    if prev.features is None or curr.features is None:
        return are_repeated(prev, curr)
    return np.array_equal(prev.features.ids, curr.features.ids) and np.array_equal(
        prev.features.pixels, curr.features.pixels
    )


def _bytes(phi: FloatArray) -> int:
    """Return how many bytes a step with n features and M predictors, [n, M], takes on disk.

    These are observations, identities, predictors and flags of its features, its motion and its
    index.
    """
    # Single precision: two observations of four numbers, and φ. Then an int64, a flag; and a motion
    # of 16 doubles with an index.
    count, columns = map(int, phi.shape)
    return count * (4 * (4 + 4 + columns) + 8 + 1) + 136
