"""Frames of a sequence: a stereo pair, and the IMU samples since the previous frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.sequences.prepared_images import PreparedImages

WHITE = 128
"""Lowest grey level of a mask at which features are wanted."""


@dataclass(frozen=True)
class ImuSamples:
    """The IMU samples that cover the interval between two frames.

    They range from the last one at or before its start to the first one at or after its end.
    """

    stamps_ns: IntArray
    """Time of each sample on the clock of the images (offsets already applied), [J], ascending."""
    gyro_rad_s: FloatArray
    """Angular rate of the IMU frame, in the IMU frame, [J, 3]."""
    accel_m_s2: FloatArray
    """Specific force (gravity included) in the IMU frame, [J, 3]; NaN where not recorded."""

    def followed_by(self, later: ImuSamples) -> ImuSamples:
        """Join the samples of two consecutive intervals.

        Samples around the common border, which both hold, are kept once.
        """
        is_new = later.stamps_ns > self.stamps_ns.max(initial=np.iinfo(np.int64).min)
        return ImuSamples(
            stamps_ns=np.concatenate([self.stamps_ns, later.stamps_ns[is_new]]),
            gyro_rad_s=np.concatenate([self.gyro_rad_s, later.gyro_rad_s[is_new]]),
            accel_m_s2=np.concatenate([self.accel_m_s2, later.accel_m_s2[is_new]]),
        )


@dataclass(frozen=True)
class StereoFeatures:
    """The points that another front end tracked, as seen in one stereo frame."""

    ids: IntArray
    """Identity of each point, [N]: unique in a frame, the same in every frame that sees it."""
    pixels: FloatArray
    """Observation (u_l, v_l, u_r, v_r) of each point, [N, 4], px."""


@dataclass(frozen=True)
class Frame:
    """One instant of a stereo recording: two rectified images, or features already tracked."""

    index: int
    """Position in the sequence, from 0. It may skip numbers, but not repeat any."""
    stamp_ns: int
    """Time of the images. It increases from frame to frame: after one stamp that is far ahead, all
    later frames are refused until a new odometry is started."""
    left: Image | None = None
    """Rectified left image, [height, width], uint8. The odometry keeps it, until a later frame is
    solved: do not write to it again."""
    right: Image | None = None
    """Rectified right image, likewise."""
    features: StereoFeatures | None = None
    """Tracked features, which a tracks file gives instead of images."""
    imu: ImuSamples | None = None
    """IMU samples over the interval from the previous frame to this one. None at the first frame,
    without an IMU, and where the samples do not cover the whole interval."""
    decode_ms: float = field(default=0.0, compare=False)
    """Time that a worker thread needed to read, decode and rectify the pair."""
    prepared: PreparedImages | None = field(default=None, compare=False, repr=False)
    """The images as ``tracking.preparation`` prepared them ahead of time, if it did."""
    left_mask: Image | BoolArray | None = field(default=None, compare=False)
    """Where features of the left image are wanted, [height, width]: True, or from 128 on. No window
    of a feature reaches into the rest, such as a bonnet. None for everywhere."""
    right_mask: Image | BoolArray | None = field(default=None, compare=False)
    """The same for the right image."""

    def __repr__(self) -> str:
        """Return index, stamp and what the frame holds, in one line."""
        parts = [f"index={self.index}", f"stamp_ns={self.stamp_ns}"]
        parts += [
            f"{name}: {size_text(image)} px"
            for name, image in (("left", self.left), ("right", self.right))
            if image is not None
        ]
        if self.features is not None:
            parts.append(f"{len(self.features.ids)} features")
        if self.imu is not None:
            parts.append(f"{len(self.imu.stamps_ns)} IMU samples")
        return f"Frame({', '.join(parts)})"


@dataclass(frozen=True)
class GroundTruth:
    """True poses of the left camera, in the frame of its first known pose."""

    stamps_ns: IntArray
    """Times of the frames, [K]."""
    T_world_cam: FloatArray
    """Poses, [K, 4, 4], m; matrices of NaN where the truth is unknown."""

    @property
    def known(self) -> BoolArray:
        """Whether each frame has a pose, [K]."""
        return np.asarray(np.isfinite(self.T_world_cam).all(axis=(1, 2)))

    def __repr__(self) -> str:
        """Return the number of frames and of true poses in one line."""
        return f"GroundTruth({len(self.stamps_ns)} frames, {self.known.sum()} with a pose)"


def size_text(image: Image) -> str:
    """Return width × height of an image as text."""
    return "×".join(map(str, image.shape[::-1]))
