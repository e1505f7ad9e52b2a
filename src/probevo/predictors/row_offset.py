"""The row offset of a stereo match."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.predictors.base import Needs, Predictor


def row_offset(curr_px: FloatArray) -> FloatArray:
    """Compute |v_r − v_l| of the current observation. Ours.

    It is 0 for a perfect match in perfectly rectified images.

    Args:
        curr_px: features in the current frame, [N, 4], px.

    Returns:
        [N], px; always defined.
    """
    return np.abs(curr_px[:, 3] - curr_px[:, 1])


ROW_OFFSET = Predictor(
    name="row_offset",
    columns={"row_offset": "px"},
    source="ours",
    needs=Needs.TRACKS,
    compute=lambda step: row_offset(step.tracks.curr_px),
)
