"""The options of the formats.

This module imports no reader, so that the command line starts fast.
"""

from __future__ import annotations

from pathlib import Path

from pydantic import Field

from probevo.config.settings import Settings

PAIR_TOLERANCE_MS = 2.0
"""Cameras with a common trigger differ by less, even if each is stamped on arrival; at 10 m/s the
vehicle drives 2 cm in this time."""


SIMULATED_RATE_HZ = 10.0
"""Frame rate of rendered data sets whose files have no times: TartanAir 2 was sampled at this rate,
and the drives that Virtual KITTI imitates were recorded at it."""


KITTI_FLOW_RATE_HZ = 10.0
"""Frame rate of the scenes of KITTI 2012 and 2015, which have no times; KITTI's cameras run at
about this."""


LEAST_RATE_HZ = 0.001
MOST_RATE_HZ = 100_000.0
"""Beyond these, times in whole nanoseconds would not fit in 64 bits, or not ascend."""
RATES = "0.001 to 100,000"


class RosbagOptions(Settings):
    """The options of the format rosbag."""

    topics_left: str | None = Field(None, description="Name a topic of images.")
    topics_right: str | None = Field(None, description="Name a topic of images.")
    topics_imu: str | None = Field(None, description="Name a topic of IMU samples.")
    topics_truth: str | None = Field(None, description="Name a topic of poses.")
    topics_left_info: str | None = Field(None, description="Name a topic of CameraInfo.")
    topics_right_info: str | None = Field(None, description="Name a topic of CameraInfo.")
    pair_tolerance_ms: float = Field(
        PAIR_TOLERANCE_MS,
        gt=0.0,
        description="The largest time between the images of a pair is positive.",
    )
    calibration: Path | None = Field(
        None, description="Name a calibration file of Kalibr, OpenCV or VINS-Fusion."
    )
    resized: bool = Field(
        False, description="The images have been scaled since they were calibrated."
    )
    imu_noise: Path | None = Field(None, description="Name a file such as Kalibr's imu.yaml.")
    truth: Path | None = Field(None, description="Name a file of true poses in TUM's format.")
    truth_of: str | None = Field(
        None, description="Name the frame of the true poses: camera, imu, or one of tf_static."
    )


class FolderOptions(Settings):
    """The options of the format folder."""

    calibration: Path | None = Field(
        None, description="Name a calibration file of Kalibr, OpenCV or VINS-Fusion."
    )
    resized: bool = Field(
        False, description="The images have been scaled since they were calibrated."
    )
    imu_noise: Path | None = Field(None, description="Name a file such as Kalibr's imu.yaml.")
    truth: Path | None = Field(None, description="Name a file of true poses in TUM's format.")
    truth_of: str | None = Field(
        None, description="Name the frame of the true poses: camera or imu."
    )
    rate_hz: float | None = Field(
        None,
        ge=LEAST_RATE_HZ,
        le=MOST_RATE_HZ,
        description=f"Frames a second of a folder without any times: {RATES}.",
    )
    pair_tolerance_ms: float = Field(
        PAIR_TOLERANCE_MS,
        gt=0.0,
        description="The largest time between the images of a pair is positive.",
    )


class PairOptions(Settings):
    """The options of formats whose image files are paired by their stamps."""

    pair_tolerance_ms: float = Field(
        PAIR_TOLERANCE_MS,
        gt=0.0,
        description="The largest time between the images of a pair is positive.",
    )


class EurocOptions(PairOptions):
    """The options of the format euroc."""

    calibration: Path | None = Field(
        None, description="Name a calibration file of Kalibr, OpenCV or VINS-Fusion."
    )
    resized: bool = Field(
        False, description="The images have been scaled since they were calibrated."
    )


BAG_SUFFIXES = (".bag", ".mcap", ".db3")
"""Endings of the bags of ROS 1, and of the two storages of ROS 2."""
VIDEO_SUFFIXES = (".mp4", ".avi", ".mkv", ".mov")


class VideoOptions(Settings):
    """The options of the format video."""

    calibration: Path | None = Field(
        None, description="Name a calibration file of Kalibr, OpenCV or VINS-Fusion."
    )
    resized: bool = Field(
        False, description="The images have been scaled since they were calibrated."
    )
    rate_hz: float | None = Field(
        None, ge=LEAST_RATE_HZ, le=MOST_RATE_HZ, description=f"Frames a second: {RATES}."
    )


class RateOptions(Settings):
    """The options of formats whose files have no times."""

    rate_hz: float | None = Field(
        None, ge=LEAST_RATE_HZ, le=MOST_RATE_HZ, description=f"Frames a second: {RATES}."
    )


class KittiFlowOptions(RateOptions):
    """The options of the format kitti-flow."""

    scene: int | None = Field(None, ge=0, description="Number of the scene, such as 27.")


def rate_note(rate_hz: float | None) -> str:
    """Return which rate the frames of a format have whose files hold no times."""
    if rate_hz is None:
        return f"no file has times: taken as {SIMULATED_RATE_HZ:g} Hz; --rate-hz gives another rate"
    return f"no file has times: {rate_hz:g} Hz, of --rate-hz"
