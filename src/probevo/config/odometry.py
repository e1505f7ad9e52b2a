"""The settings of the odometry, each with its bounds and its reason."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, field_validator, model_validator

from probevo.config.settings import Settings

DEFAULT_MAX_DIFFERENCE = {"two-frame": 6.0, "window": 20.0}
"""Default of ``max_difference`` by estimator, grey levels. With a window, 20, 40 and 255 give the
same accuracy. With two frames, 20 instead of 6 loses up to a quarter in rotation on some
recordings, and gains a fifth on others."""


class TrackingConfig(Settings):
    """Settings of feature detection and Lucas–Kanade tracking."""

    num_features: int = Field(
        600,
        ge=8,
        le=20_000,
        description="Features wanted per frame; more cost time, and beyond 600 they gain little.",
    )
    fast_threshold: int = Field(
        10,
        ge=1,
        le=100,
        description="Least contrast of a FAST corner; low, because the grid keeps the strongest.",
    )
    window_px: int = Field(
        11,
        ge=5,
        le=51,
        description=(
            "Side of the Lucas–Kanade window; 11 tracks as well as 21 in a third of the time."
        ),
    )
    pyramid_levels: int = Field(
        3,
        ge=0,
        le=8,
        description=(
            "Pyramid levels above the image; with 3, a feature may be 40 px from its predicted"
            " place."
        ),
    )
    high_pass_px: int = Field(
        41,
        ge=0,
        le=201,
        description=(
            "Side of the box whose mean is subtracted from the image, against vignetting and"
            " changes of exposure, 3 or more; 0 switches it off."
        ),
    )
    max_difference: float | None = Field(
        None,
        gt=0,
        le=255,
        description=(
            "Largest mean difference of two windows that show the same feature, in grey levels; by"
            " default 6 for two frames, and 20 for a window, which detects a wrong track by its"
            " history."
        ),
    )
    max_row_offset_px: float = Field(
        2.5,
        gt=0,
        le=50,
        description=(
            "Largest row offset of a stereo match; rectification errors reach 2 px in practice."
        ),
    )
    min_disparity_px: float = Field(
        0.0,
        ge=-5,
        le=50,
        description=(
            "Least disparity of a stereo match; 0, because distant points constrain the rotation."
        ),
    )

    @field_validator("high_pass_px")
    @classmethod
    def _has_a_mean(cls, side_px: int) -> int:
        """Refuse boxes whose mean is the image itself, or nearly so: they would leave nothing."""
        if side_px in (1, 2):
            raise ValueError("a box of 1 or 2 px leaves nothing of the image; take 0, or 3 or more")
        return side_px


class RansacConfig(Settings):
    """Settings of RANSAC, which finds the initial motion and rejects outliers."""

    threshold_px: float = Field(
        3.0,
        gt=0,
        le=100,
        description="Reprojection error within which a feature is an inlier of a motion.",
    )
    confidence: float = Field(
        0.99,
        gt=0,
        lt=1,
        description=(
            "Probability of an outlier-free sample: 0.99 is PROBE's nominal, 0.9999 its aggressive"
            " setting."
        ),
    )
    rotation_from: Literal["points", "gyro"] = Field(
        "points",
        description="A sample has three points, or a single one with the rotation of the gyro.",
    )
    mode: Literal["reject", "guess", "off"] = Field(
        "reject",
        description=(
            "reject: keep outliers out of the solve; guess: only give the initial motion; off: no"
            " RANSAC (PROBE), so that the solve starts from the predicted rotation and the median"
            " shift of near points."
        ),
    )


class SolverConfig(Settings):
    """Settings of the nonlinear least-squares solve, and of the checks on its result."""

    method: Literal["reprojection", "alignment"] = Field(
        "reprojection",
        description=(
            "reprojection: minimise reprojection errors (PROBE-GK); alignment: align triangulated"
            " points, each with its covariance (PROBE), which distant points bias."
        ),
    )
    loss: Literal["noise", "l2", "huber", "cauchy", "tukey"] = Field(
        "noise",
        description=(
            "Robust loss of the reprojection solve; noise is the negative log-likelihood of the"
            " noise model."
        ),
    )
    noise_scale: Literal["online", "model"] = Field(
        "online",
        description=(
            "Size of the noise: online multiplies the variances of student-t, knn and gk by a"
            " running factor that the residuals of this recording show; model takes them as they"
            " are."
        ),
    )
    max_iterations: int = Field(
        50,
        ge=1,
        le=1000,
        description="Most iterations of Levenberg–Marquardt; it usually takes 5 to 10.",
    )
    min_tracks: int = Field(
        6,
        ge=3,
        le=1000,
        description="Least number of tracks for a solve; fewer give a poor covariance.",
    )
    max_translation_sigma_m: float = Field(
        0.25,
        gt=0,
        description="A solve with a larger standard deviation in any direction is degenerate.",
    )
    max_rotation_sigma_rad: float = Field(
        0.02,
        gt=0,
        description="A solve with a larger standard deviation about any axis is degenerate.",
    )

    @property
    def min_tracks_beyond_chance(self) -> int:
        """Number of tracks from which on they hardly agree on a wrong motion by chance.

        It is asked for where a motion is not predicted, where RANSAC has confirmed a minority of
        the tracks, where hardly any fit the predicted noise, and where features are found again
        after a gap. Of 5,500 steps on forty rendered drives (``benchmarks/random_rigs.py``, two
        seeds), RANSAC confirms a minority in five; one of these was 0.4 m off and claimed 9 mm.
        Under a larger noise than predicted, six of eleven tracks agreed on a standstill while the
        car drove 2 m a step. With fewer features found again, one recovery in six was far outside
        of its covariance.
        """
        return 2 * self.min_tracks


class WindowConfig(Settings):
    """Settings of the sliding window, for the estimator of that name."""

    frames: int = Field(
        10,
        ge=2,
        le=100,
        description="Frames that are adjusted together; the time of a step grows with them.",
    )
    correlation: float = Field(
        0.6,
        ge=0,
        lt=1,
        description=(
            "Correlation of a feature's errors in successive frames: 0 is white noise, as of"
            " simulated points; of tracked features, residuals show 0.2 to 0.4 in u and 0.4 to 0.6"
            " in v, and 0.4 to 0.8 give the same drift."
        ),
    )
    max_iterations: int = Field(
        3,
        ge=1,
        le=100,
        description="Most iterations of a frame's adjustment: it starts close to the optimum.",
    )
    imu: Literal["auto", "off"] = Field(
        "auto",
        description=(
            "auto: use gyro and accelerometer, if the recording has both with their calibration and"
            " they agree with the images; off: use the images alone."
        ),
    )


class MotionModelConfig(Settings):
    """The motion prior of the vehicle, a constant velocity with random accelerations.

    It dead-reckons if the features do not determine the motion, and rejects implausible solutions.
    """

    acceleration_m_s2: float = Field(
        5.0, gt=0, description="Standard deviation of the acceleration; a car brakes with 3 to 10."
    )
    angular_acceleration_rad_s2: float = Field(
        2.0,
        gt=0,
        description=(
            "Standard deviation of the angular acceleration of a vehicle; that a rig turns more"
            " suddenly, or accelerates more, is learned on the way."
        ),
    )
    start_speed_m_s: float = Field(
        20.0, gt=0, description="Standard deviation of the speed at the start."
    )
    start_turn_rate_rad_s: float = Field(
        1.0, gt=0, description="Standard deviation of the angular rate at the start."
    )
    stamp_sigma_s: float = Field(
        0.005,
        ge=0,
        le=1000,
        description=(
            "Standard deviation of a frame's time stamp, at most a twentieth of the time between"
            " frames; stamps set by the host computer are off by 5 to 20 ms."
        ),
    )
    gap_factor: float = Field(
        2.5,
        gt=1,
        description="A step longer than this many usual steps has missing frames.",
    )


class GyroConfig(Settings):
    """Settings of the gyro, if the recording has one."""

    prior: bool = Field(
        False,
        description=(
            "Use the rotation of the gyro, with its noise and estimated bias, as a prior in the"
            " solve."
        ),
    )
    prefilter_deg: float = Field(
        0.0,
        ge=0,
        le=180,
        description=(
            "Remove features whose direction differs by more than this from the prediction by the"
            " rotation (of the gyro, if there is one); PROBE takes 5 in place of RANSAC. 0 switches"
            " it off."
        ),
    )


class NorthConfig(Settings):
    """Prior of the first camera's attitude relative to north, for sensors that measure it."""

    heading_deg: float | None = Field(
        None,
        ge=-360,
        le=360,
        description=(
            "Heading of the first camera, clockwise from north; if it is not given, it is estimated"
            " from the first measurements relative to north."
        ),
    )
    heading_sigma_deg: float = Field(
        1.0, gt=0, le=180, description="Standard deviation of that heading."
    )
    tilt_sigma_deg: float = Field(
        3.0,
        gt=0,
        le=90,
        description="Standard deviation of the first camera's tilt; in a car it is within 1 to 2.",
    )


