"""Where to start tracking while the speed, or the rotation, is not known."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.ransac import Consensus, InlierThreshold, find_consensus
from probevo.estimation.rival_motion import (
    AGAINST_FACTOR,
    Hypothesis,
    outranks,
)
from probevo.geometry import se3, so3
from probevo.sequences.frame import Frame
from probevo.tracking import ImageTracker, Tracked, Tracker, TrackingState
from probevo.tracking.image_rotation import coarse_rotation, matched_rotation
from probevo.tracking.image_tracker import Followed

REACH_PX = 30.0
"""Distance from the prediction within which the tracker, with its three pyramid levels, reliably
finds a point."""
NEAR_PX = 0.5 * REACH_PX
"""If another rotation is this near to the predicted one, it is no further start: the searches from
both find the same points."""
NEAR_ROLL_RAD = 0.1
"""The same for a turn about the optical axis."""
MIN_KEPT = 0.5
"""If a smaller share of the previous features that are still in view is found, the search may have
started in a wrong place."""


def rotated_starts(
    prediction: MotionPrediction, prev_frame: Frame, frame: Frame, camera: StereoCamera
) -> list[FloatArray]:
    """Return further starts, T_curr_prev [4, 4], with a rotation from a gyro that has not been
    tested, or from the images.

    They are needed if the camera may have turned by more than the tracker can follow. Without them,
    a camera that begins to turn between distant frames is lost for the whole turn.
    """
    if prev_frame.left is None or frame.left is None:
        return []
    rotations = []
    alternative = prediction.alternative
    if alternative is not None and alternative.is_of_gyro:
        rotations.append(alternative.T_curr_prev[:3, :3])
    # σ of the predicted pitch and yaw, as a shift of the image
    sigma_px = np.sqrt(np.diagonal(prediction.cov)[3:5]) * [camera.fv_px, camera.fu_px]
    if sigma_px.max() >= REACH_PX:
        rotations.append(coarse_rotation(prev_frame.left, frame.left, camera))
    return _with_rotations(prediction.T_curr_prev, rotations, camera)


def _with_rotations(
    T_curr_prev: FloatArray, rotations: list[FloatArray], camera: StereoCamera
) -> list[FloatArray]:
    """Return a start, [4, 4], with the predicted translation for each rotation, [3, 3]; rotations
    so near to the predicted one that they lead to the same tracks are left out."""
    starts = []
    for C_curr_prev in rotations:
        difference = so3.log(C_curr_prev @ T_curr_prev[:3, :3].T)
        shift_px = np.abs(difference[:2]) * [camera.fv_px, camera.fu_px]
        if shift_px.max() >= NEAR_PX or abs(difference[2]) >= NEAR_ROLL_RAD:
            starts.append(se3.from_parts(C_curr_prev, T_curr_prev[:3, 3]))
    return starts


class _Agreement(NamedTuple):
    """How well the tracks from one start agree."""

    followed: Followed
    consensus: Consensus
    """The motion that most of them agree on."""
    value: float
    """The number of these, times their share of those that are found, and of those that should
    be."""

    @property
    def hypothesis(self) -> Hypothesis:
        """The motion with the tracks that agree."""
        agreeing = self.followed.tracks_of_scene.subset(self.consensus.inliers)
        return Hypothesis(self.consensus.T_curr_prev, agreeing)


def track_from_best_start(
    tracker: Tracker,
    state: TrackingState,
    frames: tuple[Frame, Frame],
    *,
    starts: list[FloatArray],
    speed_is_unknown: bool = False,
    camera: StereoCamera,
    config: OdometryConfig,
) -> Tracked:
    """Track between two frames, the previous and the current one, from each start T_curr_prev,
    [4, 4], and return the result whose tracks agree best.

    If more than half of the features in view are lost, the camera may have turned in a way that
    nobody predicted. The rotation of matched descriptors is then a further start, or that of the
    images as a whole.

    If the camera is fast, Lucas–Kanade finds near points only from about the right start. Started
    from rest, it converges to similar-looking places, such as the next post of a guard rail, which
    may even agree on a motion, and so do the points of a lorry ahead. More points agree on the true
    motion, or, where it takes most points out of the view, a larger share of those that are found,
    and of those that it leaves in view.

    While the speed is unknown, many points may still agree on another motion: if vehicles are all
    around, most are on these. Then the points that surround the camera tell its motion
    (``rival_motion``).
    """
    prev_frame, frame = frames
    # Features of a tracks file are matched by identity, whatever the start.
    if not isinstance(tracker, ImageTracker):
        return tracker.track(state, frame, starts[0])
    found = [tracker.follow(state, frame, start) for start in starts]
    num_features = len(state) - len(state.fixed_ids)
    is_lost = _most_are_lost(found, num_features)
    if is_lost and prev_frame.left is not None and frame.left is not None:
        shown = matched_rotation(prev_frame.left, frame.left, camera)
        if shown is None:
            shown = coarse_rotation(prev_frame.left, frame.left, camera)
        further = _with_rotations(starts[0], [shown], camera)
        starts = starts + further
        found += [tracker.follow(state, frame, start) for start in further]
    if len(found) == 1:
        return tracker.with_new_features(found[0])
    agreements = [
        _agreement(
            start,
            followed,
            camera,
            config,
            num_features=num_features,
            seed=[config.seed, frame.index],
        )
        for start, followed in zip(starts, found, strict=True)
    ]
    best, *others = sorted(agreements, key=lambda each: each.value, reverse=True)
    for rival in others if speed_is_unknown else []:
        if outranks(
            rival.hypothesis,
            best.hypothesis,
            camera,
            fewest=config.solver.min_tracks_beyond_chance,
            against_px=AGAINST_FACTOR * config.ransac.threshold_px,
        ):
            best = rival
    return tracker.with_new_features(best.followed)


def _agreement(
    start: FloatArray,
    followed: Followed,
    camera: StereoCamera,
    config: OdometryConfig,
    *,
    num_features: int,
    seed: list[int],
) -> _Agreement:
    """Return how well the tracks from a start agree.

    Args:
        start: T_curr_prev, [4, 4].
        followed: the tracks.
        camera: the rectified camera.
        config: settings of RANSAC.
        num_features: number of features of the scene in the previous frame.
        seed: of RANSAC; the same for all starts, so that only the tracks differ.
    """
    tracks = followed.tracks_of_scene
    consensus = find_consensus(
        tracks,
        camera,
        rng=np.random.default_rng(seed),
        guess=start,
        threshold=InlierThreshold(config.ransac.threshold_px),
        confidence=config.ransac.confidence,
    )
    num_inliers = int(consensus.inliers.sum())
    num_in_view = num_features - followed.num_left_the_view
    share_of_found = num_inliers / max(len(tracks), 1)
    share_in_view = num_inliers / max(num_in_view, 1)
    return _Agreement(followed, consensus, num_inliers * share_of_found * share_in_view)


def _most_are_lost(found: list[Followed], num_features: int) -> bool:
    """Return whether more than half of the features that are still in view are lost.

    Those that leave the view are not lost. Their number is that of the start by which the fewest
    leave it, since from a wrong one, more may seem to.
    """
    if num_features == 0:
        return False
    num_in_view = num_features - min(followed.num_left_the_view for followed in found)
    most_found = max(len(followed.tracks_of_scene) for followed in found)
    return most_found <= MIN_KEPT * num_in_view
