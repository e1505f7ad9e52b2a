"""The difference between a feature's current look and its anchor patch."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.predictors.base import Needs, Predictor
from probevo.tracking.tracks import Tracks


def window_difference(tracks: Tracks) -> FloatArray:
    """Compute ln(1 + difference/grey level) of the aligned windows, in time and in stereo. Ours.

    The difference is the mean absolute difference of the image and the anchor patch, which is the
    window in which the feature was first seen, after their alignment.

    Args:
        tracks: N features.

    Returns:
        Differences in the left image (time) and in the right image (stereo), [N, 2], ln(1 + grey
        levels). NaN where another front end gives the features; the predictor is refused there.
    """
    if tracks.difference is None:
        return np.full((len(tracks), 2), np.nan)
    return np.log1p(tracks.difference)


WINDOW_DIFFERENCE = Predictor(
    name="window_difference",
    columns={
        "difference_in_time": "ln(1 + grey levels)",
        "difference_in_stereo": "ln(1 + grey levels)",
    },
    source="ours",
    needs=Needs.LEFT | Needs.ALIGNMENT,
    compute=lambda step: window_difference(step.tracks),
)
