"""Where to start tracking while the speed, or the rotation, is not known."""

from __future__ import annotations

import cv2
import numpy as np

from probevo.arrays import FloatArray, Image
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.ransac import InlierThreshold, find_consensus
from probevo.geometry import se3, so3
from probevo.sequences.frame import Frame
from probevo.tracking import Tracked, Tracker, TrackingState

REACH_PX = 30.0
"""Distance from the prediction within which the tracker, with its three pyramid levels, reliably
finds a point."""
NEAR_PX = 15.0
"""If the coarse rotation is this near to the predicted one, it is no further start. With 30 px, a
step of raw 0005 was lost when only every fourth frame was used."""
COARSE_PX = 8
"""Factor by which images are reduced for the coarse rotation."""


def rotated_starts(
    prediction: MotionPrediction, prev_frame: Frame, frame: Frame, camera: StereoCamera
) -> list[FloatArray]:
    """Return another start, T_curr_prev [4, 4], with a rotation from the images, or none.

    It is needed if the camera may have turned by more than the tracker can follow. Without it and
    without a gyro, a camera that begins to turn between distant frames is lost for the whole turn.
    """
    # σ of the predicted pitch and yaw, as a shift of the image
    sigma_px = np.sqrt(np.diagonal(prediction.cov)[3:5]) * [camera.fv_px, camera.fu_px]
    if prev_frame.left is None or frame.left is None or sigma_px.max() < REACH_PX:
        return []
    C_curr_prev = coarse_rotation(prev_frame.left, frame.left, camera)
    difference = so3.log(C_curr_prev @ prediction.T_curr_prev[:3, :3].T)[:2]
    if np.abs(difference * [camera.fv_px, camera.fu_px]).max() < NEAR_PX:
        return []
    return [se3.from_parts(C_curr_prev, prediction.T_curr_prev[:3, 3])]


def coarse_rotation(prev_image: Image, image: Image, camera: StereoCamera) -> FloatArray:
    """Return C_curr_prev, [3, 3], a rough yaw and pitch from the shift of the whole image (phase
    correlation)."""
    # In small images, a rotation by several degrees is a shift by a few pixels.
    size = max(image.shape[1] // COARSE_PX, 2), max(image.shape[0] // COARSE_PX, 2)
    prev_small, small = (
        cv2.resize(each, size, interpolation=cv2.INTER_AREA).astype(np.float32)
        for each in (prev_image, image)
    )
    # A window function, since phase correlation takes the images as periodic.
    window = np.asarray(cv2.createHanningWindow(size, cv2.CV_32F))
    (du, dv), _ = cv2.phaseCorrelate(prev_small, small, window)
    # A shift down by dv is a rotation about −x, a shift to the right by du one about +y.
    angle = COARSE_PX * np.array([-dv / camera.fv_px, du / camera.fu_px, 0.0])
    rotation: FloatArray = so3.exp(angle)
    return rotation


def track_from_best_start(
    tracker: Tracker,
    state: TrackingState,
    frame: Frame,
    *,
    starts: list[FloatArray],
    camera: StereoCamera,
    config: OdometryConfig,
) -> Tracked:
    """Track from each start T_curr_prev, [4, 4], and return the result whose tracks agree best.

    If the camera is fast, Lucas–Kanade finds near points only from about the right start. Started
    from rest, it converges to similar-looking places, such as the next post of a guard rail, which
    may even agree on a motion. On the true one agree more points, or, where most points have left
    the view, a larger share of those that are found.
    """
    # Features of a tracks file are matched by identity, whatever the start.
    if len(starts) == 1 or frame.features is not None:
        return tracker.track(state, frame, starts[0])
    found = []
    agreement = []
    for start in starts:
        tracked = tracker.track(state, frame, start)
        consensus = find_consensus(
            tracked.tracks,
            camera,
            rng=np.random.default_rng([config.seed, frame.index]),
            guess=start,
            threshold=InlierThreshold(config.ransac.threshold_px),
            confidence=config.ransac.confidence,
        )
        # All starts use the same seed, so that only the tracks differ.
        found.append(tracked)
        num_inliers = int(consensus.inliers.sum())
        agreement.append(num_inliers**2 / max(len(tracked.tracks), 1))  # their number times share
    return found[int(np.argmax(agreement))]
