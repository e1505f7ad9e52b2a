"""Pyramidal Lucas–Kanade tracking of points: OpenCV's, on pyramids of our own (Bouguet 2001)."""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.config import TrackingConfig
from probevo.sequences.prepared_images import Pyramid

MIN_EIGENVALUE = 1e-4
"""Smallest eigenvalue of the window's gradient matrix that can be tracked.

The matrix is divided by the window's area, in OpenCV's scaling."""
MAX_ITERATIONS = 10
"""On a pyramid level, at most."""
MAX_STEP_PX = 0.1
"""Lucas–Kanade has converged on a pyramid level when its step is shorter."""
LEVELS_IF_NEAR = 2
"""Pyramid levels for a point that starts within a pixel or two of its place."""


class TrackedPoints(NamedTuple):
    """Where N points are found in an image."""

    pixels: FloatArray
    """(u, v), [N, 2], px; −1 where the search failed."""
    difference: FloatArray
    """Mean absolute difference of the windows, [N], grey levels; ∞ where the search failed."""


def build_pyramid(image: Image, config: TrackingConfig) -> Pyramid:
    """Build the image pyramid, with as many levels as are asked for and hold a window."""
    levels = [image]
    # A window that fills its level has no place to move to.
    while len(levels) <= config.pyramid_levels and min(levels[-1].shape) > 2 * config.window_px:
        levels.append(np.asarray(cv2.pyrDown(levels[-1]), dtype=np.uint8))
    return tuple(levels)


def track_points(
    template: Pyramid,
    image: Pyramid,
    template_px: FloatArray,
    *,
    start_px: FloatArray,
    config: TrackingConfig,
    are_near: bool = False,
) -> TrackedPoints:
    """Track points from one image to another by pyramidal Lucas–Kanade.

    OpenCV's own pyramids cannot be handed to it from Python, so that each call would build both
    again. Called level by level it needs none, and the result is the same to the last bit.

    Args:
        template: pyramid of the image in which the points are known.
        image: pyramid of the image in which they are searched.
        template_px: points (u, v) in the first, [N, 2], px.
        start_px: where the search starts in the second, [N, 2], px.
        config: number of levels and size of the window.
        are_near: whether the starts are within a pixel or two of the result, so that the lowest
            levels are enough.
    """
    if len(template_px) == 0:
        return TrackedPoints(np.zeros((0, 2)), np.zeros(0))
    # OpenCV computes in single precision.
    points_px = template_px.astype(np.float32)
    found_px = start_px.astype(np.float32)
    num_levels = min(LEVELS_IF_NEAR, len(template)) if are_near else len(template)
    size = (config.window_px, config.window_px)
    criteria = cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS
    # From coarse to fine: each level starts where the coarser one has ended.
    for level in reversed(range(num_levels)):
        # pyrDown keeps pixel (0, 0) in place, so that coordinates only scale.
        scale = np.float32(0.5**level)
        # Only the finest level's difference is used. On the others, ask for the eigenvalues in its
        # place, which are computed anyway.
        without_difference = cv2.OPTFLOW_LK_GET_MIN_EIGENVALS if level else 0
        scaled_px, status, difference = cv2.calcOpticalFlowPyrLK(
            template[level],
            image[level],
            points_px * scale,
            found_px * scale,
            winSize=size,
            maxLevel=0,
            criteria=(criteria, MAX_ITERATIONS, MAX_STEP_PX),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW | without_difference,
            minEigThreshold=MIN_EIGENVALUE,
        )
        # A point without texture on this level stays at its start
        found_px = scaled_px / scale
    # Level 0 comes last: its status and difference belong to the result.
    is_found = (status[:, 0] > 0) & np.isfinite(found_px).all(axis=1)
    return TrackedPoints(
        pixels=np.where(is_found[:, None], found_px, -1.0).astype(np.float64),
        difference=np.where(is_found, difference[:, 0], np.inf),
    )
