"""How far a stereo match is off its row."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray


def row_offset(curr_px: FloatArray) -> FloatArray:
    """|v_r − v_l| of the current observation, 0 for a perfect match in perfectly rectified images.
    Ours.

    Args:
        curr_px: features in the current frame, [N, 4], px.

    Returns:
        [N], px.
    """
    return np.abs(curr_px[:, 3] - curr_px[:, 1])
