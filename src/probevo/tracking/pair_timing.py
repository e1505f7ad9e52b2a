"""Detection of left and right images that are paired wrongly, by a shift of one or two frames.

A point lies in the same row of both images of a rectified pair. While the camera moves, its row in
the right image of another frame differs, by an amount that depends on its depth. The right image
whose rows agree best with the rows of a left image is therefore the one taken at the same time.

Motion along the baseline moves no rows, nor does a motion too slow to see: then all agree, and only
by noise one of them does best.
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.config import TrackingConfig
from probevo.sequences.frame import Frame
from probevo.sequences.prepared_images import PreparedImages, Pyramid
from probevo.tracking.lucas_kanade import track_points
from probevo.tracking.preparation import prepare_images

OFFSETS = (-2, -1, 0, 1, 2)
"""Frames from a left image to the right images that it is compared with."""
EVERY_FRAMES = 2
"""Frames between two comparisons."""
MAX_COMPARISONS = 40
"""Comparisons after which the check gives up, as with a camera at rest."""
MIN_VOTES = 5
"""Comparisons with a clear result that a decision needs."""
ENOUGH_VOTES = 8
"""Comparisons with a clear result after which no more are made."""
UNANIMOUS = 0.8
"""Share of these that have to agree."""
CLEAR_RATIO = 1.5
"""Factor by which the rows of the best right image agree better than the rows of any other; it is
less for a camera at rest."""
MIN_DIFFERENCE_PX = 0.1
"""Difference of scatters, px, up to which it may be the noise of matching: matches are as good as
that where left and right look the same, and may be several times as bad where they do not."""
MIN_DISPARITY_PX = 1.0
"""Median disparity of the best right image, px, below which it shows what the left one does: a
camera that moves along its baseline, by its length from frame to frame, takes such images."""
MIN_MATCHES = 20
MAX_FORWARD_BACKWARD_PX = 0.5
"""Largest distance between a point and where tracking to the right image and back ends."""
FIT_ITERATIONS = 15


class PairTiming:
    """Compares left images with the right ones of the frames around them, as frames come."""

    def __init__(self, config: TrackingConfig) -> None:
        self._config = config
        self._last: deque[PreparedImages] = deque(maxlen=len(OFFSETS))
        self._num_frames = 0
        self._num_comparisons = 0
        self._votes: list[int] = []

    @property
    def is_decided(self) -> bool:
        """Whether further frames change nothing."""
        has_enough = len(self._votes) >= ENOUGH_VOTES
        return has_enough or self._num_comparisons >= MAX_COMPARISONS

    @property
    def right_late_frames(self) -> int:
        """Frames by which the right images are late, up to 2; negative if the left ones are, and 0
        also where nothing is known."""
        if len(self._votes) < MIN_VOTES:
            return 0
        for offset in OFFSETS:
            if self._votes.count(offset) >= UNANIMOUS * len(self._votes):
                return offset
        return 0

    def add(self, frame: Frame) -> None:
        """Take the next frame; one without images is left out."""
        if self.is_decided or frame.left is None or frame.right is None:
            return
        self._last.append(prepare_images(frame, self._config))
        self._num_frames += 1
        if len(self._last) < len(OFFSETS) or self._num_frames % EVERY_FRAMES:
            return
        self._num_comparisons += 1
        # The left image of the middle frame against the right ones of all frames around it, in the
        # order of OFFSETS: an offset of +1 is best if the right image came one frame late.
        left = self._last[len(OFFSETS) // 2]
        best = _clearly_best([match_rows(left, each.right, self._config) for each in self._last])
        if best is not None:
            self._votes.append(best)
        if self.is_decided:
            self._last.clear()  # these images are not needed any more


class RowMatch(NamedTuple):
    """How well the rows of a left and a right image agree."""

    scatter_px: float
    """Median absolute residual of v_r − v_l from an affine map, px; ∞ where hardly a corner is
    matched."""
    disparity_px: float
    """Median absolute disparity, px; 0 where hardly a corner is matched."""


def match_rows(images: PreparedImages, right: Pyramid, config: TrackingConfig) -> RowMatch:
    """Measure how far rows of a left and a right image are apart, but for an affine map.

    Args:
        images: with the left image and its corners.
        right: pyramid of a right image.
        config: settings of the search.
    """
    left_px = images.corners.reshape(-1, 2)
    left_px = left_px[np.isfinite(left_px[:, 0])]
    # Keep points that track there and back to the same place: a wrong match seldom does.
    matches = track_points(images.left, right, left_px, start_px=left_px, config=config)
    back = track_points(right, images.left, matches.pixels, start_px=matches.pixels, config=config)
    forward_backward_px = np.abs(back.pixels - left_px).max(axis=1, initial=0.0)
    is_match = np.isfinite(matches.difference) & np.isfinite(back.difference)
    is_match &= forward_backward_px < MAX_FORWARD_BACKWARD_PX
    if is_match.sum() < MIN_MATCHES:
        return RowMatch(np.inf, disparity_px=0.0)
    differences_px = (matches.pixels - left_px)[is_match]
    return RowMatch(
        scatter_px=_scatter(left_px[is_match], differences_px[:, 1]),
        disparity_px=float(np.median(np.abs(differences_px[:, 0]))),
    )


def _clearly_best(matches: list[RowMatch]) -> int | None:
    """Return the offset of the right image whose rows agree best; None if another is as good, or if
    it may be by chance."""
    scatters_px = [match.scatter_px for match in matches]
    best = int(np.argmin(scatters_px))
    next_px = min(scatter_px for k, scatter_px in enumerate(scatters_px) if k != best)
    if not next_px > CLEAR_RATIO * scatters_px[best]:
        return None
    if next_px - scatters_px[best] < MIN_DIFFERENCE_PX:
        return None
    if matches[best].disparity_px < MIN_DISPARITY_PX:
        return None
    return OFFSETS[best]


def _scatter(left_px: FloatArray, rows_px: FloatArray) -> float:
    """Fit an affine map to row differences, [N], of points [N, 2], robustly (Cauchy's loss)."""
    # An affine map, since the rectification may be rolled or scaled; robust (IRLS), since some
    # matches are wrong.
    spread_px = np.maximum(left_px.std(axis=0), 1.0)
    places = (left_px - left_px.mean(axis=0)) / spread_px
    design = np.column_stack([np.ones(len(places)), places])
    weights = np.ones(len(places))
    residual_px = rows_px
    for _ in range(FIT_ITERATIONS):
        # Weighted least squares: rows and right-hand side times the root of their weights.
        root = np.sqrt(weights)
        solution = np.linalg.lstsq(design * root[:, None], rows_px * root, rcond=None)[0]
        residual_px = rows_px - design @ solution
        # Cauchy's weight 1/(1 + (r/c)²), with c three times the median of |r|.
        scale_px = max(float(np.median(np.abs(residual_px))), 1e-3)
        weights = 1.0 / (1.0 + (residual_px / (3.0 * scale_px)) ** 2)
    return float(np.median(np.abs(residual_px)))
