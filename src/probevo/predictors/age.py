"""How long a feature has been followed."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray


def age(frames: IntArray) -> FloatArray:
    """ln of the number of frames in a row that have seen the feature. Ours.

    Args:
        frames: that number, the current frame included, [N]; at least 1.

    Returns:
        [N], ln frames.
    """
    return np.log(frames.astype(np.float64))
