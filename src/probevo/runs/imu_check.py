"""Comparison of the gyro with the rotation that the images show.

It finds the usual mistakes of an IMU's calibration before they do harm: the unit, the time offset,
the sign and the mounting.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import islice, pairwise
from typing import TYPE_CHECKING

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.estimation.motion_estimate import Status
from probevo.evaluation.gyro_check import integrated_rotations
from probevo.geometry import se3, so3
from probevo.odometry import StereoOdometry
from probevo.sequences.validation import (
    MAX_FORCE_M_S2,
    MAX_RATE_RAD_S,
    plausible_stream,
    spike_stamps,
)

if TYPE_CHECKING:
    from probevo.sequences import Sequence
    from probevo.sequences.imu import ImuStream
    from probevo.sequences.imu_calibration import ImuCalibration

MAX_STEPS = 60
"""Steps that are compared, from the start of the recording."""
MIN_STEPS = 10
"""Minimum number of steps for a comparison."""
MAX_DISAGREEMENT = 0.5
"""Median difference of the rotations, as a share of the rotation of a step, beyond which something
is wrong. On KITTI it is 0.03 to 0.4, where tracks are poor; a misalignment of 1° adds 0.02."""
MIN_ROTATION_RAD = 5e-3
"""Smallest rotation of a step that the difference is compared with."""
LAGS_S = np.arange(-0.2, 0.2001, 0.01)
"""Time offsets that are tried."""
DEGREES_PER_RADIAN = np.rad2deg(1.0)


@dataclass(frozen=True)
class ImageRotations:
    """The rotations of K steps as the images show them."""

    frame_stamps_ns: IntArray
    """Stamps of the two frames of each step, [K, 2]."""
    rotation_rad: FloatArray
    """Rotation vectors Log(C_curr_prev), [K, 3], camera frame."""

    @staticmethod
    def of(sequence: Sequence) -> ImageRotations:
        """Estimate the rotations of the first steps without the IMU; leave out unsolved steps."""
        odometry = StereoOdometry(sequence.camera, config={"estimator": "two-frame"})
        frames = list(islice(sequence, MAX_STEPS + 1))
        motions = [odometry.step(frame) for frame in frames][1:]
        solved = [k for k, motion in enumerate(motions) if motion.status is Status.OK]
        stamps_ns = [frame.stamp_ns for frame in frames]
        frame_stamps_ns = np.array(list(pairwise(stamps_ns)), np.int64).reshape(-1, 2)
        C_curr_prev = np.array([motion.T_curr_prev[:3, :3] for motion in motions])
        return ImageRotations(
            frame_stamps_ns[solved], so3.log(C_curr_prev.reshape(-1, 3, 3)[solved])
        )

    def gyro_rotation_rad(
        self, stream: ImuStream, calibration: ImuCalibration, lag_s: float = 0.0
    ) -> FloatArray:
        """Integrate the gyro over the same steps.

        The median difference from the images is subtracted as a bias, limited to 3σ of the
        calibration.

        Args:
            stream: the samples of the IMU.
            calibration: the calibration of the IMU.
            lag_s: time to be added to the stamps of the IMU.

        Returns:
            Rotation vectors, [K, 3], camera frame; NaN for steps that the samples do not cover.
        """
        rotation_rad = integrated_rotations(self.frame_stamps_ns, stream, calibration, lag_s)

        # Estimate the bias as a median, as some steps may be wrong, and limit its size.
        covered = np.isfinite(rotation_rad).all(axis=1)
        duration_s = 1e-9 * np.diff(self.frame_stamps_ns, axis=1)
        bias_rad_s = np.zeros(3)
        if covered.any():
            rate_error_rad_s = (rotation_rad - self.rotation_rad)[covered] / duration_s[covered]
            bias_rad_s = np.median(rate_error_rad_s, axis=0)
        size_rad_s = max(float(np.linalg.norm(bias_rad_s)), 1e-12)
        share = min(1.0, 3.0 * calibration.gyro_bias_sigma_rad_s / size_rad_s)
        return np.asarray(rotation_rad - share * bias_rad_s * duration_s)


def sample_warnings(stream: ImuStream, frames_ns: IntArray) -> list[str]:
    """Describe the samples that no sensor measures, and single samples far from their neighbours.

    Args:
        stream: the samples of the IMU.
        frames_ns: stamps of the frames, [K]; the odometry looks for spikes between two of them.

    Returns:
        The warnings; none if all samples are plausible.
    """
    rates_rad_s = stream.gyro_rad_s[stream.recorded]
    forces_m_s2 = stream.accel_m_s2[stream.recorded]
    is_implausible = (np.abs(rates_rad_s) > MAX_RATE_RAD_S).any(axis=1)
    num_forces = int((np.abs(forces_m_s2) > MAX_FORCE_M_S2).any(axis=1).sum())
    num_spikes = len(spike_stamps(plausible_stream(stream), frames_ns))
    total = f"of {len(rates_rad_s):,}"
    counted = [
        (
            int(is_implausible.sum()),
            f"have an angular rate over {MAX_RATE_RAD_S:g} rad/s; they are left out",
        ),
        (num_forces, f"have a specific force over {MAX_FORCE_M_S2:g} m/s²; it is left out"),
        (num_spikes, "are spikes of the gyro, and left out"),
    ]
    return [f"{count:,} {total} {text}" for count, text in counted if count]


def imu_warning(images: ImageRotations, stream: ImuStream, calibration: ImuCalibration) -> str:
    """Describe how the gyro disagrees with the images, and the likely cause.

    Returns:
        The warning; empty if the two agree, or if there are too few steps to say.
    """
    stream = plausible_stream(stream)
    gyro_rad = images.gyro_rotation_rad(stream, calibration)
    disagreement = _disagreement(images.rotation_rad, gyro_rad)
    covered = np.isfinite(gyro_rad).all(axis=1)
    if covered.sum() < MIN_STEPS or disagreement < MAX_DISAGREEMENT:
        return ""
    what = f"its rotations differ from those of the images by {disagreement:.0%}: "

    # Degrees instead of radians.
    image_length = max(_median_length(images.rotation_rad[covered]), 1e-9)
    scale = _median_length(gyro_rad[covered]) / image_length
    if 0.7 < scale / DEGREES_PER_RADIAN < 1.4:
        return f"{what}they are {scale:.0f} times as large. Is the gyro in degrees per second?"

    # A time offset.
    lag_disagreements = [
        _disagreement(images.rotation_rad, images.gyro_rotation_rad(stream, calibration, lag_s))
        for lag_s in LAGS_S
    ]
    if min(lag_disagreements) < 0.5 * disagreement:
        best_ms = 1e3 * LAGS_S[int(np.argmin(lag_disagreements))]
        return f"{what}half of that or less with its stamps shifted by {best_ms:+.0f} ms."

    # An inverse mounting, or a negated gyro: that which agrees better, if one of them does.
    inverse = replace(calibration, T_cam_imu=se3.inverse(calibration.T_cam_imu))
    negated = replace(stream, gyro_rad_s=-stream.gyro_rad_s)
    inverse_disagreement = _disagreement(
        images.rotation_rad, images.gyro_rotation_rad(stream, inverse)
    )
    negated_disagreement = _disagreement(
        images.rotation_rad, images.gyro_rotation_rad(negated, calibration)
    )
    if min(inverse_disagreement, negated_disagreement) < 0.5 * disagreement:
        if inverse_disagreement < negated_disagreement:
            return f"{what}half of that or less by the inverse of T_cam_imu. Is that what is meant?"
        return f"{what}they are opposite. Has the gyro the opposite sign?"
    return f"{what}is its rotation to the camera right, and is the gyro in rad/s?"


def _disagreement(image_rad: FloatArray, gyro_rad: FloatArray) -> float:
    """Return the median difference as a share of the rotation; infinite if too few are covered."""
    covered = np.isfinite(gyro_rad).all(axis=1)
    if covered.sum() < MIN_STEPS:
        return np.inf
    difference_rad = _median_length(gyro_rad[covered] - image_rad[covered])
    return difference_rad / max(_median_length(image_rad[covered]), MIN_ROTATION_RAD)


def _median_length(vectors: FloatArray) -> float:
    """Return the median length of vectors, [K, 3]; a few outliers do not change it."""
    return float(np.median(np.linalg.norm(vectors, axis=1)))
