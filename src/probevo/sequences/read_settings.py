"""How a recording is opened: its format, and the options of that format."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from pydantic import Field, field_validator

from probevo.config.settings import Settings
from probevo.sequences.registry import format_names

FORMAT_HELP = (
    f"Layout of the recording: {', '.join(format_names())}; recognised if it is not named."
)


class TopicSettings(Settings):
    """Which topics of a bag are read; those that are unique need not be named."""

    left: str | None = Field(None, description="Images of the left camera.")
    right: str | None = Field(None, description="Images of the right camera.")
    left_info: str | None = Field(None, description="CameraInfo of the left camera.")
    right_info: str | None = Field(None, description="CameraInfo of the right camera.")
    imu: str | None = Field(None, description="Samples of the IMU.")
    truth: str | None = Field(
        None,
        description=(
            "True poses: Odometry, PoseStamped, PoseWithCovarianceStamped, TransformStamped or tf;"
            " a topic called ground_truth is used automatically."
        ),
    )


class ReadSettings(Settings):
    """How a recording is opened: its format, and the options of that format."""

    format: str | None = Field(None, description=FORMAT_HELP)
    calibration: Path | None = Field(
        None,
        description=(
            "Calibration of the cameras, instead of the recording's own, for folders, bags, videos"
            " and EuRoC's layout: a file of Kalibr, OpenCV, ROS, VINS-Fusion or ORB-SLAM3. It"
            " rectifies the images. Four coefficients of OpenCV are those of cv2.fisheye if its key"
            " distortion_model is fisheye, and else of ordinary lenses."
        ),
    )
    imu_noise: Path | None = Field(
        None, description="Noise of the IMU, for folders and bags: Kalibr's imu.yaml."
    )
    truth: Path | None = Field(
        None, description="True poses of a folder or bag: a file in TUM's format."
    )
    truth_of: str | None = Field(
        None,
        description=(
            "Body whose poses --truth or --topics.truth gives: camera (rectified, left), imu, or a"
            " frame of the bag's tf_static."
        ),
    )
    rate_hz: float | None = Field(
        None, description="Frames a second of a recording without any times."
    )
    resized: bool = Field(
        False,
        description=(
            "The images of a folder, bag, video or EuRoC's layout have been scaled since they were"
            " calibrated: scale the calibration, too."
        ),
    )
    pair_tolerance_ms: float | None = Field(
        None,
        gt=0.0,
        description=(
            "Largest time between the two images of a pair, where a bag, the data.csv of EuRoC's"
            " layout, or stamps as the names of a folder's images pair them; 2 ms by default."
        ),
    )
    scene: int | None = Field(
        None, ge=0, description="Number of the scene of KITTI 2012 or 2015, stereo or flow."
    )
    topics: TopicSettings = Field(TopicSettings(), description="Topics of a bag.")
    mask_left: Path | None = Field(
        None,
        description=(
            "Mask of the left images, black where no feature is wanted, such as on a bonnet: an"
            " image, or a folder with one for each frame. By default mask_left.png or mask_left/ in"
            " the folder of the recording, if there is one."
        ),
    )
    mask_right: Path | None = Field(None, description="The same for the right images.")

    @field_validator("format")
    @classmethod
    def _check_format(cls, name: str | None) -> str | None:
        if name is not None and name not in format_names():
            raise ValueError("it should be the name of a format")
        return name

    def format_options(self) -> dict[str, Any]:
        """Return the options for ``open_sequence``: those that the user gave, by name.

        An option that the format of the recording does not have is refused there.
        """
        own = {
            "calibration": self.calibration,
            "imu_noise": self.imu_noise,
            "truth": self.truth,
            "truth_of": self.truth_of,
            "rate_hz": self.rate_hz,
            "resized": self.resized or None,
            "pair_tolerance_ms": self.pair_tolerance_ms,
            "scene": self.scene,
            "mask_left": self.mask_left,
            "mask_right": self.mask_right,
        }
        topics = {f"topics_{name}": value for name, value in self.topics}
        return {name: value for name, value in (own | topics).items() if value is not None}
