"""Every setting of the point world, with its bounds and its reason."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.config.settings import Settings

LawName = Literal["constant", "row", "column", "radius", "disparity", "heavy-tailed"]


class PointCamera(Settings):
    """The stereo camera: two pinhole cameras whose optical axes meet the middle of the images."""

    width_px: int = Field(640, ge=16, le=16_384, description="Width of an image.")
    height_px: int = Field(
        480, ge=16, le=16_384, description="Height of an image; tall, so that rows differ."
    )
    focal_px: float = Field(
        400.0, gt=1, le=100_000, description="Focal length; 400 px see 77° across."
    )
    baseline_m: float = Field(
        0.5, gt=0.001, le=100, description="Distance of the right camera from the left one."
    )
    nearest_m: float = Field(
        2.0, ge=0.1, le=10, description="Nearer landmarks are not seen: they leave too fast."
    )
    farthest_m: float = Field(
        40.0, gt=10, le=10_000, description="Farther landmarks are not seen: they look too small."
    )


class PointNoise(Settings):
    """Noise of the observations: zero-mean, with σ from low to high along what the law names."""

    law: LawName = Field(
        "row",
        description=(
            "What σ depends on. It is low at the bottom and high at the top (row), left to right"
            " (column), from the centre to the corners (radius), far to near (disparity), or in the"
            " middle of its range everywhere (constant; heavy-tailed, which is Student-t)."
        ),
    )
    sigma_low_px: float = Field(
        0.05, ge=0, le=1000, description="σ of a coordinate where it is lowest."
    )
    sigma_high_px: float = Field(
        1.0,
        ge=0,
        le=1000,
        description=(
            "σ of a coordinate where it is highest: far above the lowest, so that no single σ fits;"
            " from 1.2 px on, the shipped noise models begin to refuse steps."
        ),
    )
    correlation: float = Field(
        0.0,
        ge=-1,
        le=1,
        description="Correlation of left and right errors, such as those of a drifting track.",
    )
    dof: float | None = Field(
        None,
        gt=2,
        le=1e6,
        description=(
            "Make the errors of any law Student-t with these degrees of freedom and the same"
            " covariance, which exists above 2."
        ),
    )


class PointOutliers(Settings):
    """Landmarks with a uniform error on top of the noise.

    It is drawn anew in each frame, for each of the four coordinates.
    """

    fraction: float = Field(
        0.1,
        ge=0,
        le=1,
        description=(
            "Share of the landmarks, rounded to a whole landmark; PROBE-GK has a small subset."
        ),
    )
    range_px: float = Field(
        10.0, ge=0, le=1000, description="Largest uniform error of a coordinate."
    )


class PointConfig(Settings):
    """A stereo camera on a circle among random landmarks (PROBE-GK; thesis 1.5.3).

    The same settings give the same bytes.
    """

    seed: int = Field(0, ge=0, description="Seed of landmarks, outliers and noise.")
    train_s: float = Field(
        30.0, gt=0, le=3600, description="Duration of the drive to train on: 90 m, once around."
    )
    test_s: float = Field(
        60.0, gt=0, le=3600, description="Duration of the drive to test on: 180 m, twice around."
    )
    rate_hz: float = Field(10.0, ge=0.5, le=200, description="Frames a second.")
    speed_m_s: float = Field(
        3.0, ge=0, le=100, description="Speed along the circle; PROBE-GK drives 3 m/s."
    )
    radius_m: float = Field(
        14.3, ge=0.5, le=100_000, description="Radius of the circle; once around is 90 m."
    )
    landmarks: int = Field(
        2000, ge=1, le=100_000, description="Points in the world; PROBE-GK has 2,000."
    )
    height_m: float = Field(
        10.0, ge=0, le=1000, description="Landmarks lie up to this far above and below the camera."
    )
    camera: PointCamera = PointCamera()
    noise: PointNoise = PointNoise()
    outliers: PointOutliers = PointOutliers()
