"""The result of one step: the relative motion, its covariance, and its status."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Literal

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo.measurements.imu_reason import ImuReason
from probevo.sequences.missing_data import MissingData

COMMON_MODE_COLUMNS = 10
"""Columns of the common-mode part of a covariance: three for b₀, b₁ and b₂ of the rig
(``camera.rig_calibration``), six for what of its distortion field (``camera.distortion_field``) is
independent of these, and one for its focal length."""


MAX_UNKNOWN = np.repeat([1e3, 2.0], 3)
"""Standard deviations of a motion of which nothing is known, m and rad: a kilometre, and that of an
angle from −π to π (π/√3). Beside features that know the motions between other frames to 0.1 mm,
rounding would lose what is less certain."""


@dataclass(frozen=True)
class SensorOutcome:
    """Whether and how one sensor was used in a step."""

    name: str
    state: Literal["used", "gated", "silent", "excluded"]
    reason: str | None = None
    """Why it was silent, why it is reset, or why it is excluded."""
    mahalanobis_sq: float | None = None
    """Largest squared Mahalanobis distance of its innovations; None if none was tested."""
    weight: float = 0.0
    """Least weight of its measurements, 0 to 1."""


class Status(IntEnum):
    """How the motion of a step was obtained.

    In all but FIRST, OK and RECOVERED, it is dead-reckoned from gyro and last velocity, and much
    less certain.
    """

    FIRST = 0
    """The first frame: identity, zero covariance."""
    OK = 1
    DEGENERATE = 2
    """The features do not constrain all six degrees of freedom."""
    TOO_FEW_TRACKS = 3
    NOT_CONVERGED = 4
    """The solve did not converge, or its result fails the innovation gate of the motion model."""
    GAP = 5
    """The motion could not be solved, and frames are missing before this one."""
    RECOVERED = 6
    """After dead-reckoned steps, the motion from the last OK frame was solved from images. This
    step is as uncertain as the dead-reckoned ones, but the path is not (``path_cross_cov``)."""


@dataclass(frozen=True)
class MotionEstimate:
    """Motion of the camera from the previous frame to this one."""

    T_curr_prev: FloatArray
    """p_curr = T_curr_prev p_prev, [4, 4], m."""
    cov: FloatArray
    """Covariance of the left perturbation ξ = [ρ; φ], T = Exp(ξ) T_curr_prev, [6, 6], m and rad."""
    status: Status
    num_tracks: int
    """Tracks that the step had."""
    num_inliers: int = 0
    """Tracks with a weight of at least one half, of 0 to 1 (``estimation.feature_weights``)."""
    iterations: int = 0
    common_mode: FloatArray = field(default_factory=lambda: np.zeros((6, COMMON_MODE_COLUMNS)))
    """The common-mode part of ``cov``, from the uncertainty of the rig's calibration (Schmidt's
    consider term): ξ moves along these columns, [6, COMMON_MODE_COLUMNS], by the same numbers of
    unit variance in every step, and ``cov`` contains common_mode common_modeᵀ."""
    path_cross_cov: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    """Cross-covariance of the error of the path before this step, along the axes of the current
    camera, with that of the step, [6, 6]: both depend on the same tracks, or the same velocity. A
    path covariance P = Ad P Adᵀ + cov grows by path_cross_cov + path_cross_covᵀ besides."""
    stage_ms: Mapping[str, float] = field(default_factory=dict)
    """Wall time of each stage of this step, ms."""
    num_used: int = 0
    """Tracks that the solve used; 0 without a solve."""
    num_out_of_domain: int | None = None
    """Tracks used that are outside of the noise model's training data; None without a solve, or if
    the model has no such domain."""
    noise_factor: float = 1.0
    """Running factor of the noise model's variances with which this step began (``NoiseScale``); of
    ``estimate_motion``, the one that its matches show."""
    T_world_cam: FloatArray = field(default_factory=lambda: np.eye(4))
    """Pose of the current camera in the world, the frame of the first camera, [4, 4], m: the
    motions so far compounded, and corrected by measurements of the pose where there were any."""
    cov_cam_world: FloatArray = field(default_factory=lambda: np.zeros((6, 6)))
    """Covariance of the left perturbation of ``T_cam_world``, [6, 6], m and rad."""
    missing: tuple[MissingData, ...] = ()
    """What the frame lacked: samples, features and images that could not be used. Each is a phrase
    as text, such as ``3 of 20 IMU samples without a finite angular rate``."""
    imu_reason: ImuReason | None = None
    """Why the window does not use its IMU in this step; None if it does, or if there is no IMU."""
    sensors: tuple[SensorOutcome, ...] = ()
    """The outcome of each further sensor."""

    @property
    def T_cam_world(self) -> FloatArray:
        """The inverse of T_world_cam, [4, 4], m; its covariance is ``cov_cam_world``."""
        return se3.inverse(self.T_world_cam)

    @property
    def own_cov(self) -> FloatArray:
        """``cov`` without its common-mode part, [6, 6]: what is new in each step."""
        return self.cov - self.common_mode @ self.common_mode.T

    @property
    def imu_left_out(self) -> str:
        """The text of ``imu_reason``, a phrase that continues "the IMU …"; empty if there is
        none."""
        return "" if self.imu_reason is None else self.imu_reason.text

    def __repr__(self) -> str:
        """Return status, distance, angle, and the largest standard deviations, in one line."""
        distance_m = float(np.linalg.norm(self.T_curr_prev[:3, 3]))
        cosine = 0.5 * (float(np.trace(self.T_curr_prev[:3, :3])) - 1.0)
        angle_deg = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
        sigma = np.sqrt(np.diagonal(self.cov))
        return (
            f"MotionEstimate({self.status.name}, {distance_m:.4g} ± {sigma[:3].max():.2g} m,"
            f" {angle_deg:.4g} ± {math.degrees(sigma[3:].max()):.2g}°,"
            f" {self.num_inliers} inliers of {self.num_tracks} tracks)"
        )

    @staticmethod
    def first(missing: tuple[MissingData, ...] = ()) -> MotionEstimate:
        """Return the estimate of the first frame."""
        return MotionEstimate(
            T_curr_prev=np.eye(4),
            cov=np.zeros((6, 6)),
            status=Status.FIRST,
            num_tracks=0,
            missing=missing,
        )
