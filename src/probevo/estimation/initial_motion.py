"""Tracks → which of them to use, and a motion to start the solve from."""

from __future__ import annotations

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.motion_model import ExpectedMotion
from probevo.estimation.ransac import Consensus, find_consensus
from probevo.estimation.reprojection import RotationPrior
from probevo.geometry import se3
from probevo.tracking.tracks import Tracks

FEWEST_INLIERS = 0.25
"""Share of the tracks that has to agree with a motion; else the threshold is widened, and in the
end it is refused."""
NEAR_DISPARITY_PX = 2.0
"""Points with less disparity lie in no definite place, and say nothing of a translation on their
own."""


def enough(inliers: BoolArray, config: OdometryConfig) -> bool:
    """Whether so many of N tracks may carry a motion."""
    return bool(inliers.sum() >= max(config.solver.min_tracks, FEWEST_INLIERS * len(inliers)))


def first_guess(
    tracks: Tracks,
    camera: StereoCamera,
    expected: ExpectedMotion,
    rotation: RotationPrior | None,
    config: OdometryConfig,
    rng: np.random.Generator,
) -> Consensus:
    """A motion to start from, and which of N tracks to solve with: those that RANSAC takes for
    inliers, or all.

    Args:
        tracks: the N tracks.
        camera: the rectified camera.
        expected: motion before looking.
        rotation: the gyro's rotation, if there is one.
        config: settings of RANSAC and gyro.
        rng: source of the samples.
    """
    plausible = _turned_as_expected(
        tracks, camera, expected.T_curr_prev[:3, :3], limit_deg=config.gyro.prefilter_deg
    )
    if config.ransac.mode == "off":
        return Consensus(
            _centroid_motion(tracks.kept(plausible), camera, expected.T_curr_prev), plausible
        )
    rotation_from_gyro = (
        rotation.C_curr_prev if rotation and config.ransac.rotation_from == "gyro" else None
    )
    for widening in (
        1.0,
        2.0,
        4.0,
    ):  # where hardly anything agrees, the tracks are noisier than the threshold assumes
        consensus = find_consensus(
            tracks.prev_px[plausible],
            tracks.curr_px[plausible],
            camera,
            rng=rng,
            guess=expected.T_curr_prev,
            C_curr_prev=rotation_from_gyro,
            threshold_px=widening * config.ransac.threshold_px,
            confidence=config.ransac.confidence,
        )
        if enough(consensus.inliers, config):
            break
    inliers = plausible.copy()
    if config.ransac.mode == "reject" or not enough(consensus.inliers, config):
        inliers[plausible] = consensus.inliers
    return Consensus(consensus.T_curr_prev, inliers)


def _turned_as_expected(
    tracks: Tracks, camera: StereoCamera, C_curr_prev: FloatArray, limit_deg: float
) -> BoolArray:
    """Which of the N features are seen within an angle of where the rotation alone takes them
    (PROBE V), [N]."""
    if limit_deg == 0.0:
        return np.ones(len(tracks), np.bool_)
    before, now = (_directions(pixels, camera) for pixels in (tracks.prev_px, tracks.curr_px))
    cosine = np.sum((before @ C_curr_prev.T) * now, axis=1)
    near: BoolArray = cosine >= np.cos(np.deg2rad(limit_deg))
    return near


def _directions(pixels: FloatArray, camera: StereoCamera) -> FloatArray:
    """Unit vectors towards features [N, 4], [N, 3]."""
    x, y = camera.normalized(pixels[:, 0], pixels[:, 1])
    rays = np.column_stack([x, y, np.ones_like(x)])
    unit: FloatArray = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return unit


def _centroid_motion(tracks: Tracks, camera: StereoCamera, expected: FloatArray) -> FloatArray:
    """PROBE's start (eqs. 5-6), [4, 4]: the expected rotation, and how the middle of all near
    points moves under it.

    The middle is the median, where PROBE takes the mean, which a single mismatch carries away.
    """
    near = (
        np.minimum(*(pixels[:, 0] - pixels[:, 2] for pixels in (tracks.prev_px, tracks.curr_px)))
        > NEAR_DISPARITY_PX
    )
    if near.sum() < 3:
        return expected
    before = camera.triangulate(tracks.prev_px[near])
    now = camera.triangulate(tracks.curr_px[near])
    C = expected[:3, :3]
    return se3.from_parts(C, np.median(now - before @ C.T, axis=0))
