"""Applying a correction to the motion of a step, and fusing both in a window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS, MotionEstimate, Status
from probevo.geometry import se3
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.sensor import Reading
from probevo.measurements.sensor_suite import SensorSuite
from probevo.sequences.frame import Frame

MIN_WEIGHT = 0.01
"""Smallest weight of a feature; it bounds the inflation of an outlier's variance in a window."""


def with_correction(
    motion: MotionEstimate,
    readings: Sequence[Reading],
    suite: SensorSuite,
    *,
    prev_frame: Frame,
    frame: Frame,
) -> tuple[MotionEstimate, list[Reading]]:
    """Ask the correction, if there is one, and return the corrected motion and all readings.

    Tracking and motion model continue with the uncorrected motion, since they predict what the
    images of the next step will show, which has the same error.

    Args:
        motion: of the images, or dead-reckoned.
        readings: of each sensor; that of the correction is empty.
        suite: the sensors.
        prev_frame: the previous frame.
        frame: the current frame.
    """
    correction = suite.read_correction(
        prev_frame,
        frame,
        motion.T_curr_prev,
        cov=motion.cov,
        is_solved=motion.status is Status.OK,
    )
    if correction is None:
        return motion, list(readings)
    for measurement in correction.measurements:
        if isinstance(measurement, RelativePose):
            motion = corrected(motion, measurement)
    return motion, [correction if one.name == correction.name else one for one in readings]


def corrected(motion: MotionEstimate, correction: RelativePose) -> MotionEstimate:
    """Replace the motion of the images by the corrected one, with its covariance.

    This covariance is of the whole error, errors of the rig's calibration included, and it was
    calibrated on sums of successive errors. So there is neither a common-mode part nor a
    cross-covariance with the path in addition.
    """
    return replace(
        motion,
        T_curr_prev=correction.T_curr_prev,
        cov=correction.covariance,
        common_mode=np.zeros((6, COMMON_MODE_COLUMNS)),
        path_cross_cov=np.zeros((6, 6)),
    )


class CovarianceIntersection(NamedTuple):
    """Factors of the covariances of features and corrected motion, if a window uses both."""

    features: float
    """Factor of the features' covariance: for their common errors and for their share."""
    motion: float
    """Factor of the corrected motion's covariance."""

    def feature_factors(self, weights: FloatArray) -> FloatArray:
        """Return the factor of each of N features, given its two-frame weight, [N], 0 to 1.

        Under the inflated covariance, the robust loss of the window would accept outliers. Their
        covariance is therefore inflated by their small weight as well.
        """
        return 1.0 + (self.features - 1.0) / np.maximum(weights, MIN_WEIGHT)


def covariance_intersection(
    image_motion: MotionEstimate, motion: MotionEstimate, num_frames: int
) -> CovarianceIntersection:
    """Return how features and corrected motion share the information of the same images.

    The features of a window have common errors. The correction ξ is an estimate of those of this
    step, and they add up over the K frames of the window, while features that are seen in all of
    them claim a covariance C like that of two frames, without its common-mode part. In units of C,
    the covariance of the features is therefore λ = 1 + K² ξᵀ C⁻¹ ξ / 6, and that of the corrected
    motion c = tr(C⁻¹ Σ) / 6.

    Both have errors of the same images in them, with an unknown cross-covariance. By covariance
    intersection, the information of one is multiplied by ω, that of the other by 1 − ω, and the
    result is consistent whatever that is (Julier & Uhlmann 1997). ω = λ / (λ + c) is the weight of
    the corrected motion (Niehsen 2002).

    Args:
        image_motion: the motion of the two-frame solve.
        motion: the corrected one.
        num_frames: frames of the window, K.
    """
    # Both in units of the covariance of the two-frame motion, averaged over the six dimensions
    xi = se3.log(motion.T_curr_prev @ se3.inverse(image_motion.T_curr_prev))
    information = np.linalg.inv(image_motion.own_cov)
    features_factor = 1.0 + num_frames**2 * float(xi @ information @ xi) / len(xi)
    motion_factor = float(np.trace(information @ motion.cov)) / len(xi)
    # Covariance intersection with ω = λ/(λ + c): λ/(1 − ω) times C, and 1/ω times Σ
    both = features_factor + motion_factor
    return CovarianceIntersection(
        features=features_factor * both / motion_factor, motion=both / features_factor
    )
