"""RANSAC with fallbacks: the tracks to solve with, and the motion to start the solve from."""

from __future__ import annotations

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.stereo import StereoCamera
from probevo.config import OdometryConfig
from probevo.estimation.motion_model import MotionPrediction
from probevo.estimation.ransac import MIN_INLIER_SHARE, Consensus, InlierThreshold, find_consensus
from probevo.geometry import se3
from probevo.measurements.relative_rotation import RelativeRotation
from probevo.tracking.tracks import Tracks

WIDENINGS = (1.0, 2.0, 4.0)
"""Multiples of RANSAC's threshold that are tried in turn, until there are enough inliers."""
NEAR_DISPARITY_PX = 2.0
"""Points with less disparity are too uncertain in depth to determine a translation."""


def are_enough(inliers: BoolArray, config: OdometryConfig) -> bool:
    """Return whether these inliers of N tracks are enough for a solve."""
    return bool(inliers.sum() >= max(config.solver.min_tracks, MIN_INLIER_SHARE * len(inliers)))


def initial_motion(
    tracks: Tracks,
    camera: StereoCamera,
    prediction: MotionPrediction,
    *,
    gyro: RelativeRotation | None,
    config: OdometryConfig,
    rng: np.random.Generator,
    right_sigma_px: float = 0.0,
) -> Consensus:
    """Find a motion to start from, and which of N tracks to solve with.

    Args:
        tracks: the N tracks.
        camera: the rectified camera.
        prediction: motion predicted before the images are used.
        gyro: the gyro's rotation, if there is one.
        config: settings of RANSAC and gyro.
        rng: source of the samples.
        right_sigma_px: see ``InlierThreshold``.

    Returns:
        The motion, and RANSAC's inliers, or all tracks where the settings say so.
    """
    # PROBE's pre-filter by the predicted rotation; off by default
    plausible = _rotated_as_predicted(
        tracks, camera, prediction.T_curr_prev[:3, :3], limit_deg=config.gyro.prefilter_deg
    )
    # As in PROBE, without RANSAC
    if config.ransac.mode == "off":
        T_curr_prev = _centroid_motion(tracks.subset(plausible), camera, prediction.T_curr_prev)
        return Consensus(T_curr_prev, plausible)
    # RANSAC samples the translation alone where the gyro knows the rotation.
    C_curr_prev = None
    if gyro is not None and config.ransac.rotation_from == "gyro":
        C_curr_prev = gyro.C_curr_prev
    # If there are hardly any inliers, the tracks are noisier than the threshold assumes: widen it.
    for widening in WIDENINGS:
        consensus = find_consensus(
            tracks.subset(plausible),
            camera,
            rng=rng,
            guess=prediction.T_curr_prev,
            C_curr_prev=C_curr_prev,
            threshold=InlierThreshold(widening * config.ransac.threshold_px, right_sigma_px),
            confidence=config.ransac.confidence,
        )
        if are_enough(consensus.inliers, config):
            break
    # Unless RANSAC is to reject outliers, keep all tracks, and leave them to the robust loss.
    inliers = plausible.copy()
    if config.ransac.mode == "reject" or not are_enough(consensus.inliers, config):
        inliers[plausible] = consensus.inliers
    return Consensus(consensus.T_curr_prev, inliers)


def _rotated_as_predicted(
    tracks: Tracks, camera: StereoCamera, C_curr_prev: FloatArray, *, limit_deg: float
) -> BoolArray:
    """Return which of the N features are seen within an angle of where the rotation alone takes
    them (PROBE V), [N]."""
    # Off by default: it needs a good predicted rotation, such as that of a gyro.
    if limit_deg == 0.0:
        return np.ones(len(tracks), np.bool_)
    prev_rays = camera.unit_rays(tracks.prev_px)
    curr_rays = camera.unit_rays(tracks.curr_px)
    cosine = np.sum((prev_rays @ C_curr_prev.T) * curr_rays, axis=1)
    near: BoolArray = cosine >= np.cos(np.deg2rad(limit_deg))
    return near


def _centroid_motion(tracks: Tracks, camera: StereoCamera, T_predicted: FloatArray) -> FloatArray:
    """Return PROBE's start (eqs. 5-6), [4, 4]: the predicted rotation, and the translation of the
    centroid of all near points under it.

    The centroid is the median. PROBE takes the mean, which a single mismatch can spoil.
    """
    prev_disparity = tracks.prev_px[:, 0] - tracks.prev_px[:, 2]
    curr_disparity = tracks.curr_px[:, 0] - tracks.curr_px[:, 2]
    near = np.minimum(prev_disparity, curr_disparity) > NEAR_DISPARITY_PX
    # The median of one or two points is no better than the prediction.
    if near.sum() < 3:
        return T_predicted
    prev_points = camera.triangulate(tracks.prev_px[near])
    curr_points = camera.triangulate(tracks.curr_px[near])
    # t = p_curr − C p_prev of each point, and the median of each coordinate of it.
    C = T_predicted[:3, :3]
    return se3.from_parts(C, np.median(curr_points - prev_points @ C.T, axis=0))
