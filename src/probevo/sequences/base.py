"""The protocol behind which every recording format hides."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Protocol

from probevo.arrays import IntArray
from probevo.camera.stereo import StereoCamera
from probevo.sequences.frame import Frame, GroundTruth
from probevo.sequences.imu_calibration import ImuCalibration


class Sequence(Protocol):
    """A stereo recording that can be walked through, any number of times, without being held in
    memory."""

    @property
    def path(self) -> Path:
        """Where the recording lies."""

    @property
    def format(self) -> str:
        """Name of the layout, e.g. ``kitti-raw``."""

    @property
    def camera(self) -> StereoCamera:
        """Rectified stereo camera that the yielded images or features belong to."""

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
        """Number of frames, K."""

    def __iter__(self) -> Iterator[Frame]:
        """The frames, from the first; an InputError comes up at the frame whose files are at fault."""
