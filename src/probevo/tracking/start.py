"""Where to start tracking while the speed is not known."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.motion.ransac import find_consensus
from probevo.sequences.frame import Frame
from probevo.tracking import Tracker, Tracks


def track_from_best(
    tracker: Tracker, frame: Frame, starts: list[FloatArray], camera: StereoCamera, config: OdometryConfig
) -> Tracks:
    """The tracks found from the one start T_curr_prev, [4, 4]; of several, from the one whose tracks agree most.

    Lucas–Kanade finds near points of a fast camera only if it starts about right; started from rest, it may settle on
    whatever looks alike, and that may even agree on a motion. More points agree on the true one.
    """
    if len(starts) == 1:
        return tracker.track(frame, starts[0])

    def agreement(start: FloatArray) -> int:
        tracks, rng = tracker.track(frame, start), np.random.default_rng([config.seed, frame.index])
        threshold_px, confidence = config.ransac.threshold_px, config.ransac.confidence
        consensus = find_consensus(
            tracks.prev_px, tracks.curr_px, camera, rng, guess=start, threshold_px=threshold_px, confidence=confidence
        )
        return int(consensus.inliers.sum())

    return tracker.track(frame, max(starts, key=agreement))
