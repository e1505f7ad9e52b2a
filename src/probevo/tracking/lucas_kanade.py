"""Where the window around a point is found again, from afar: OpenCV's pyramidal Lucas–Kanade."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.config import TrackingConfig

MIN_EIGENVALUE = 1e-4
"""Smallest eigenvalue of the window's gradient matrix (over its area, in OpenCV's scaling) that can be tracked."""
MAX_ITERATIONS, MAX_STEP_PX = 10, 0.1
"""Lucas–Kanade stops here on each pyramid level."""


def find_again(
    template: Image, image: Image, template_px: FloatArray, start_px: FloatArray, config: TrackingConfig
) -> tuple[FloatArray, FloatArray]:
    """Pyramidal Lucas–Kanade of points [N, 2] from the given starts: where they end, [N, 2], px, and what is left.

    That is the mean absolute difference of the window there, [N], grey levels; infinite where the search failed.
    """
    if len(template_px) == 0:
        return np.zeros((0, 2)), np.zeros(0)
    found_px, status, difference = cv2.calcOpticalFlowPyrLK(
        template,
        image,
        template_px.astype(np.float32),
        start_px.astype(np.float32),
        winSize=(config.window_px, config.window_px),
        maxLevel=config.pyramid_levels,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, MAX_ITERATIONS, MAX_STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=MIN_EIGENVALUE,
    )
    found = (status[:, 0] > 0) & np.isfinite(found_px).all(axis=1)
    return np.where(found[:, None], found_px, -1.0).astype(np.float64), np.where(found, difference[:, 0], np.inf)
