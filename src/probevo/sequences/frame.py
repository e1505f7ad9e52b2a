"""Frames of a sequence: a stereo pair, and the IMU samples since the previous frame."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError, brief
from probevo.sequences.prepared_images import PreparedImages
from probevo.sequences.text import INT64_LIMIT

WHITE = 128
"""Grey level of a mask from which on features are wanted."""
SHORTEST_STEP_NS = 1_000
"""Shortest plausible time between two frames. Stamps that are closer have another unit."""


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
    """Position in the sequence, from 0."""
    stamp_ns: int
    left: Image | None = None
    """Rectified left image, [height, width], uint8. The odometry keeps it until the next frame: do
    not write to it again."""
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
            f"{name}: {_size(image)} px"
            for name, image in (("left", self.left), ("right", self.right))
            if image is not None
        ]
        if self.features is not None:
            parts.append(f"{len(self.features.ids)} features")
        if self.imu is not None:
            parts.append(f"{len(self.imu.stamps_ns)} IMU samples")
        return f"Frame({', '.join(parts)})"


def check_frame(frame: Frame, camera: StereoCamera) -> None:
    """Refuse a frame that is not usable by itself.

    Raises:
        InputError: index or stamp is no whole number of 64 bits; an image is missing, is not grey
            with 8 bits, or has another size than the camera or the other image; a mask is of
            another kind or size than its image; an identity appears
            twice, or the counts of identities and pixels differ; IMU samples are out of order, or
            an angular rate is missing or not finite; the index is negative.
    """
    where = f"frame {frame.index}"
    if not isinstance(frame.index, int | np.integer):
        raise InputError(where, f"its index is {brief(frame.index)}.", "Give an int.")
    if not isinstance(frame.stamp_ns, int | np.integer):
        what = f"its stamp_ns is {brief(frame.stamp_ns)}."
        raise InputError(where, what, "Give whole nanoseconds, as an int.")
    if not -INT64_LIMIT <= frame.stamp_ns < INT64_LIMIT:
        what = f"its stamp, {brief(int(frame.stamp_ns))} ns, does not fit in 64 bits."
        raise InputError(where, what, "Stamps are nanoseconds, mostly since 1970.")
    if frame.index < 0:
        raise InputError(where, "its index is negative.", "Count from 0.")
    _check_images(frame, camera, where)
    if frame.features is not None:
        _check_features(frame.features, where)
    if frame.imu is not None:
        _check_imu_samples(frame.imu, where)


def _check_images(frame: Frame, camera: StereoCamera, where: str) -> None:
    """Refuse images that are missing, of another kind than 8-bit grey, or of a wrong size.

    Raises:
        InputError: names the image at fault.
    """
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
            camera_size = "×".join(map(str, camera.size_px))
            what = f"its {name} image is {_size(image)} px, the camera's are {camera_size}."
            raise InputError(where, what, "Scale image or camera.")
    if frame.left is not None and frame.right is not None and frame.left.shape != frame.right.shape:
        what = f"its images are {_size(frame.left)} and {_size(frame.right)} px."
        raise InputError(where, what, "Give both the same size, as rectification does.")
    if frame.left is not None and not frame.left.size:
        raise InputError(where, "its images have no pixels.", "Leave the frame out.")
    _check_mask("left", frame.left_mask, frame.left, where)
    _check_mask("right", frame.right_mask, frame.right, where)


def _check_mask(name: str, mask: object, image: Image | None, where: str) -> None:
    """Refuse a mask of another kind than bool or uint8, or of another size than its image.

    Raises:
        InputError: says which.
    """
    if mask is None:
        return
    if image is None:
        what = f"it has a {name} mask, but no images."
        raise InputError(where, what, "Leave out the features that are not wanted.")
    if not isinstance(mask, np.ndarray) or mask.dtype not in (np.bool_, np.uint8):
        found = f"of type {mask.dtype}" if isinstance(mask, np.ndarray) else brief(mask)
        what = f"its {name} mask is {found}."
        raise InputError(where, what, "Give [height, width] of bool, True where features may be.")
    if mask.shape != image.shape:
        what = f"its {name} mask has shape {mask.shape}, the image {image.shape}."
        raise InputError(where, what, "Give a mask of the size of the image.")


def _check_features(features: StereoFeatures, where: str) -> None:
    """Refuse features with repeated identities, or without an observation for each.

    Raises:
        InputError: says which.
    """
    if features.pixels.shape != (len(features.ids), 4):
        what = f"it has {len(features.ids)} identities and pixels of shape {features.pixels.shape}."
        raise InputError(where, what, "Give [N] and [N, 4].")
    if len(np.unique(features.ids)) < len(features.ids):
        raise InputError(
            where, "two of its features have the same identity.", "Give each point one of its own."
        )


def _check_imu_samples(imu: ImuSamples, where: str) -> None:
    """Refuse IMU samples out of order, or without a finite angular rate.

    Raises:
        InputError: says which.
    """
    if not (np.diff(imu.stamps_ns) > 0).all():
        raise InputError(
            where, "its IMU samples are not in the order of their times.", "Sort them."
        )
    for name, array in (("turn rates", imu.gyro_rad_s), ("specific forces", imu.accel_m_s2)):
        if np.shape(array) != (len(imu.stamps_ns), 3):
            what = f"{len(imu.stamps_ns)} IMU samples have {name} of shape {np.shape(array)}."
            raise InputError(where, what, "Give [N] and [N, 3], NaN where not recorded.")
    if not np.isfinite(imu.gyro_rad_s).all():
        raise InputError(
            where, "an IMU sample of it has no finite turn rate.", "Leave that sample out."
        )


def check_order(prev: Frame, curr: Frame) -> float:
    """Return the time from one frame to the next, s.

    Raises:
        InputError: the second frame is not after the first, or is too soon after it; one has
            images and the other features; their images have different sizes, or share memory.
    """
    where = f"frame {curr.index}"
    if curr.stamp_ns <= prev.stamp_ns:
        what = (
            f"its stamp, {curr.stamp_ns} ns, is not after that of the frame before,"
            f" {prev.stamp_ns} ns."
        )
        raise InputError(where, what, "Give the frames in the order of their times.")
    if curr.stamp_ns - prev.stamp_ns < SHORTEST_STEP_NS:
        what = f"its stamp, {curr.stamp_ns} ns, is less than 1 µs after that of the frame before."
        raise InputError(where, what, "Stamps are nanoseconds, not milliseconds or seconds.")
    if (curr.features is None) != (prev.features is None):
        what = "one of it and the frame before has images, the other features."
        raise InputError(where, what, "Keep to one kind.")
    for prev_image, curr_image in ((prev.left, curr.left), (prev.right, curr.right)):
        if prev_image is None or curr_image is None:
            continue
        if prev_image.shape != curr_image.shape:
            what = f"its images are {_size(curr_image)} px, not {_size(prev_image)} px as before."
            raise InputError(where, what, "Keep to one size.")
        if prev_image.ctypes.data == curr_image.ctypes.data:
            what = (
                "an image of it is in the same memory as that of the frame before, which is still"
                " needed."
            )
            raise InputError(where, what, "Hand in a new array each time, such as image.copy().")
    return 1e-9 * (curr.stamp_ns - prev.stamp_ns)


def _size(image: Image) -> str:
    """Return width × height of an image as text."""
    return "×".join(map(str, image.shape[::-1]))


BLOCK_PX = 8
"""Side of the blocks over which noise is averaged out."""
STANDING_DIFFERENCE = 0.03
"""Difference of two images of blocks, over the contrast, below which they show the same."""


def is_repeated(prev: Frame, curr: Frame) -> bool:
    """Return whether an image of a frame equals that of the previous frame, byte by byte.

    The noise of a camera makes two exposures differ, so that equal images mean a dropped frame.
    """
    pairs = ((prev.left, curr.left), (prev.right, curr.right))
    return any(
        one is not None and other is not None and _are_equal(one, other) for one, other in pairs
    )


def looks_repeated(prev: Frame, curr: Frame) -> bool:
    """Return whether the left image of a frame is that of the previous frame but for noise.

    Noise averages out over blocks of pixels. What is left of the difference, over the contrast of
    the image, is 0.3 or more from frame to frame on KITTI, Karlsruhe, and EuRoC in motion, and 0.01
    where EuRoC is at rest.
    """
    if prev.left is None or curr.left is None:
        return False
    before = _block_means(prev.left)
    now = _block_means(curr.left)
    return float((now - before).std()) < STANDING_DIFFERENCE * float(now.std())


def _block_means(image: Image) -> FloatArray:
    """Return the means of whole blocks of pixels, in every fourth row of blocks.

    That is enough of them. An image that is smaller than a block is one.
    """
    height, width = image.shape
    if height < BLOCK_PX or width < BLOCK_PX:
        return np.full((1, 1), image.mean())
    rows = height // BLOCK_PX
    columns = width // BLOCK_PX
    blocks = image[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, -1)[::4]
    strips = blocks.reshape(-1, columns * BLOCK_PX)
    means = cv2.resize(strips, (columns, len(blocks)), interpolation=cv2.INTER_AREA)
    return means.astype(np.float64)


def _are_equal(one: Image, other: Image) -> bool:
    """Return whether two images are equal; nearly all that differ do so in their middle row."""
    middle = slice(len(one) // 2, len(one) // 2 + 1)
    return np.array_equal(one[middle], other[middle]) and np.array_equal(one, other)


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
