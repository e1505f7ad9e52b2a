"""Features of a tracks file → tracks: points are the same where their identities are."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking.tracks import Tracks


class FeatureMatcher:
    """Joins the features of consecutive frames by identity; the counterpart of ``ImageTracker``
    without images."""

    def __init__(self) -> None:
        nothing = StereoFeatures(np.zeros(0, np.int64), np.zeros((0, 4)))
        self._before = self._now = (nothing, np.zeros(0, np.int64))
        self._now_stamp_ns: int | None = None

    def track(self, frame: Frame, expected: FloatArray) -> Tracks:
        """The features that the previous frame had too; ``expected`` is not needed here.

        Called again for a frame, it starts over.
        """
        if frame.features is None:
            raise ValueError(f"frame {frame.index} has no features")
        if frame.stamp_ns != self._now_stamp_ns:
            self._before = self._now
            self._now_stamp_ns = frame.stamp_ns
        previous, previous_age = self._before
        seen = np.isfinite(frame.features.pixels).all(axis=1)
        current = StereoFeatures(frame.features.ids[seen], frame.features.pixels[seen])
        ids, before, now = np.intersect1d(
            previous.ids, current.ids, assume_unique=True, return_indices=True
        )
        age = np.ones(len(current.ids), np.int64)
        age[now] = previous_age[before] + 1
        rejected = {"not finite": int((~seen).sum())}
        tracks = Tracks(
            previous.pixels[before], current.pixels[now], ids, age=age[now], rejected=rejected
        )
        self._now = (current, age)
        return tracks

    def drop(self, ids: IntArray) -> None:
        """Nothing: the file decides which features there are."""
