"""Whether a feature is found again on the way back."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image

FLOOR_PX = 1e-2
"""Distances below this say nothing: Lucas–Kanade is no more precise."""
WINDOW_PX = 11
"""Side of the window, as that of tracking is by default."""
MAX_ITERATIONS = 10
MAX_STEP_PX = 1e-3
MIN_EIGENVALUE = 1e-4
"""Smallest eigenvalue of the window's gradient matrix, as in tracking."""


def forward_backward(
    previous_left: Image, left: Image, previous_uv: FloatArray, uv: FloatArray
) -> FloatArray:
    """ln(0.01 + distance/px) between where a feature was and where Lucas–Kanade finds the current
    one there.

    The search starts at ``previous_uv`` on the images as they are, at full resolution (after Kalal
    et al. 2010, "Forward-backward error").

    Args:
        previous_left: left image before, [height, width].
        left: current left image, of the same size.
        previous_uv: features in the left image before, [N, 2], px.
        uv: the same in the current left image, [N, 2], px.

    Returns:
        [N], ln px; NaN where the search fails: outside the images, or without texture.
    """
    if not len(uv):
        return np.zeros(0)
    found_uv, status, _ = cv2.calcOpticalFlowPyrLK(
        left,
        previous_left,
        uv.astype(np.float32),
        previous_uv.astype(np.float32),
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=0,
        criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, MAX_ITERATIONS, MAX_STEP_PX),
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        minEigThreshold=MIN_EIGENVALUE,
    )
    distance = np.hypot(*(found_uv.astype(np.float64) - previous_uv).T)
    return np.where(status[:, 0] > 0, np.log(FLOOR_PX + distance), np.nan)
