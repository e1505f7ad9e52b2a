"""The time for which a feature has been tracked."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.predictors.base import Needs, Predictor


def age(frames: IntArray) -> FloatArray:
    """Compute the logarithm of the number of consecutive frames that have seen each feature. Ours.

    Args:
        frames: that number, the current frame included, [N]; at least 1.

    Returns:
        [N], ln frames; always defined.
    """
    return np.log(frames.astype(np.float64))


AGE = Predictor(
    name="age",
    columns={"age": "ln frames"},
    source="ours",
    needs=Needs.TRACKS,
    compute=lambda step: age(step.tracks.age),
)
