"""Features of a tracks file → tracks: points are the same where their identities are."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.sequences.frame import Frame, StereoFeatures
from probevo.tracking.tracks import Tracks


class FeatureMatcher:
    """Joins the features of consecutive frames by identity; the counterpart of ``ImageTracker`` without images."""

    def __init__(self) -> None:
        self._previous = StereoFeatures(np.zeros(0, np.int64), np.zeros((0, 4)))
        self._age = np.zeros(0, np.int64)

    def track(self, frame: Frame, expected: FloatArray) -> Tracks:
        """The features that the previous frame had too; ``expected`` is not needed here."""
        if frame.features is None:
            raise ValueError(f"frame {frame.index} has no features")
        ids, before, now = np.intersect1d(
            self._previous.ids, frame.features.ids, assume_unique=True, return_indices=True
        )
        age = np.ones(len(frame.features.ids), np.int64)
        age[now] = self._age[before] + 1
        tracks = Tracks(self._previous.pixels[before], frame.features.pixels[now], ids, age[now])
        self._previous, self._age = frame.features, age
        return tracks

    def drop(self, ids: IntArray) -> None:
        """Nothing: the file decides which features there are."""
