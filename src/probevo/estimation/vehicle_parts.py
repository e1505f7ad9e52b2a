"""Which features are fixed to the vehicle: those of a bonnet, a landing skid or an arm in view.

They stay where they are in both images however the camera moves, like a scene at rest. Where they
outnumber those of the scene, the motion that most features agree on is rest, or a turn about the
part, by which a slow scene stays within RANSAC's threshold, too. After rest, the prediction
confirms either.

So where many of the tracks that a solve has used stay where they are, those that have moved are
searched for a motion of their own. Of that and rest, the camera's is the one whose tracks are more,
times the area that they spread over (``rival_motion``): a part of the vehicle is small and near,
what passes before a camera at rest is compact, and the scene surrounds both.
"""

from __future__ import annotations

import numpy as np

from probevo.arrays import IntArray, rows_of
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.ransac import MIN_INLIER_SHARE, InlierThreshold, find_consensus
from probevo.estimation.rival_motion import (
    AGAINST_FACTOR,
    CONFIDENCE,
    Hypothesis,
    presence_m2,
)
from probevo.tracking.fixed_features import are_still
from probevo.tracking.observations import FrameObservations, ObservationStore
from probevo.tracking.tracks import Tracks

FRAMES_BACK = (1, 3, 9)
"""With which earlier frames the current one is compared, in turn: a slow camera takes several to
move its features by more than they may be off."""


def many_stay(used: Tracks) -> bool:
    """Return whether so many of the tracks that a solve has used stay where they are that RANSAC
    would accept these alone."""
    return bool(len(used)) and float(are_still(used).mean()) >= MIN_INLIER_SHARE


def fixed_to_vehicle(
    tracks: Tracks,
    earlier: ObservationStore,
    camera: StereoCamera,
    *,
    config: OdometryConfig,
    rng: np.random.Generator,
) -> IntArray:
    """Return the identities of those of N tracks that are fixed to the vehicle, while the scene
    moves; none where nothing moves, or only what passes.

    Args:
        tracks: the N tracks into the current frame, raw.
        earlier: the observations of the frames before.
        camera: the rectified camera.
        config: settings of RANSAC and solver.
        rng: source of RANSAC's samples.
    """
    threshold_px = config.ransac.threshold_px
    against_px = AGAINST_FACTOR * threshold_px
    fewest = config.solver.min_tracks_beyond_chance
    for frames_back in FRAMES_BACK:
        if frames_back > len(earlier.frames):
            break
        since = _tracks_since(earlier.frames[-frames_back], tracks)
        moved_px = np.abs(since.curr_px - since.prev_px)[:, :3].max(axis=1)
        moving = since.subset(moved_px > against_px)
        if len(moving) < fewest:
            continue
        found = find_consensus(
            moving,
            camera,
            rng=rng,
            guess=np.eye(4),
            threshold=InlierThreshold(threshold_px),
            confidence=CONFIDENCE,
        )
        scene = moving.subset(found.inliers)
        if len(scene) < fewest:
            continue
        # Where the scene is far, what passes is near: its motion would hardly move the scene.
        resting = Hypothesis(np.eye(4), since.subset(moved_px <= threshold_px))
        fixed = resting.contradicting(found.T_curr_prev, camera, threshold_px)
        if presence_m2(scene, camera) > presence_m2(fixed, camera):
            return fixed.ids
    return np.zeros(0, np.int64)


def _tracks_since(frame: FrameObservations, tracks: Tracks) -> Tracks:
    """Return those of N tracks that an earlier frame has seen, from there to the current frame."""
    rows = rows_of(tracks.ids, frame.landmarks)
    is_seen = rows >= 0
    ids = tracks.ids[is_seen]
    return Tracks(
        prev_px=frame.pixels[rows[is_seen]],
        curr_px=tracks.curr_px[is_seen],
        ids=ids,
        age=tracks.age[is_seen],
    )
