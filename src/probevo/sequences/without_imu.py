"""A recording as if it had no IMU."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from probevo.arrays import IntArray
from probevo.camera.stereo import StereoCamera
from probevo.sequences.base import Sequence
from probevo.sequences.frame import Frame, GroundTruth


@dataclass(frozen=True, eq=False)
class WithoutImu:
    """The ``Sequence`` of another one's frames, less their IMU samples."""

    path: Path
    format: str
    camera: StereoCamera
    stamps_ns: IntArray
    truth: GroundTruth | None
    frames: Sequence
    imu: None = None

    @staticmethod
    def of(sequence: Sequence) -> WithoutImu:
        """That recording without its IMU."""
        facts = (
            sequence.path,
            sequence.format,
            sequence.camera,
            sequence.stamps_ns,
            sequence.truth,
        )
        return WithoutImu(*facts, sequence)

    def __len__(self) -> int:
        """Number of frames, K."""
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        """The frames, from the first."""
        return (replace(frame, imu=None) for frame in self.frames)
