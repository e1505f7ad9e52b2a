"""How differently a feature looks from one image to the next."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.tracking.tracks import Tracks


def window_difference(tracks: Tracks) -> FloatArray:
    """ln(1 + difference/grey level) that Lucas–Kanade leaves between the windows. Ours.

    Args:
        tracks: N features.

    Returns:
        From the previous frame to this one, and from left to right, [N, 2], ln(1 + grey levels); NaN where somebody
        else has tracked the features.
    """
    if tracks.difference is None:
        return np.full((len(tracks), 2), np.nan)
    return np.log1p(tracks.difference)
