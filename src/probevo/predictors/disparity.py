"""The disparity of a feature: how near it is."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.predictors.base import Needs, Predictor

FLOOR_PX = 0.25
"""Smaller disparities, and negative ones, count as this."""


def disparity(curr_px: FloatArray) -> FloatArray:
    """Compute ln(d/px) of the current disparity d = u_l − u_r, at least ``FLOOR_PX``. Ours.

    Args:
        curr_px: features in the current frame, [N, 4], px.

    Returns:
        [N], ln px; always defined.
    """
    return np.log(np.maximum(curr_px[:, 0] - curr_px[:, 2], FLOOR_PX))


DISPARITY = Predictor(
    name="disparity",
    columns={"disparity": "ln px"},
    source="ours",
    needs=Needs.TRACKS,
    compute=lambda step: disparity(step.tracks.curr_px),
)
