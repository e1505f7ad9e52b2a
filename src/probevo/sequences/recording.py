"""Recordings of stereo images: what all have in common, and the one that reads image files."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from probevo.arrays import Image, IntArray
from probevo.camera.rectification import Rectification
from probevo.camera.stereo import StereoCamera
from probevo.sequences.frame import Frame, GroundTruth, ImuSamples
from probevo.sequences.gray_range import GrayRange
from probevo.sequences.images import read_gray
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.read_ahead import read_ahead


@dataclass(frozen=True, eq=False, kw_only=True)
class ImageRecording:
    """What all recordings of stereo images have in common, wherever their images come from."""

    path: Path
    format: str
    camera: StereoCamera
    stamps_ns: IntArray
    imu: ImuCalibration | None = None
    imu_stream: ImuStream | None = None
    truth: GroundTruth | None = None
    rectification: Rectification | None = None
    """None where the images are already rectified."""
    gray_range: GrayRange | None = None
    """How images of 16 bits are reduced to 8; None to refuse them."""
    notes: tuple[tuple[str, str], ...] = ()
    """Name and text of what the reader has to report, such as unpaired images."""

    def __len__(self) -> int:
        """Return the number of frames, K."""
        return len(self.stamps_ns)

    def __repr__(self) -> str:
        """Return format, path, frames and camera in one line."""
        extras = [name for name in ("imu", "truth") if getattr(self, name) is not None]
        width_px, height_px = self.camera.size_px or (0, 0)
        also = f", with {' and '.join(extras)}" if extras else ""
        return (
            f"<{self.format} recording {self.path}: {len(self)} frames,"
            f" {width_px}×{height_px} px, baseline {self.camera.baseline_m:.4g} m{also}>"
        )

    @property
    def left_mask(self) -> Image | None:
        """Where the left images show something, [height, width]; None for everywhere.

        A rectification may leave them black outside of the raw images.
        """
        return None if self.rectification is None else self.rectification.left_mask

    @property
    def right_mask(self) -> Image | None:
        """The same of the right images."""
        return None if self.rectification is None else self.rectification.right_mask

    def imu_before(self, index: int) -> ImuSamples | None:
        """Return the IMU samples from the previous frame to this one; None if there are none."""
        if self.imu_stream is None or index == 0:
            return None
        return self.imu_stream.between(int(self.stamps_ns[index - 1]), int(self.stamps_ns[index]))


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class StereoRecording(ImageRecording):
    """A ``Sequence`` of stereo image files, which are read while it is iterated over."""

    left_files: list[Path]
    right_files: list[Path]

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames from the first; raise InputError at a faulty image."""
        return read_ahead(self._read_frame, range(len(self)))

    def _read_frame(self, index: int) -> Frame:
        """Read, decode and rectify one frame.

        Raises:
            InputError: an image is missing or damaged.
        """
        start = time.perf_counter()
        left = read_gray(self.left_files[index], self.camera.size_px, self.gray_range)
        right = read_gray(self.right_files[index], self.camera.size_px, self.gray_range)
        if self.rectification is not None:
            left, right = self.rectification.rectify(left, right)
        imu = self.imu_before(index)
        elapsed_ms = 1e3 * (time.perf_counter() - start)
        return Frame(
            index=index,
            stamp_ns=int(self.stamps_ns[index]),
            left=left,
            right=right,
            imu=imu,
            decode_ms=elapsed_ms,
            left_mask=self.left_mask,
            right_mask=self.right_mask,
        )
