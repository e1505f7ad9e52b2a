"""Single samples of a gyro that no rotation explains."""

from __future__ import annotations

import numpy as np

from probevo.arrays import BoolArray, FloatArray

MIN_SPIKE_RAD_S = 0.5
"""Smallest change of the rate within two samples that may be a spike."""
OVER_NEIGHBORS = 3.0
"""Smallest ratio of a spike to the difference of its neighbours."""
OVER_USUAL = 8.0
"""Smallest ratio of a spike to the typical differences in the interval, which vibrations make
large."""
MIN_SAMPLES = 5
"""Minimum number of samples that tell what is usual."""


def find_spikes(rates_rad_s: FloatArray) -> BoolArray:
    """Tell which samples of an interval are spikes, such as a lost bit makes.

    A sample is compared with the mean of its two neighbours, the first and the last one with the
    line through the two samples beside it.

    Args:
        rates_rad_s: finite angular rates, [J, 3].

    Returns:
        [J]; False everywhere for fewer than five samples.
    """
    if len(rates_rad_s) < MIN_SAMPLES:
        return np.zeros(len(rates_rad_s), np.bool_)
    inner = rates_rad_s[1:-1] - 0.5 * (rates_rad_s[:-2] + rates_rad_s[2:])
    ends = np.stack(
        [
            rates_rad_s[0] - 2.0 * rates_rad_s[1] + rates_rad_s[2],
            rates_rad_s[-1] - 2.0 * rates_rad_s[-2] + rates_rad_s[-3],
        ]
    )
    deviation = np.linalg.norm(np.concatenate([ends[:1], inner, ends[1:]]), axis=1)
    between_neighbors = np.concatenate(
        [
            [np.linalg.norm(rates_rad_s[2] - rates_rad_s[1])],
            np.linalg.norm(rates_rad_s[2:] - rates_rad_s[:-2], axis=1),
            [np.linalg.norm(rates_rad_s[-3] - rates_rad_s[-2])],
        ]
    )
    threshold = np.maximum(MIN_SPIKE_RAD_S, OVER_USUAL * np.median(deviation))
    is_spike: BoolArray = deviation > np.maximum(threshold, OVER_NEIGHBORS * between_neighbors)
    return is_spike
