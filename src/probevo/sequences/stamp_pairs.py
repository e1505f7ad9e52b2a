"""Pairs of left and right images by their stamps, where the two cameras are recorded apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import IntArray


@dataclass(frozen=True)
class StampPairs:
    """Which left and right images form the frames of a recording."""

    left: IntArray
    """Index of each frame's left image, [K], in the order of time."""
    right: IntArray
    """Index of each frame's right image, [K]."""
    offsets_ns: IntArray
    """Stamp of the right image minus that of the left one, [K]."""

    def __len__(self) -> int:
        """Return the number of frames, K."""
        return len(self.left)


def pair_stamps(left_ns: IntArray, right_ns: IntArray, tolerance_ns: int) -> StampPairs:
    """Pair the images that are each other's nearest, and no further apart than a tolerance.

    Args:
        left_ns: stamps of the left images, [L], in any order; of equal ones, the first counts.
        right_ns: stamps of the right images, [R].
        tolerance_ns: largest time between the images of a pair.
    """
    left_sorted, left_order = np.unique(left_ns, return_index=True)
    right_sorted, right_order = np.unique(right_ns, return_index=True)
    if len(left_sorted) == 0 or len(right_sorted) == 0:
        none = np.zeros(0, dtype=np.int64)
        return StampPairs(left=none, right=none, offsets_ns=none)
    nearest_right = _nearest(left_sorted, right_sorted)
    nearest_left = _nearest(right_sorted, left_sorted)
    offsets_ns = right_sorted[nearest_right] - left_sorted
    is_mutual = nearest_left[nearest_right] == np.arange(len(left_sorted))
    is_pair = is_mutual & (np.abs(offsets_ns) <= tolerance_ns)
    return StampPairs(
        left=left_order[is_pair],
        right=right_order[nearest_right[is_pair]],
        offsets_ns=offsets_ns[is_pair],
    )


def _nearest(stamps_ns: IntArray, others_ns: IntArray) -> IntArray:
    """Return the index of the nearest other stamp for each stamp; both are ascending."""
    after = np.searchsorted(others_ns, stamps_ns).clip(0, len(others_ns) - 1)
    before = (after - 1).clip(0)
    is_before_nearer = np.abs(others_ns[before] - stamps_ns) <= np.abs(others_ns[after] - stamps_ns)
    return np.where(is_before_nearer, before, after)