class OdometryConfig(Settings):
    """The settings of ``StereoOdometry``."""

    seed: int = Field(
        0, ge=0, description="Seed of all random choices; equal seeds give the same bytes."
    )
    self_calibration: bool = Field(
        True,
        description="Estimate the row and disparity errors of the rectification during the run.",
    )
    any_camera: bool = Field(
        False,
        description=(
            "Accept a noise model that was learned with another camera, with a warning: errors in"
            " pixels may differ."
        ),
    )
    tracking: TrackingConfig = TrackingConfig()
    ransac: RansacConfig = RansacConfig()
    solver: SolverConfig = SolverConfig()
    estimator: Literal["two-frame", "window"] = Field(
        "window",
        description=(
            "window: the last frames are adjusted together, which drifts least; two-frame: each"
            " motion from its two frames, with the disparities of earlier ones, in two thirds of"
            " the time."
        ),
    )
    window: WindowConfig = WindowConfig()
    motion_model: MotionModelConfig = MotionModelConfig()
    gyro: GyroConfig = GyroConfig()
    north: NorthConfig = NorthConfig()

    @property
    def tracking_of_estimator(self) -> TrackingConfig:
        """The settings of the tracker, with the defaults that depend on the estimator."""
        if self.tracking.max_difference is not None:
            return self.tracking
        return self.tracking.model_copy(
            update={"max_difference": DEFAULT_MAX_DIFFERENCE[self.estimator]}
        )

    @model_validator(mode="after")
    def _check_combinations(self) -> Self:
        if self.gyro.prior and self.solver.method == "alignment":
            raise ValueError(
                "gyro.prior needs solver.method reprojection: the alignment takes no prior"
            )
        if self.ransac.rotation_from == "gyro" and self.ransac.mode == "off":
            raise ValueError(
                "ransac.rotation_from gyro is for samples, and ransac.mode off draws none"
            )
        is_default = self.north.heading_sigma_deg == NorthConfig().heading_sigma_deg
        if self.north.heading_deg is None and not is_default:
            raise ValueError("north.heading_sigma_deg is that of north.heading_deg: give both")
        return self
