"""The part of tracking that needs no prediction: high-pass filter, pyramids, splines and corners.

It can be done in another thread while the previous frame is still being processed.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from itertools import count

import cv2
import numpy as np

from probevo.arrays import BoolArray, Image
from probevo.config import TrackingConfig
from probevo.sequences.frame import WHITE, Frame
from probevo.sequences.prepared_images import NONE_SATURATED, PreparedImages
from probevo.sequences.read_ahead import read_ahead
from probevo.tracking.contrast import MIN_GAIN_IN_STEREO, contrast_ratio, with_contrast_of
from probevo.tracking.detection import strongest_corners
from probevo.tracking.lucas_kanade import build_pyramid
from probevo.tracking.spline import spline_through

SATURATED = 255
"""Grey level of a pixel whose scene may be brighter than it shows."""


def prepare_ahead(frames: Iterable[Frame], config: TrackingConfig) -> Iterator[Frame]:
    """Yield the same frames with prepared images.

    A thread of its own prepares the next frame while the consumer works on the previous one. An
    exception of reading a frame is raised at the position of that frame.
    """
    source = iter(frames)

    def prepare_next(_: int) -> Frame | None:
        """Read and prepare the next frame; None after the last."""
        frame = next(source, None)
        return None if frame is None else with_prepared_images(frame, config)

    # One ahead in one thread: the order of the frames is kept, and a live source is not read
    # farther than it can be used.
    with closing(read_ahead(prepare_next, count(), ahead=1, threads=1)) as ahead:
        for frame in ahead:
            if frame is None:
                return
            yield frame


def with_prepared_images(frame: Frame, config: TrackingConfig) -> Frame:
    """Return the frame with its prepared images; a frame without images as it is."""
    if frame.left is None or frame.right is None:
        return frame
    return replace(frame, prepared=prepare_images(frame, config))


def prepare_images(frame: Frame, config: TrackingConfig) -> PreparedImages:
    """Prepare the images of a frame, unless it comes with images prepared like these.

    Raises:
        ValueError: the frame has no images.
    """
    if frame.left is None or frame.right is None:
        raise ValueError(f"frame {frame.index} has no images")
    if frame.prepared is not None and _prepare_alike(frame.prepared.config, config):
        return frame.prepared
    # Corners are looked for where they are tracked: in the filtered image.
    left = build_pyramid(high_pass(frame.left, config), config)
    right = build_pyramid(high_pass(frame.right, config), config)
    # Cameras with an exposure of their own: all that follows may compare grey levels.
    right = with_contrast_of(right, left, least_gain=MIN_GAIN_IN_STEREO)
    left_usable = usable_places(frame.left_mask, config)
    return PreparedImages(
        left=left,
        right=right,
        left_spline=spline_through(left[0], saturated_pixels(frame.left)),
        right_spline=spline_through(right[0], saturated_pixels(frame.right)),
        corners=strongest_corners(left[0], config, left_usable),
        left_usable=left_usable,
        right_usable=usable_places(frame.right_mask, config),
        config=config,
    )


def right_contrast(left: Image, right: Image, config: TrackingConfig) -> float:
    """Return the contrast of a right image over the left one's; NaN if the left one has none.

    Cameras that are exposed alike have about 1 (``MIN_GAIN_IN_STEREO``).
    """
    return contrast_ratio(
        build_pyramid(high_pass(left, config), config),
        build_pyramid(high_pass(right, config), config),
    )


def _prepare_alike(one: TrackingConfig, other: TrackingConfig) -> bool:
    """Tell whether images prepared with either settings are the same.

    The gate of the tracks, which depends on the estimator, has no part in the preparation.
    """
    return one == other or one.model_copy(update={"max_difference": other.max_difference}) == other


def usable_places(mask: Image | BoolArray | None, config: TrackingConfig) -> BoolArray | None:
    """Return where the window of a feature lies within a mask, [height, width]; None without one.

    Args:
        mask: where features are wanted: True, or grey levels from ``WHITE`` on.
        config: with the size of the window.
    """
    if mask is None:
        return None
    is_wanted = mask if mask.dtype == np.bool_ else mask >= WHITE
    window = np.ones((config.window_px, config.window_px), np.uint8)
    # What lies beyond the border of the image does not count.
    usable: BoolArray = cv2.erode(is_wanted.astype(np.uint8), window) > 0
    return usable


def saturated_pixels(image: Image) -> Image:
    """Return 1 where a pixel is saturated, else 0, [height, width], uint8; empty if none is."""
    # A view of an image, such as a rotated one, may have another memory layout.
    saturated = np.ascontiguousarray(image == SATURATED)
    return saturated.view(np.uint8) if saturated.any() else NONE_SATURATED


def high_pass(image: Image, config: TrackingConfig) -> Image:
    """Subtract the local mean from an image, and add 128.

    This removes exposure and vignetting, which contradict the assumption of brightness constancy.
    """
    if config.high_pass_px == 0:
        return image
    mean = cv2.blur(image, (config.high_pass_px, config.high_pass_px))
    # 128 is the grey of no contrast, so that both signs fit into the bytes that FAST needs.
    return np.asarray(cv2.addWeighted(image, 1.0, mean, -1.0, 128.0), dtype=np.uint8)
