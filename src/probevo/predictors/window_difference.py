"""How differently a feature looks from when it was first seen."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.tracking.tracks import Tracks


def window_difference(tracks: Tracks) -> FloatArray:
    """ln(1 + difference/grey level) that is left between the windows when they are fitted. Ours.

    Args:
        tracks: N features.

    Returns:
        In the left and in the right image, [N, 2], ln(1 + grey levels); NaN where somebody else has
        tracked the features, for whom the predictor is refused.
    """
    if tracks.difference is None:
        return np.full((len(tracks), 2), np.nan)
    return np.log1p(tracks.difference)
