"""Forward-backward error of a track (after Kalal et al. 2010)."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.predictors.base import Needs, Predictor

FLOOR_PX = 1e-2
"""Added to the distance: Lucas–Kanade is no more precise than this."""
WINDOW_PX = 11
"""Side of the Lucas–Kanade window, the default of tracking."""
MAX_ITERATIONS = 10
MAX_STEP_PX = 1e-3
"""Lucas–Kanade has converged when its step is shorter."""
MIN_EIGENVALUE = 1e-4
"""Smallest eigenvalue of the window's gradient matrix, as in tracking."""


def forward_backward(
    previous_left: Image, left: Image, previous_uv: FloatArray, uv: FloatArray
) -> FloatArray:
    """Compute ln(0.01 + distance/px) between a feature and its track back to the previous frame.

    Lucas–Kanade tracks the window around the feature in the current image back to the previous one.
    It starts at ``previous_uv``, on the images as they are, at full resolution (after Kalal,
    Mikolajczyk, Matas, "Forward-backward error", ICPR 2010).

    Args:
        previous_left: left image of the previous frame, [height, width], uint8.
        left: current left image, of the same size.
        previous_uv: features in the left image of the previous frame, [N, 2], px.
        uv: features in the current left image, [N, 2], px.

    Returns:
        [N], ln(0.01 + px); NaN where the search fails: outside the images, or without texture.
    """
    if not len(uv):
        return np.zeros(0)
    # One level is enough: a good track leads back to where it starts.
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
    # How far the track back ends from where the feature was
    offset = found_uv.astype(np.float64) - previous_uv
    distance = np.hypot(offset[:, 0], offset[:, 1])
    return np.where(status[:, 0] > 0, np.log(FLOOR_PX + distance), np.nan)


FORWARD_BACKWARD = Predictor(
    name="forward_backward",
    columns={"forward_backward": "ln(0.01 + px)"},
    source="ours",
    needs=Needs.LEFT | Needs.PREVIOUS_LEFT,
    compute=lambda step: forward_backward(
        step.previous_left, step.left, step.previous_uv, uv=step.uv
    ),
    undefined="where the search fails",
)
