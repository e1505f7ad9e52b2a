"""How far a feature moves in the image."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray


def flow(previous_px: FloatArray, curr_px: FloatArray) -> FloatArray:
    """ln(1 + length/px) of the optical flow in the left image. Ours.

    Args:
        previous_px: features in the previous frame, [N, 4], px.
        curr_px: the same in the current frame, [N, 4], px.

    Returns:
        [N], ln(1 + px).
    """
    return np.log1p(np.hypot(curr_px[:, 0] - previous_px[:, 0], curr_px[:, 1] - previous_px[:, 1]))
