"""Image pairs, masks and IMU samples of a recording, for writing it in another format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, Image
from probevo.errors import InputError
from probevo.sequences import Frame, Sequence
from probevo.sequences.base import imu_stream_of
from probevo.sequences.frame import ImuSamples
from probevo.sequences.recording import ImageRecording


@dataclass(frozen=True)
class StereoPair:
    """The rectified images of a frame."""

    index: int
    stamp_ns: int
    left: Image
    right: Image
    left_mask: Image | BoolArray | None = None
    """Where features are wanted, as in ``Frame``."""
    right_mask: Image | BoolArray | None = None


def stereo_pairs(frames: Iterator[Frame], sequence: Sequence) -> Iterator[StereoPair]:
    """Yield the images of the frames.

    Raises:
        InputError: they have none, as those of a tracks file.
    """
    for frame in frames:
        if frame.left is None or frame.right is None:
            what = f"the format {sequence.format} has no images."
            raise InputError(sequence.path, what, "Only recordings of images can be converted.")
        yield StereoPair(
            frame.index,
            frame.stamp_ns,
            left=frame.left,
            right=frame.right,
            left_mask=frame.left_mask,
            right_mask=frame.right_mask,
        )


def imu_samples(sequence: Sequence) -> ImuSamples | None:
    """Return the samples of a recording's IMU as they were recorded; None without an IMU.

    Of a sequence that only yields frames, they are those of all its frames.
    """
    if sequence.imu is None:
        return None
    stream = imu_stream_of(sequence)
    if isinstance(sequence, ImageRecording) and stream is None:
        return None
    if stream is not None:
        # The first and the last are repetitions, beyond the ends of the recording.
        return ImuSamples(
            stamps_ns=stream.stamps_ns[1:-1],
            gyro_rad_s=stream.gyro_rad_s[1:-1],
            accel_m_s2=stream.accel_m_s2[1:-1],
        )
    parts = [frame.imu for frame in sequence if frame.imu is not None]
    if not parts:
        return None
    stamps_ns = np.concatenate([part.stamps_ns for part in parts])
    stamps_ns, first = np.unique(stamps_ns, return_index=True)
    return ImuSamples(
        stamps_ns=stamps_ns,
        gyro_rad_s=np.concatenate([part.gyro_rad_s for part in parts])[first],
        accel_m_s2=np.concatenate([part.accel_m_s2 for part in parts])[first],
    )
