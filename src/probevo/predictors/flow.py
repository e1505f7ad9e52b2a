"""The length of a feature's optical flow."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.predictors.base import Needs, Predictor


def flow(prev_px: FloatArray, curr_px: FloatArray) -> FloatArray:
    """Compute ln(1 + length/px) of the optical flow in the left image. Ours.

    Args:
        prev_px: features in the previous frame, [N, 4], px.
        curr_px: features in the current frame, [N, 4], px.

    Returns:
        [N], ln(1 + px); always defined.
    """
    return np.log1p(np.hypot(curr_px[:, 0] - prev_px[:, 0], curr_px[:, 1] - prev_px[:, 1]))


FLOW = Predictor(
    name="flow",
    columns={"flow": "ln(1 + px)"},
    source="ours",
    needs=Needs.TRACKS,
    compute=lambda step: flow(step.tracks.prev_px, step.tracks.curr_px),
)
