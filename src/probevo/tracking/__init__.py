"""Images or features of consecutive frames → ``Tracks``, and the store of all observations."""

from __future__ import annotations

from probevo.camera.stereo import StereoCamera
from probevo.config import TrackingConfig
from probevo.sequences.frame import Frame
from probevo.tracking.identity_tracker import IdentityTracker
from probevo.tracking.image_tracker import ImageTracker
from probevo.tracking.tracker import Tracked, Tracker, TrackingState
from probevo.tracking.tracks import Tracks

__all__ = [
    "IdentityTracker",
    "ImageTracker",
    "Tracked",
    "Tracker",
    "TrackingState",
    "Tracks",
    "tracker_for",
]


def tracker_for(frame: Frame, camera: StereoCamera, config: TrackingConfig) -> Tracker:
    """Return the tracker for frames like this one: with images, or with features already
    tracked."""
    return IdentityTracker() if frame.features is not None else ImageTracker(camera, config)
