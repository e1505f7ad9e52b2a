"""Where to start tracking while the speed, or the turn, is not known."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.motion_model import ExpectedMotion
from probevo.estimation.ransac import find_consensus
from probevo.geometry import se3, so3
from probevo.sequences.frame import Frame
from probevo.tracking import Tracker, Tracks

REACH_PX = 30.0
"""With its three pyramid levels, the tracker finds points this far from where they are expected for
sure."""
NOTICED_PX = 15.0
"""A turn seen this near to the expected one needs no search of its own. With 30 px, a step of raw
0005 was lost where only every fourth frame was taken."""
COARSE_PX = 8
"""Pixels that count as one where only the turn is looked for."""


def turned_starts(
    expected: ExpectedMotion, before: Frame, frame: Frame, camera: StereoCamera
) -> list[FloatArray]:
    """One start more, T_curr_prev [4, 4], where the turn may be larger than the tracker can follow:
    the one seen.

    Without a gyro a camera that begins to turn between distant frames is lost, and stays so while
    it turns.
    """
    sigma_px = np.sqrt(np.diagonal(expected.cov)[3:5]) * [camera.fv_px, camera.fu_px]
    if before.left is None or frame.left is None or sigma_px.max() < REACH_PX:
        return []
    C_curr_prev = seen_turn(before.left, frame.left, camera)
    apart = so3.log(C_curr_prev @ expected.T_curr_prev[:3, :3].T)[:2]
    if np.abs(apart * [camera.fv_px, camera.fu_px]).max() < NOTICED_PX:
        return []
    return [se3.from_parts(C_curr_prev, expected.T_curr_prev[:3, 3])]


def seen_turn(before: Image, now: Image, camera: StereoCamera) -> FloatArray:
    """C_curr_prev, [3, 3], of a yaw and a pitch, roughly, from how far the image has moved (phase
    correlation)."""
    size = max(now.shape[1] // COARSE_PX, 2), max(now.shape[0] // COARSE_PX, 2)
    one, other = (
        cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for image in (before, now)
    )
    (du, dv), _ = cv2.phaseCorrelate(
        one, other, np.asarray(cv2.createHanningWindow(size, cv2.CV_32F))
    )
    turn: FloatArray = so3.exp(COARSE_PX * np.array([-dv / camera.fv_px, du / camera.fu_px, 0.0]))
    return turn


def track_from_best(
    tracker: Tracker,
    frame: Frame,
    starts: list[FloatArray],
    camera: StereoCamera,
    config: OdometryConfig,
) -> Tracks:
    """The tracks found from the one start T_curr_prev, [4, 4]; of several, from the one whose
    tracks agree most.

    Lucas–Kanade finds near points of a fast camera only if it starts about right; started from
    rest, it may settle on whatever looks alike, and that may even agree on a motion. More points
    agree on the true one.
    """
    if len(starts) == 1 or frame.features is not None:  # a file's tracks are the same from anywhere
        return tracker.track(frame, starts[0])
    tracks = Tracks.none()
    agree = np.zeros(len(starts), np.int64)
    ransac = config.ransac
    for k in reversed(
        range(len(starts))
    ):  # the expected one last: it mostly wins, and is then not tracked from again
        tracks = tracker.track(frame, starts[k])
        rng = np.random.default_rng([config.seed, frame.index])
        consensus = find_consensus(
            tracks.prev_px,
            tracks.curr_px,
            camera,
            rng=rng,
            guess=starts[k],
            threshold_px=ransac.threshold_px,
            confidence=ransac.confidence,
        )
        agree[k] = consensus.inliers.sum()
    best = int(np.argmax(agree))
    return tracks if best == 0 else tracker.track(frame, starts[best])
