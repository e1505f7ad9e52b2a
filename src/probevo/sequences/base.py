"""The protocol of recordings, which every format implements."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Protocol

from probevo.arrays import IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.sequences.frame import Frame, GroundTruth
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration


class Sequence(Protocol):
    """A stereo recording that is read while it is iterated over, any number of times."""

    @property
    def path(self) -> Path:
        """Folder or file of the recording."""

    @property
    def format(self) -> str:
        """Name of the format, e.g. ``kitti-raw``."""

    @property
    def camera(self) -> StereoCamera:
        """Rectified stereo camera of the images or features."""

    @property
    def imu(self) -> ImuCalibration | None:
        """Calibration of the IMU; None if the recording has none."""

    @property
    def stamps_ns(self) -> IntArray:
        """Time of each frame, [K], strictly ascending."""

    @property
    def truth(self) -> GroundTruth | None:
        """Ground truth at the frames; None if the recording has none."""

    def __len__(self) -> int:
        """Return the number of frames, K."""

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames from the first; their indices are 0, 1, …, K − 1.

        Raises:
            InputError: a file of that frame is faulty.
        """


def imu_stream_of(sequence: Sequence) -> ImuStream | None:
    """Return all IMU samples of a recording at their own rate; None if it has none, or yields
    them with its frames only."""
    stream: ImuStream | None = getattr(sequence, "imu_stream", None)
    return stream


def first_frames(sequence: Sequence, num_frames: int) -> Iterator[Frame]:
    """Yield the first frames of a recording.

    Raises:
        InputError: the index of a frame is not its place in the recording, as a ``Sequence`` of a
            user's own may have it.
    """
    for place, frame in enumerate(islice(sequence, num_frames)):
        if frame.index != place:
            raise InputError(
                sequence.path,
                f"frame {place} of the recording has the index {frame.index}.",
                "Number the frames 0, 1, 2, …, without gaps.",
            )
        yield frame
