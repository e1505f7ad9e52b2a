"""What a sequence yields: one stereo frame with the IMU samples of the interval that led to it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.sequences.prepared_images import PreparedImages

SHORTEST_STEP_NS = 1_000
"""No camera takes frames closer together; stamps that are have another unit."""


@dataclass(frozen=True)
class ImuSamples:
    """Samples that cover one frame interval: the last at or before its start to the first at or
    after its end."""

    stamps_ns: IntArray
    """Time of each sample on the clock of the images (offsets already applied), [J], ascending."""
    gyro_rad_s: FloatArray
    """Angular rate of the IMU frame, in the IMU frame, [J, 3]."""
    accel_m_s2: FloatArray
    """Specific force (gravity included) in the IMU frame, [J, 3]; NaN where not recorded."""

    def followed_by(self, later: ImuSamples) -> ImuSamples:
        """The samples of two consecutive intervals as those of one; what both hold around their
        border counts once."""
        new = later.stamps_ns > self.stamps_ns.max(initial=np.iinfo(np.int64).min)
        return ImuSamples(
            np.concatenate([self.stamps_ns, later.stamps_ns[new]]),
            np.concatenate([self.gyro_rad_s, later.gyro_rad_s[new]]),
            np.concatenate([self.accel_m_s2, later.accel_m_s2[new]]),
        )


@dataclass(frozen=True)
class StereoFeatures:
    """Points seen in one stereo frame."""

    ids: IntArray
    """Identity of each point, [N], unique in the frame, the same in every frame that sees the
    point."""
    pixels: FloatArray
    """(u_l, v_l, u_r, v_r) of each point, [N, 4], px."""


@dataclass(frozen=True)
class Frame:
    """One instant of a stereo recording: either two rectified images, or features already tracked."""

    index: int
    """Position in the sequence, from 0."""
    stamp_ns: int
    left: Image | None = None
    """Rectified left image, [height, width], uint8. It is kept until the next frame: do not write
    to it again."""
    right: Image | None = None
    features: StereoFeatures | None = None
    """Given instead of images by a tracks file."""
    imu: ImuSamples | None = None
    """IMU samples over the interval from the previous frame to this one; None at the first frame,
    without an IMU, and where its samples leave a part of the interval uncovered."""
    decode_ms: float = field(default=0.0, compare=False)
    """Time that a worker thread spent to read, decode and rectify the pair."""
    prepared: PreparedImages | None = field(default=None, compare=False, repr=False)
    """What tracking has already done with the images, if it was given the time
    (``tracking.preparation``)."""


def check_frame(frame: Frame, camera: StereoCamera) -> None:
    """Refuse images, or features, that a reader would not have let through.

    Raises:
        InputError: a stamp that is no whole number; an image that is missing, or not grey, of 8
            bits, and of the size of the camera and of the other one; an identity that appears
            twice, or without pixels; IMU samples out of order, or of which the turn rate is not
            known; a negative index.
    """
    where = f"frame {frame.index}"
    if not isinstance(frame.stamp_ns, int | np.integer):
        raise InputError(
            where, f"its stamp_ns is {frame.stamp_ns!r}.", "Give whole nanoseconds, as an int."
        )
    if frame.index < 0:
        raise InputError(where, "its index is negative.", "Count from 0.")
    if frame.features is None and (frame.left is None or frame.right is None):
        missing = [name for name in ("left", "right") if getattr(frame, name) is None]
        what = (
            f"its {missing[0]} image is missing."
            if len(missing) == 1
            else "it has neither images nor features."
        )
        raise InputError(where, what, "Give both images, or features.")
    for name, image in (("left", frame.left), ("right", frame.right)):
        if image is not None and (image.ndim != 2 or image.dtype != np.uint8):
            what = f"its {name} image is {image.dtype} of shape {image.shape}."
            raise InputError(where, what, "Give a grey image, [height, width], of type uint8.")
        if image is not None and camera.size_px is not None and image.shape[::-1] != camera.size_px:
            what = f"its {name} image is {_size(image)} px, the camera's are"
            raise InputError(
                where, f"{what} {'×'.join(map(str, camera.size_px))}.", "Scale image or camera."
            )
    if frame.left is not None and frame.right is not None and frame.left.shape != frame.right.shape:
        what = f"its images are {_size(frame.left)} and {_size(frame.right)} px."
        raise InputError(where, what, "Give both the same size, as rectification does.")
    if frame.left is not None and not frame.left.size:
        raise InputError(where, "its images have no pixels.", "Leave the frame out.")
    if frame.features is not None and frame.features.pixels.shape != (len(frame.features.ids), 4):
        what = (
            f"it has {len(frame.features.ids)} identities and pixels of shape"
            f" {frame.features.pixels.shape}."
        )
        raise InputError(where, what, "Give [N] and [N, 4].")
    if frame.features is not None and len(np.unique(frame.features.ids)) < len(frame.features.ids):
        raise InputError(
            where, "two of its features have the same identity.", "Give each point one of its own."
        )
    if frame.imu is not None and not (np.diff(frame.imu.stamps_ns) > 0).all():
        raise InputError(
            where, "its IMU samples are not in the order of their times.", "Sort them."
        )
    if frame.imu is not None and frame.imu.gyro_rad_s.shape != (len(frame.imu.stamps_ns), 3):
        what = (
            f"{len(frame.imu.stamps_ns)} IMU samples have turn rates of shape"
            f" {frame.imu.gyro_rad_s.shape}."
        )
        raise InputError(where, what, "Give [N] and [N, 3].")
    if frame.imu is not None and not np.isfinite(frame.imu.gyro_rad_s).all():
        raise InputError(
            where, "an IMU sample of it has no finite turn rate.", "Leave that sample out."
        )


def check_order(before: Frame, frame: Frame) -> float:
    """Time from one frame to the next, s.

    Raises:
        InputError: the second is not after the first, is too soon after it, has features where that
            had images, or images of another size, or in the same memory.
    """
    where = f"frame {frame.index}"
    if frame.stamp_ns <= before.stamp_ns:
        what = (
            f"its stamp, {frame.stamp_ns} ns, is not after that of the frame before,"
            f" {before.stamp_ns} ns."
        )
        raise InputError(where, what, "Give the frames in the order of their times.")
    if frame.stamp_ns - before.stamp_ns < SHORTEST_STEP_NS:
        what = f"its stamp, {frame.stamp_ns} ns, is less than 1 µs after that of the frame before."
        raise InputError(where, what, "Stamps are nanoseconds, not milliseconds or seconds.")
    if (frame.features is None) != (before.features is None):
        raise InputError(
            where,
            "one of it and the frame before has images, the other features.",
            "Keep to one kind.",
        )
    for earlier, later in ((before.left, frame.left), (before.right, frame.right)):
        if earlier is not None and later is not None and earlier.shape != later.shape:
            what = f"its images are {_size(later)} px, not {_size(earlier)} px as before."
            raise InputError(where, what, "Keep to one size.")
        if earlier is not None and later is not None and earlier.ctypes.data == later.ctypes.data:
            what = (
                "an image of it is in the same memory as that of the frame before, which is still"
                " needed."
            )
            raise InputError(where, what, "Hand in a new array each time, such as image.copy().")
    return 1e-9 * (frame.stamp_ns - before.stamp_ns)


def _size(image: Image) -> str:
    return "×".join(map(str, image.shape[::-1]))


def is_repeated(before: Frame, frame: Frame) -> bool:
    """Whether a frame shows an image of the one before again, byte by byte: noise makes those of a
    camera differ."""
    pairs = (before.left, frame.left), (before.right, frame.right)
    return any(a is not None and b is not None and _is_same(a, b) for a, b in pairs)


def _is_same(one: Image, other: Image) -> bool:
    middle = slice(len(one) // 2, len(one) // 2 + 1)  # nearly all that differ do so there
    return np.array_equal(one[middle], other[middle]) and np.array_equal(one, other)


@dataclass(frozen=True)
class GroundTruth:
    """Poses of the left camera in the frame of its first pose."""

    stamps_ns: IntArray
    """[K]; those of the frames."""
    T_world_cam: FloatArray
    """[K, 4, 4]; NaN matrices where the truth is unknown."""

    @property
    def known(self) -> BoolArray:
        """Which frames have a pose, [K]."""
        return np.asarray(np.isfinite(self.T_world_cam).all(axis=(1, 2)))
