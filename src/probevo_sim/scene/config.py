"""Every setting of a simulated scene, with its bounds and its reason."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from probevo.config.settings import Settings

PresetName = Literal["city", "residential", "road", "rover"]
TruthName = Literal["all", "loop", "none"]


class RigConfig(Settings):
    """The stereo camera and its IMU; by default KITTI's at half the resolution."""

    width_px: int = Field(621, ge=64, le=8192, description="Width of an image.")
    height_px: int = Field(188, ge=48, le=8192, description="Height of an image.")
    focal_px: float = Field(360.0, gt=10, le=20_000, description="Focal length.")
    baseline_m: float = Field(
        0.54, gt=0.001, le=10, description="Distance of the right camera from the left one."
    )
    rate_hz: float = Field(10.0, ge=2, le=1000, description="Frames a second.")
    imu_rate_hz: float = Field(200.0, ge=10, le=10_000, description="IMU samples a second.")
    gyro_noise_rad_s_sqrt_hz: float = Field(
        1.7e-4, gt=0, le=0.1, description="White noise density of the gyro."
    )
    gyro_bias_sigma_rad_s: float = Field(
        2e-3, ge=0, le=0.1, description="Standard deviation of the gyro's bias at the start."
    )
    gyro_bias_walk_rad_s2_sqrt_hz: float = Field(
        2e-5, ge=0, le=0.1, description="Random-walk density of the gyro's bias."
    )
    accel_noise_m_s2_sqrt_hz: float = Field(
        2e-3, gt=0, le=1, description="White noise density of the accelerometer."
    )
    accel_bias_sigma_m_s2: float = Field(
        0.02, ge=0, le=1, description="Standard deviation of the accelerometer's bias at the start."
    )
    accel_bias_walk_m_s3_sqrt_hz: float = Field(
        3e-4, ge=0, le=1, description="Random-walk density of the accelerometer's bias."
    )


class Effects(Settings):
    """Degradations of the images, each from 0, which is off, to 1, which is a bad day."""

    blur: float = Field(
        0.0, ge=0, le=1, description="Motion blur: the shutter is open for 50 ms times this."
    )
    traffic: float = Field(
        0.0, ge=0, le=1, description="Moving cars and people; 1 fills the street."
    )
    shadows: float = Field(
        0.0,
        ge=0,
        le=1,
        description="Darkness of cast shadows: of solids, the own vehicle, leaves in the wind.",
    )
    textureless: float = Field(
        0.0, ge=0, le=1, description="Share of the road's texture that is removed."
    )
    foliage: float = Field(
        0.0,
        ge=0,
        le=1,
        description="Hedges and trees whose leaves repeat and sway; 1 lines the road.",
    )
    exposure: float = Field(
        0.0,
        ge=0,
        le=1,
        description="Changes of the exposure from frame to frame, up to a factor 4.",
    )
    noise: float = Field(
        0.0,
        ge=0,
        le=1,
        description=(
            "Sensor noise: 1 is a standard deviation of 12 grey levels in the middle of the range,"
            " less in the dark."
        ),
    )
    rectification: float = Field(
        0.0,
        ge=0,
        le=1,
        description=(
            "Rectification error: 1 rotates the right camera so that corners are off by about 1 px."
        ),
    )
    rolling_shutter: float = Field(
        0.0,
        ge=0,
        le=1,
        description=(
            "Rolling shutter: the last row of an image is exposed 60 ms times this after the first;"
            " a frame has the time and the true pose of the middle row."
        ),
    )


class Daylight(Settings):
    """Where the sun stands, and what it does to the sky."""

    azimuth_deg: float | None = Field(
        None,
        ge=-360,
        le=360,
        description=(
            "Azimuth of the sun, clockwise from the direction in which the drive starts; left out,"
            " it is behind the camera."
        ),
    )
    elevation_deg: float = Field(
        34.377467707849394, ge=15, le=85, description="Height of the sun above the horizon."
    )
    glow: float = Field(
        0.0,
        ge=0,
        le=1,
        description="Brightness of the sun's disk and of the sky around it; 0 is an even sky.",
    )


class SceneConfig(Settings):
    """A drive through a simulated place.

    The same settings give the same bytes on one machine.
    """

    preset: PresetName = Field("city", description="The place, like those of the papers.")
    seed: int = Field(0, ge=0, description="Seed of the place: another seed is another city.")
    drive: int = Field(
        0,
        ge=0,
        description="Number of the drive: another one drives the same place with other noise.",
    )
    distance_m: float | None = Field(
        None,
        gt=1,
        le=5000,
        description=(
            "Distance to drive, m; by default what suits the preset. The rover drives a loop of"
            " this length."
        ),
    )
    carried: float = Field(
        0.0,
        ge=0,
        le=1,
        description=(
            "How much the rig sways if a person or a drone carries it, at walking pace, instead of"
            " a vehicle, which is 0; 1 turns it by about 125 °/s rms, 100 of them in yaw."
        ),
    )
    truth: TruthName = Field(
        "all",
        description=(
            "True poses to give away: those of all frames, only the first and last of the rover's"
            " loop, or none."
        ),
    )
    rig: RigConfig = RigConfig()
    effects: Effects = Effects()
    daylight: Daylight = Daylight()
