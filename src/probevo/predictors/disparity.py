"""How near a feature is."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray

FLOOR_PX = 0.25
"""A smaller disparity, or a negative one, is as good as this."""


def disparity(curr_px: FloatArray) -> FloatArray:
    """ln(d/px) of the current disparity d = u_l − u_r, at least ``FLOOR_PX``. Ours.

    Args:
        curr_px: features in the current frame, [N, 4], px.

    Returns:
        [N], ln px.
    """
    return np.log(np.maximum(curr_px[:, 0] - curr_px[:, 2], FLOOR_PX))
