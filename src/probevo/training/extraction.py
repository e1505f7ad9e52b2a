"""Recording → drive, part by part: the odometry runs over it once, and no more than a part is held
in memory."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator
from itertools import islice

import numpy as np

from probevo.arrays import AnyArray, BoolArray, FloatArray, IntArray
from probevo.config import OdometryConfig
from probevo.estimation.motion_estimate import Status
from probevo.noise import StudentT
from probevo.noise.metric import check_defined
from probevo.odometry import StereoOdometry
from probevo.predictors import PredictionSpace
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame
from probevo.tracking.left_right import FRAMES_TO_SEE, check_left_right, count_matches
from probevo.tracking.tracks import Tracks
from probevo.training.drive import Drive
from probevo.training.sources import calibration

MOST_STEPS = 1000
MOST_BYTES = 32_000_000
"""Of a part, as it lies on disk; a single step may be larger."""


class Extraction:
    """Walk through a recording with static robust noise, and keep every step's features with their
    predictors.

    Args:
        sequence: the recording.
        space: the predictors.
        config: all settings of the odometry.
        num_frames: how many of its frames, at least 2.
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
        self._odometry = StereoOdometry(
            sequence.camera, StudentT(), sequence.imu, config=config, predictors=space
        )
        self._digest = hashlib.sha256(json.dumps(calibration(sequence)).encode())
        self._matches = np.zeros(2, np.int64)

    @property
    def digest(self) -> str:
        """SHA-256 of all that the odometry was given so far: calibration, stamps, images or
        features, IMU samples."""
        return self._digest.hexdigest()

    def __iter__(self) -> Iterator[Drive]:
        """The parts, each of at most MOST_STEPS and MOST_BYTES.

        Raises:
            InputError: the recording is faulty, its left and right images are swapped, it lacks
                what a predictor needs, or a predictor is undefined where it must not be.
        """
        part = _Part()
        size = 0
        number = 0
        for frame in islice(self.sequence, self.num_frames):
            motion = self._step(frame)
            if motion is None:
                continue
            odometry = self._odometry
            used = odometry.used & motion[1]  # a step that was carried on teaches nothing
            added = _bytes(odometry.phi)
            if len(part) and (len(part) == MOST_STEPS or size + added > MOST_BYTES):
                yield part.drive(number)
                part, size, number = _Part(), 0, number + len(part)
            part.add(motion[0], odometry.tracks, odometry.phi, used)
            size += added
        yield part.drive(number)

    def _step(self, frame: Frame) -> tuple[FloatArray, bool] | None:
        """Motion to this frame, and whether it was solved; None of the first."""
        _take_in(self._digest, frame)
        motion = self._odometry.step(frame)
        odometry = self._odometry
        check_defined(odometry.phi, self.space.columns, self.space.may_be_undefined)
        self._matches += count_matches(odometry.tracks)
        if frame.index == min(FRAMES_TO_SEE, self.num_frames - 1):
            check_left_right(int(self._matches[0]), int(self._matches[1]), self.sequence.path)
        if self.on_frame is not None:
            self.on_frame(frame.index + 1)
        return None if frame.index == 0 else (motion.T_curr_prev, motion.status is Status.OK)


class _Part:
    """Steps that are gathered for a drive."""

    def __init__(self) -> None:
        self.motions: list[FloatArray] = []
        self.steps: list[tuple[FloatArray, FloatArray, IntArray, FloatArray, BoolArray]] = []

    def __len__(self) -> int:
        return len(self.steps)

    def add(
        self, T_curr_prev: FloatArray, tracks: Tracks, phi: FloatArray, used: BoolArray
    ) -> None:
        self.motions.append(T_curr_prev)
        self.steps.append((tracks.prev_px, tracks.curr_px, tracks.ids, phi, used))

    def drive(self, first: int) -> Drive:
        """The part; the number of its first step."""
        prev_px, curr_px, ids, phi, used = (
            np.concatenate(part) for part in zip(*self.steps, strict=True)
        )
        first_of_step = np.cumsum([0, *(len(step[0]) for step in self.steps)])
        numbers = np.arange(first, first + len(self.motions))
        return Drive(
            np.array(self.motions),
            numbers,
            first_of_step,
            prev_px=prev_px,
            curr_px=curr_px,
            ids=ids,
            phi=phi,
            used=used,
        )


def _bytes(phi: FloatArray) -> int:
    """What a step takes on disk: its features' observations, identities, predictors and marks, its
    motion and place."""
    count, columns = map(int, phi.shape)
    return count * (4 * (4 + 4 + columns) + 8 + 1) + 136


def _take_in(digest: hashlib._Hash, frame: Frame) -> None:
    digest.update(np.int64(frame.stamp_ns).tobytes())
    arrays: list[AnyArray | None] = [frame.left, frame.right]
    if frame.features is not None:
        arrays += [frame.features.ids, frame.features.pixels]
    if frame.imu is not None:
        arrays += [frame.imu.stamps_ns, frame.imu.gyro_rad_s, frame.imu.accel_m_s2]
    for array in arrays:
        if array is not None:
            digest.update(np.ascontiguousarray(array).tobytes())
