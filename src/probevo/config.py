"""Every setting of the odometry, with its bounds and its why. Defaults < file < flags."""

from __future__ import annotations

from typing import Literal, Self

from pydantic import Field, model_validator

from probevo.settings import Settings


class TrackingConfig(Settings):
    """Detection and Lucas–Kanade tracking."""

    num_features: int = Field(
        600,
        ge=8,
        le=20_000,
        description="Features wanted a frame; more cost time, few gain beyond 600.",
    )
    fast_threshold: int = Field(
        10,
        ge=1,
        le=100,
        description="Contrast of a FAST corner; low, as the grid ranks them anyway.",
    )
    window_px: int = Field(
        11,
        ge=5,
        le=51,
        description=(
            "Side of the Lucas–Kanade window; 11 tracks as well as 21 at a third of the time."
        ),
    )
    pyramid_levels: int = Field(
        3,
        ge=0,
        le=8,
        description=(
            "Pyramid levels above the image; 3 find what lies 40 px from where it is expected."
        ),
    )
    high_pass_px: int = Field(
        41,
        ge=0,
        le=201,
        description=(
            "Side of the box whose mean is taken off the image, against vignetting and exposure; 0"
            " is off."
        ),
    )
    max_difference: float = Field(
        6.0,
        gt=0,
        le=255,
        description=(
            "Mean difference of two windows, in grey levels, up to which they look the same."
        ),
    )
    max_row_offset_px: float = Field(
        2.5,
        gt=0,
        le=50,
        description=(
            "Stereo matches further apart in rows are wrong; real rectification errors reach 2 px."
        ),
    )
    min_disparity_px: float = Field(
        0.0,
        ge=-5,
        le=50,
        description=(
            "Stereo matches with less disparity are wrong; far points carry rotation, so 0."
        ),
    )


class RansacConfig(Settings):
    """Random sample consensus for the first guess, and to reject outliers."""

    threshold_px: float = Field(
        3.0,
        gt=0,
        le=100,
        description="Reprojection error within which a feature agrees with a motion.",
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
        "points", description="Three points fix a motion; with the gyro's rotation one does."
    )
    mode: Literal["reject", "guess", "off"] = Field(
        "reject",
        description=(
            "What comes of it: keep outliers from the solve, or only the first guess, or do without"
            " it (PROBE): the solve starts from the expected rotation and the median shift of near"
            " points."
        ),
    )


class SolverConfig(Settings):
    """Reprojection solve and what counts as a result."""

    method: Literal["reprojection", "alignment"] = Field(
        "reprojection",
        description=(
            "Minimise reprojection errors (PROBE-GK), or align triangulated points, each with its"
            " covariance (PROBE), which far points bias."
        ),
    )
    loss: Literal["noise", "l2", "huber", "cauchy", "tukey"] = Field(
        "noise",
        description=(
            "Robust loss of the reprojection solve; `noise` takes the likelihood of the noise model"
            " itself."
        ),
    )
    max_iterations: int = Field(
        20, ge=1, le=1000, description="Of Levenberg–Marquardt; it takes 5 to 10."
    )
    min_tracks: int = Field(
        6, ge=3, le=1000, description="With fewer features a motion is not worth its covariance."
    )
    max_translation_sigma_m: float = Field(
        0.25, gt=0, description="A solve less sure of any direction than this is degenerate."
    )
    max_rotation_sigma_rad: float = Field(
        0.02, gt=0, description="A solve less sure of any axis than this is degenerate."
    )


class MotionModelConfig(Settings):
    """What is known of the vehicle: carries motion on where the camera is blind, and exposes
    impossible results."""

    acceleration_m_s2: float = Field(
        5.0, gt=0, description="Standard deviation of the acceleration; a car brakes with 3 to 10."
    )
    angular_acceleration_rad_s2: float = Field(
        2.0, gt=0, description="Standard deviation of the angular acceleration."
    )
    start_speed_m_s: float = Field(
        20.0, gt=0, description="Standard deviation of the unknown speed at start."
    )
    start_turn_rate_rad_s: float = Field(
        1.0, gt=0, description="Standard deviation of the unknown turn rate at start."
    )
    stamp_sigma_s: float = Field(
        0.005,
        ge=0,
        description=(
            "Standard deviation of a frame's stamp; those that a computer gives are off by 5 to"
            " 20 ms."
        ),
    )
    gap_factor: float = Field(
        2.5, gt=1, description="A step longer than this many usual ones misses frames."
    )


class GyroConfig(Settings):
    """Use of the gyro, where there is one."""

    prior: bool = Field(
        False,
        description=(
            "Let the gyro's rotation, with its noise and the estimated bias, enter the solve."
        ),
    )
    prefilter_deg: float = Field(
        0.0,
        ge=0,
        le=180,
        description=(
            "Drop features whose direction turns by more than this against the expected rotation,"
            " the gyro's if there is one; PROBE takes 5 where it does without RANSAC. 0 is off."
        ),
    )


class OdometryConfig(Settings):
    """All settings of ``StereoOdometry``."""

    seed: int = Field(
        0, ge=0, description="Of all random choices; equal seeds give the same bytes."
    )
    self_calibration: bool = Field(
        True, description="Learn the row and disparity errors of the rectification on the way."
    )
    tracking: TrackingConfig = TrackingConfig()
    ransac: RansacConfig = RansacConfig()
    solver: SolverConfig = SolverConfig()
    motion_model: MotionModelConfig = MotionModelConfig()
    gyro: GyroConfig = GyroConfig()

    @model_validator(mode="after")
    def _check_gyro_prior(self) -> Self:
        if self.gyro.prior and self.solver.method == "alignment":
            raise ValueError(
                "gyro.prior needs solver.method reprojection: the alignment takes no prior"
            )
        return self
