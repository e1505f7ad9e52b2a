"""Checks of single frames and of their order, before the odometry takes them."""

from __future__ import annotations

import numpy as np

from probevo.arrays import Image
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError, brief
from probevo.sequences.frame import WHITE, Frame, ImuSamples, StereoFeatures, size_text
from probevo.sequences.text import INT64_LIMIT

MIN_STEP_NS = 500_000
"""Shortest plausible time between two frames: no stereo camera takes 2,000 pairs a second. Closer
stamps must be in another unit."""
MIN_STEP_OF_UNIX_NS = 1_000
"""The same of stamps from ``UNIX_NS`` on, whose unit is not in question: drivers that stamp images
as these arrive may give two at nearly one time."""
UNIX_NS = 10**18
"""A time of 2001 in ns since 1970; in any larger unit, it is 30,000 years ahead."""
MIN_MICROSECONDS = 1_000
"""Shortest plausible step of stamps in microseconds: that of a thousand pairs a second. Smaller
numbers are milliseconds or longer units."""


def check_frame(frame: Frame, camera: StereoCamera) -> None:
    """Refuse a frame that is not usable by itself.

    Raises:
        InputError: index or stamp is no whole number of 64 bits; an image is missing, is not grey
            with 8 bits, or has another size than the camera or the other image; a mask is of
            another kind or size than its image, or has grey levels below ``WHITE`` only; an
            identity appears twice, or the counts of identities and pixels differ; IMU samples are
            out of order, or an angular rate is missing or not finite; the index is negative.
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
    if not 0 <= frame.index < INT64_LIMIT:
        what = f"its index is {'negative' if frame.index < 0 else 'too large'}."
        raise InputError(where, what, "Count from 0.")
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
        if image is not None and not isinstance(image, np.ndarray):
            what = f"its {name} image is {brief(image)}."
            raise InputError(where, what, "Give a NumPy array, [height, width], of type uint8.")
        if image is not None and (image.ndim != 2 or image.dtype != np.uint8):
            what = f"its {name} image is {image.dtype} of shape {image.shape}."
            raise InputError(where, what, "Give a grey image, [height, width], of type uint8.")
        if image is not None and camera.size_px is not None and image.shape[::-1] != camera.size_px:
            camera_size = "×".join(map(str, camera.size_px))
            what = f"its {name} image is {size_text(image)} px, the camera's are {camera_size}."
            raise InputError(where, what, "Scale image or camera.")
    if frame.left is not None and frame.right is not None and frame.left.shape != frame.right.shape:
        what = f"its images are {size_text(frame.left)} and {size_text(frame.right)} px."
        raise InputError(where, what, "Give both the same size, as rectification does.")
    if frame.left is not None and not frame.left.size:
        raise InputError(where, "its images have no pixels.", "Leave the frame out.")
    _check_mask("left", frame.left_mask, frame.left, where)
    _check_mask("right", frame.right_mask, frame.right, where)


def _check_mask(name: str, mask: object, image: Image | None, where: str) -> None:
    """Refuse a mask of another kind than bool or uint8, of another size than its image, or of 0 and
    1 instead of black and white.

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
    if mask.dtype == np.uint8 and is_too_dark(mask):
        what = f"its {name} mask is nowhere brighter than {mask.max()}, and leaves no feature."
        cure = f"Give bool, or 0 and 255: features may be where it is {WHITE} or more."
        raise InputError(where, what, cure)


def is_too_dark(mask: Image) -> bool:
    """Return whether a mask has grey levels, but none from ``WHITE`` on, such as one of 0 and 1.

    All black is no mistake: what moves through the image may cover it.
    """
    return 0 < int(mask.max(initial=0)) < WHITE


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
    for name, array in (("angular rates", imu.gyro_rad_s), ("specific forces", imu.accel_m_s2)):
        if np.shape(array) != (len(imu.stamps_ns), 3):
            what = f"{len(imu.stamps_ns)} IMU samples have {name} of shape {np.shape(array)}."
            raise InputError(where, what, "Give [N] and [N, 3], NaN where not recorded.")
    if not np.isfinite(imu.gyro_rad_s).all():
        raise InputError(
            where, "an IMU sample of it has no finite angular rate.", "Leave that sample out."
        )


def check_order(prev: Frame, curr: Frame) -> None:
    """Check that one frame can follow another.

    Raises:
        InputError: the second frame is not after the first, by its index or its stamp, or is too
            soon after it; one has images and the other features; their images have different sizes,
            or share memory.
    """
    where = f"frame {curr.index}"
    if curr.stamp_ns <= prev.stamp_ns:
        what = (
            f"its stamp, {curr.stamp_ns} ns, is not after that of the frame before,"
            f" {prev.stamp_ns} ns."
        )
        cure = (
            "Give the frames in the order of their times. If the camera's stamps have jumped, start"
            " a new odometry from this frame."
        )
        if curr.stamp_ns == prev.stamp_ns:
            cure += " Stamps are nanoseconds, not seconds."
        raise InputError(where, what, cure)
    step_ns = curr.stamp_ns - prev.stamp_ns
    if step_ns < (MIN_STEP_NS if prev.stamp_ns < UNIX_NS else MIN_STEP_OF_UNIX_NS):
        what = f"its stamp, {curr.stamp_ns} ns, is {step_ns} ns after that of the frame before."
        unit = "milliseconds? Multiply them by 1,000,000"
        if step_ns >= MIN_MICROSECONDS:
            unit = "microseconds? Multiply them by 1,000"
        raise InputError(where, what, f"Stamps are nanoseconds. Are these {unit}.")
    if curr.index <= prev.index:
        what = f"its index, {curr.index}, is not after that of the frame before, {prev.index}."
        raise InputError(where, what, "Count the frames: a window tells them by their index.")
    if (curr.features is None) != (prev.features is None):
        what = "one of it and the frame before has images, the other features."
        raise InputError(where, what, "Keep to one kind.")
    for prev_image, curr_image in ((prev.left, curr.left), (prev.right, curr.right)):
        if prev_image is None or curr_image is None:
            continue
        if prev_image.shape != curr_image.shape:
            now = size_text(curr_image)
            what = f"its images are {now} px, not {size_text(prev_image)} px as before."
            raise InputError(where, what, "Keep to one size.")
    check_memory(prev, curr)


def check_memory(kept: Frame, curr: Frame) -> None:
    """Check that a frame has its images in other memory than an earlier one that is still needed.

    Raises:
        InputError: an image shares memory with the earlier frame's.
    """
    if share_memory(kept, curr):
        what = (
            f"an image of it is in the same memory as that of frame {kept.index}, which is still"
            " needed."
        )
        cure = "Hand in a new array each time, such as image.copy()."
        raise InputError(f"frame {curr.index}", what, cure)


def share_memory(kept: Frame, curr: Frame) -> bool:
    """Return whether an image of a frame is in the memory of an earlier one's, as of a driver with
    few buffers."""
    for kept_image, image in ((kept.left, curr.left), (kept.right, curr.right)):
        if kept_image is None or image is None:
            continue
        if kept_image.ctypes.data == image.ctypes.data:
            return True
    return False
