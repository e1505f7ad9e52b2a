"""Which of two motions is the camera's, where many tracks agree on one and many on another.

What moves is compact, and what stands still surrounds the camera. Where vehicles all around have
more features than the street, and all move alike, their number says that the street moves; the
space that they take up says that they do. So the camera's is the motion whose tracks are more,
times the area that they spread over. Points that agree with both motions, which are far away, do
not count. In rendered streets full of traffic, that is right for 742 of 761 pairs of motions; the
number alone is for 118 (``docs/tracker.md``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.camera.transfer import transfer
from probevo.config import OdometryConfig
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.ransac import Consensus, InlierThreshold, find_consensus_near
from probevo.geometry.uncertainty import MOTIONS_DIFFER_FROM
from probevo.tracking.tracks import Tracks

AGAINST_FACTOR = 2.0
"""Multiple of RANSAC's threshold from which on a track contradicts a motion that is not predicted:
errors that all features share, such as those of a flexing rig, make no rival."""
CONFIDENCE = 0.9999
"""Confidence of RANSAC, by which it takes twice as many samples as usual: less than half of the
tracks agree on a rival."""
MIN_DISPARITY_PX = 1.0
"""Points with less disparity count as if they had this one: they are at least so far away. With
0.3, 0.5 and 1 px, the right one of as many pairs of motions is chosen."""


class Hypothesis(NamedTuple):
    """A motion and the tracks that agree on it."""

    T_curr_prev: FloatArray
    """[4, 4]."""
    tracks: Tracks

    def contradicting(
        self, T_curr_prev: FloatArray, camera: StereoCamera, against_px: float
    ) -> Tracks:
        """Return those of its tracks that are farther than ``against_px`` from where another
        motion, [4, 4], takes them: in the worst of u_l, v_l, u_r, as in RANSAC."""
        predicted_px = transfer(self.tracks.prev_px, T_curr_prev, camera)
        error_px = np.abs(predicted_px - self.tracks.curr_px)[:, :3]
        # Negated, since points that get behind the camera have no place, NaN.
        return self.tracks.subset(~np.all(error_px <= against_px, axis=1))


def outranks(
    rival: Hypothesis, best: Hypothesis, camera: StereoCamera, *, fewest: float, against_px: float
) -> bool:
    """Return whether a rival is more likely the camera's motion than the best one so far.

    Args:
        rival: another motion.
        best: the motion that most tracks agree on.
        camera: the rectified camera.
        fewest: least number of tracks that agree on the rival and contradict the best motion.
        against_px: error above which a track contradicts a motion.
    """
    against_best = rival.contradicting(best.T_curr_prev, camera, against_px)
    against_rival = best.contradicting(rival.T_curr_prev, camera, against_px)
    if len(against_best) < fewest:
        return False
    return presence_m2(against_best, camera) > presence_m2(against_rival, camera)


def rival_near_prediction(
    best: Consensus,
    tracks: Tracks,
    camera: StereoCamera,
    prediction: MotionPrediction,
    *,
    config: OdometryConfig,
    rng: np.random.Generator,
) -> Consensus | None:
    """Return another motion, near the predicted one, that is rather the camera's than the one that
    most of N tracks agree on; None if there is none.

    Few tracks are enough for one that is predicted: not even these agree with it by chance.

    Args:
        best: the motion that most tracks agree on, and which of the tracks agree on it.
        tracks: the N tracks.
        camera: the rectified camera.
        prediction: motion predicted before the images are used.
        config: settings of RANSAC and solver.
        rng: source of RANSAC's samples.
    """
    threshold_px = config.ransac.threshold_px
    found = find_consensus_near(
        tracks,
        camera,
        rng=rng,
        guess=prediction.T_curr_prev,
        cov=MOTIONS_DIFFER_FROM * prediction.cov,
        threshold=InlierThreshold(threshold_px),
        confidence=CONFIDENCE,
    )
    is_ranked_higher = outranks(
        Hypothesis(found.T_curr_prev, tracks.subset(found.inliers)),
        Hypothesis(best.T_curr_prev, tracks.subset(best.inliers)),
        camera,
        fewest=config.solver.min_tracks,
        against_px=threshold_px,
    )
    return found if is_ranked_higher else None


def presence_m2(tracks: Tracks, camera: StereoCamera) -> float:
    """Return the number of tracked points, times the area that they spread over: the product of
    their standard deviations along the two largest principal axes, m².

    Not the volume: the points of the ground have none.
    """
    if len(tracks) < 2:
        return 0.0
    prev_px = tracks.prev_px.copy()
    prev_px[:, 2] = np.minimum(prev_px[:, 2], prev_px[:, 0] - MIN_DISPARITY_PX)
    variance = np.linalg.eigvalsh(np.cov(camera.triangulate(prev_px), rowvar=False))
    return len(tracks) * float(np.prod(np.sqrt(np.maximum(variance[1:], 0.0))))
