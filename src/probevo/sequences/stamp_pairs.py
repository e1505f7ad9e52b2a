"""Pairs of left and right images by their stamps, where the two cameras are recorded apart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import IntArray
from probevo.errors import InputError


@dataclass(frozen=True)
class StampPairs:
    """Which left and right images form the frames of a recording."""

    left: IntArray
    """Index of each frame's left image, [K], in the order of time."""
    right: IntArray
    """Index of each frame's right image, [K]."""
    offsets_ns: IntArray
    """Stamp of the right image minus the left one's, [K]."""

    def __len__(self) -> int:
        """Return the number of frames, K."""
        return len(self.left)


def paired_images(
    left_ns: IntArray, right_ns: IntArray, tolerance_ms: float, *, where: Path, by: str
) -> tuple[StampPairs, tuple[str, str]]:
    """Pair the image files of two cameras, and say how many have no partner.

    Args:
        left_ns: stamps of the left images, [L].
        right_ns: stamps of the right images, [R].
        tolerance_ms: largest time between the images of a pair, ms.
        where: file or folder with the stamps, for messages.
        by: where the stamps are, such as "the file names".

    Returns:
        The pairs, and name and text of a note on them.

    Raises:
        InputError: less than half of the images have a partner.
    """
    pairs = pair_stamps(left_ns, right_ns, round(1e6 * tolerance_ms))
    num_left = len(left_ns) - len(pairs)
    num_right = len(right_ns) - len(pairs)
    if len(pairs) < max(num_left, num_right):
        what = (
            f"only {len(pairs)} of {len(left_ns)} left and {len(right_ns)} right images have a"
            f" partner within {tolerance_ms:g} ms by the stamps in {by}."
        )
        cure = (
            "Are the cameras triggered together? --pair-tolerance-ms allows for more between them."
        )
        raise InputError(where, what, cure)
    text = (
        f"{len(pairs)}, by the stamps in {by}, at most"
        f" {1e-6 * float(np.abs(pairs.offsets_ns).max()):.3f} ms apart; without a partner:"
        f" {num_left} left, {num_right} right"
    )
    return pairs, ("pairs" if num_left + num_right == 0 else "! pairs", text)


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
