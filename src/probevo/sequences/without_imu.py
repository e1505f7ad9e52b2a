"""A view of a recording without its IMU."""

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
    """A ``Sequence`` with the frames of another one, without their IMU samples."""

    path: Path
    format: str
    camera: StereoCamera
    stamps_ns: IntArray
    truth: GroundTruth | None
    frames: Sequence
    imu: None = None

    @staticmethod
    def of(sequence: Sequence) -> WithoutImu:
        """Return a recording without its IMU."""
        return WithoutImu(
            path=sequence.path,
            format=sequence.format,
            camera=sequence.camera,
            stamps_ns=sequence.stamps_ns,
            truth=sequence.truth,
            frames=sequence,
        )

    def __len__(self) -> int:
        """Return the number of frames, K."""
        return len(self.frames)

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames from the first."""
        return (replace(frame, imu=None) for frame in self.frames)
