"""The motion of a step as a correction has it, and how it counts in a window."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.estimation.motion_estimate import MotionEstimate, Status
from probevo.geometry import se3
from probevo.measurements.base import Measurement
from probevo.measurements.relative_pose import RelativePose
from probevo.measurements.sensor import Reading
from probevo.measurements.sensor_suite import SensorSuite
from probevo.sequences.frame import Frame

LEAST_WEIGHT = 0.01
"""Of a feature that two frames do not trust; its variance in a window does not grow further."""


def with_correction(
    motion: MotionEstimate,
    readings: Sequence[Reading],
    suite: SensorSuite,
    *,
    frames: tuple[Frame, Frame],
) -> tuple[MotionEstimate, list[Reading]]:
    """Return the motion as a correction has it, and what all sensors returned with what it did.

    Tracking and motion model go on from the motion of the images: their next step is alike.

    Args:
        motion: of the images, or dead-reckoned.
        readings: of each sensor; that of the correction is empty.
        suite: the sensors.
        frames: the previous and the current frame.
    """
    prev_frame, frame = frames
    solved = None
    if motion.status is Status.OK:
        solved = (motion.T_curr_prev, motion.cov)
    correction = suite.read_correction(prev_frame, frame, solved)
    if correction is None:
        return motion, list(readings)
    for measurement in correction.measurements:
        motion = corrected(motion, measurement)
    return motion, [correction if one.name == correction.name else one for one in readings]


def corrected(motion: MotionEstimate, measurement: Measurement) -> MotionEstimate:
    """Return the corrected motion in place of that of the images, with its covariance.

    This covariance is that of the corrected motion's whole error, errors of the rig's calibration
    included, and it is calibrated on sums of successive errors: there is neither a common-mode part
    nor a cross-covariance with the path beside it.
    """
    if not isinstance(measurement, RelativePose):
        return motion
    return replace(
        motion,
        T_curr_prev=measurement.T_curr_prev,
        cov=measurement.covariance,
        common_mode=np.zeros((6, 3)),
        path_cross_cov=np.zeros((6, 6)),
    )


class Shares(NamedTuple):
    """By what the covariances of a step are multiplied where a window takes both its features and
    their corrected motion."""

    features: float
    """That of the features: errors that they have in common, and their share."""
    motion: float
    """That of the corrected motion."""

    def of_features(self, weights: FloatArray) -> FloatArray:
        """Return the factor of each of N features, given how far two frames trust it, [N], 0 to 1.

        With a larger covariance, the robust loss of the window takes a wrong feature for a right
        one. What it would have turned away is therefore inflated by as much again.
        """
        return 1.0 + (self.features - 1.0) / np.maximum(weights, LEAST_WEIGHT)


def shares_of(of_images: MotionEstimate, motion: MotionEstimate, num_frames: int) -> Shares:
    """Return how features and corrected motion share the information of their images.

    Features of a window have errors in common, of which the correction ξ shows those of this step.
    They add up over the window's K frames. Features that are seen in all of these claim to show the
    whole motion as well as that of two frames, with the covariance C. In units of C, the covariance
    of the features is therefore λ = 1 + K² ξᵀ C⁻¹ ξ / 6, and that of the corrected motion
    κ = tr(C⁻¹ Σ) / 6.

    Both errors contain those of the same images, with an unknown cross-covariance. By covariance
    intersection, the information of one is multiplied by ω, that of the other by 1 − ω, and the
    result is consistent whatever that is (Julier & Uhlmann 1997). ω = λ / (λ + κ) is the weight of
    the corrected motion (Niehsen 2002).

    Args:
        of_images: the motion that two frames have shown.
        motion: the corrected one.
        num_frames: frames of the window, K.
    """
    xi = se3.log(motion.T_curr_prev @ se3.inverse(of_images.T_curr_prev))
    information = np.linalg.inv(of_images.cov)
    of_features = 1.0 + num_frames**2 * float(xi @ information @ xi) / len(xi)
    of_motion = float(np.trace(information @ motion.cov)) / len(xi)
    both = of_features + of_motion
    return Shares(features=of_features * both / of_motion, motion=both / of_features)
