"""What tracking does with a frame's images before it knows of any motion, so that it can be done
ahead of time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from itertools import count

import cv2
import numpy as np

from probevo.arrays import Image
from probevo.config import TrackingConfig
from probevo.sequences.frame import Frame
from probevo.sequences.prepared_images import PreparedImages as PreparedImages
from probevo.sequences.read_ahead import read_ahead
from probevo.tracking.detection import strongest_corners
from probevo.tracking.lucas_kanade import pyramid_of


def prepared_ahead(frames: Iterable[Frame], config: TrackingConfig) -> Iterator[Frame]:
    """The same frames, prepared in a thread of their own while the consumer works on the one
    before.

    What reading a frame raises comes where the frame would have.
    """
    source = iter(frames)

    def following(_: int) -> Frame | None:
        frame = next(source, None)
        return None if frame is None else with_prepared(frame, config)

    with closing(read_ahead(following, count(), ahead=1, threads=1)) as ahead:
        for frame in ahead:
            if frame is None:
                return
            yield frame


def with_prepared(frame: Frame, config: TrackingConfig) -> Frame:
    """The frame with its prepared images, if it has any."""
    return (
        frame
        if frame.left is None or frame.right is None
        else replace(frame, prepared=prepared(frame, config))
    )


def prepared(frame: Frame, config: TrackingConfig) -> PreparedImages:
    """Those that the frame brings along, or else prepared now."""
    if frame.left is None or frame.right is None:
        raise ValueError(f"frame {frame.index} has no images")
    if frame.prepared is not None and frame.prepared.config == config:
        return frame.prepared
    left, right = (
        pyramid_of(_high_pass(image, config), config) for image in (frame.left, frame.right)
    )
    return PreparedImages(left, right, strongest_corners(left[0], config), config=config)


def _high_pass(image: Image, config: TrackingConfig) -> Image:
    """The image less its local mean, around 128: exposure and vignetting drop out of the brightness
    constancy."""
    if config.high_pass_px == 0:
        return image
    mean = cv2.blur(image, (config.high_pass_px, config.high_pass_px))
    return np.asarray(cv2.addWeighted(image, 1.0, mean, -1.0, 128.0), dtype=np.uint8)
