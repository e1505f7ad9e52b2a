"""Where the window around a point is found again, from afar: OpenCV's Lucas–Kanade, on pyramids of
our own."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import BoolArray, FloatArray, Image
from probevo.config import TrackingConfig
from probevo.sequences.prepared_images import Pyramid as Pyramid

MIN_EIGENVALUE = 1e-4
"""Smallest eigenvalue of the window's gradient matrix (over its area, in OpenCV's scaling) that can
be tracked."""
MAX_ITERATIONS = 10
MAX_STEP_PX = 0.1
"""Lucas–Kanade stops here on each pyramid level."""
LEVELS_IF_NEAR = 2
"""Levels for a point that is within a pixel or two of its start."""


def pyramid_of(image: Image, config: TrackingConfig) -> Pyramid:
    """The image and the levels above it, as many as are asked for and hold a window."""
    levels = [image]
    while len(levels) <= config.pyramid_levels and min(levels[-1].shape) > 2 * config.window_px:
        levels.append(np.asarray(cv2.pyrDown(levels[-1]), dtype=np.uint8))
    return tuple(levels)


def find_again(
    template: Pyramid,
    image: Pyramid,
    template_px: FloatArray,
    start_px: FloatArray,
    config: TrackingConfig,
    near: BoolArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Pyramidal Lucas–Kanade of points [N, 2] from the given starts: where they end, [N, 2], px,
    and what is left.

    That is the mean absolute difference of the window there, [N], grey levels; infinite where the
    search failed. Which starts are about right may be said, [N]: for these the lowest levels do.

    OpenCV's own pyramids can't be handed to it from Python, so that each call would build both
    anew. Level by level it needs none, and ends at the same place to the last bit.
    """
    if len(template_px) == 0:
        return np.zeros((0, 2)), np.zeros(0)
    at_px = template_px.astype(np.float32)
    found_px = start_px.astype(np.float32)
    everyone = np.arange(len(at_px))
    far = everyone if near is None else np.flatnonzero(~near)
    size = (config.window_px, config.window_px)
    enough = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS
    for level in reversed(range(len(template))):
        here = everyone if level < LEVELS_IF_NEAR else far
        scale = np.float32(0.5**level)
        if not len(here):
            continue
        scaled_px, status, difference = cv2.calcOpticalFlowPyrLK(
            template[level],
            image[level],
            at_px[here] * scale,
            found_px[here] * scale,
            winSize=size,
            maxLevel=0,
            criteria=(enough, MAX_ITERATIONS, MAX_STEP_PX),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW | (cv2.OPTFLOW_LK_GET_MIN_EIGENVALS if level else 0),
            minEigThreshold=MIN_EIGENVALUE,
        )
        found_px[here] = scaled_px / scale  # a point without texture on this level stays put
    found = (status[:, 0] > 0) & np.isfinite(found_px).all(axis=1)
    return np.where(found[:, None], found_px, -1.0).astype(np.float64), np.where(
        found, difference[:, 0], np.inf
    )
