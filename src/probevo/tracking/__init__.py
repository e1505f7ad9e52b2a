"""Images or features of consecutive frames → ``Tracks``."""

from __future__ import annotations

from typing import Protocol

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.config import TrackingConfig
from probevo.sequences.frame import Frame
from probevo.tracking.feature_matcher import FeatureMatcher
from probevo.tracking.image_tracker import ImageTracker
from probevo.tracking.tracks import Tracks

__all__ = ["FeatureMatcher", "ImageTracker", "Tracker", "Tracks", "tracker_for"]


class Tracker(Protocol):
    """Joins each frame to the one before."""

    def track(self, frame: Frame, expected: FloatArray) -> Tracks:
        """Features of the previous frame found in this one; the search starts from T_curr_prev
        ``expected``, [4, 4].

        Called again for the same frame, it starts over.
        """

    def drop(self, ids: IntArray) -> None:
        """Stop following these features."""


def tracker_for(frame: Frame, camera: StereoCamera, config: TrackingConfig) -> Tracker:
    """The tracker that suits what the frames of a sequence hold: images, or features already
    tracked."""
    return FeatureMatcher() if frame.features is not None else ImageTracker(camera, config)
