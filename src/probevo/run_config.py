"""All settings of a run, as one value and as one YAML file.

Flags of the command line override the file, and the file overrides the defaults.
"""

from __future__ import annotations

from pathlib import Path
from typing import Self

import yaml
from pydantic import Field, ValidationError, field_validator, model_validator

from probevo.config import OdometryConfig
from probevo.config.settings import Settings
from probevo.config.validation import checked_settings, setting_error
from probevo.errors import InputError
from probevo.sequences.read_settings import ReadSettings

OPTICAL_IN_BASE = (
    *(0.0, 0.0, 1.0, 0.0),
    *(-1.0, 0.0, 0.0, 0.0),
    *(0.0, -1.0, 0.0, 0.0),
    *(0.0, 0.0, 0.0, 1.0),
)
"""T_base_cam of a camera that looks ahead from the origin of ``base_link``, row by row: REP-103 has
bodies with x forward, y left, z up, and optical frames with x right, y down, z forward."""
ROTATION_TOLERANCE = 1e-6
"""Largest deviation of a rotation's rows from unit length and right angles."""


class RosSettings(Settings):
    """Frames of the odometry that is written as a bag (REP-103, REP-105)."""

    odom_frame: str = Field("odom", description="World: base_frame at the first image.")
    base_frame: str = Field("base_link", description="Body: x forward, y left, z up.")
    camera_frame: str = Field(
        "camera_left_optical", description="Rectified left camera: x right, y down, z forward."
    )
    T_base_cam: tuple[float, ...] = Field(
        OPTICAL_IN_BASE,
        min_length=16,
        max_length=16,
        description=(
            "Pose of the rectified left camera in base_frame, 4×4 row by row, m; by default it"
            " looks ahead from the origin of base_frame."
        ),
    )

    @field_validator("T_base_cam")
    @classmethod
    def _check_transform(cls, values: tuple[float, ...]) -> tuple[float, ...]:
        x, y, z = (values[4 * k : 4 * k + 3] for k in range(3))
        # The rows of a rotation: unit length, right angles, and the third is x × y.
        across = tuple(x[k - 2] * y[k - 1] - x[k - 1] * y[k - 2] for k in range(3))
        lengths = [abs(_dot(row, row) - 1.0) for row in (x, y, z)]
        differences = [abs(found - wanted) for found, wanted in zip(across, z, strict=True)]
        error = max(*lengths, *differences, abs(_dot(x, y)))
        if values[12:] != (0.0, 0.0, 0.0, 1.0) or not error < ROTATION_TOLERANCE:
            raise ValueError("it should be a rigid transform: [C, t; 0 0 0 1], row by row")
        return values


def _dot(one: tuple[float, ...], other: tuple[float, ...]) -> float:
    return sum(a * b for a, b in zip(one, other, strict=True))


class CommonRunSettings(ReadSettings, OdometryConfig):
    """The settings that the runs of a comparison share; ``RunConfig`` adds recording and noise."""

    max_frames: int | None = Field(None, ge=2, description="Stop after this many frames.")
    imu: bool = Field(True, description="Use the recording's IMU, if it has one.")

    @model_validator(mode="after")
    def _check_imu(self) -> Self:
        if not self.imu and (self.gyro.prior or self.ransac.rotation_from == "gyro"):
            raise ValueError(
                "gyro.prior and ransac.rotation_from gyro need the IMU, which no-imu switches off"
            )
        return self


class RunConfig(CommonRunSettings):
    """All settings of ``probevo run``: those of the odometry, the recording and the noise model."""

    sequence: Path | None = Field(
        None, description="The recording: a folder, or a tracks file (.npz)."
    )
    noise: str = Field(
        "student-t",
        description=(
            "Noise of the features: fixed (one Gaussian for all), student-t (robust to outliers),"
            " or the path of a learned model (.safetensors)."
        ),
    )
    sensor: tuple[Path, ...] = Field(
        (),
        description=(
            "Learned sensors beside the camera: files of `probevo train --kind rotation`,"
            " `correction` or `sun` (extra nets)."
        ),
    )
    camera_height_m: float | None = Field(
        None,
        gt=0.0,
        le=100.0,
        description=(
            "Measured height of the left camera above the ground. It serves to check the baseline,"
            " and changes no result."
        ),
    )
    write: Path | None = Field(
        None,
        description=(
            "Also write the odometry as a bag: a file .mcap or .db3 of ROS 2, or .bag of ROS 1. Of"
            " files that exist, only the odometry of an earlier run is replaced."
        ),
    )
    ros: RosSettings = Field(RosSettings(), description="Frames of that bag.")
    viewer: Path | None = Field(
        None,
        description=(
            "Also write a file .rrd for the Rerun viewer (extra viewer). Without a file, or with"
            " `window`: open its window."
        ),
    )


OWN_KEYS = (
    "sequence",
    "format",
    "noise",
    "sensor",
    "camera_height_m",
    "max_frames",
    "imu",
    "calibration",
    "imu_noise",
    "truth",
    "truth_of",
    "rate_hz",
    "resized",
    "pair_tolerance_ms",
    "scene",
    "topics",
    "mask_left",
    "mask_right",
    "write",
    "ros",
    "viewer",
)
"""The settings of a run that ``OdometryConfig`` does not have."""


def run_config(settings: OdometryConfig, sequence: Path, noise: str) -> RunConfig:
    """Return the settings of one run: common ones, a recording and a noise model."""
    common = {name: getattr(settings, name) for name in type(settings).model_fields}
    return RunConfig.model_validate(common | {"sequence": sequence, "noise": noise})


def as_run_config(config: object) -> RunConfig:
    """Return settings given as themselves, or as a dictionary of those that differ.

    Args:
        config: None for the defaults; ``{"noise": "fixed", "max_frames": 100}``.

    Raises:
        InputError: it is something else, a key is unknown, or a value is out of bounds.
    """
    return checked_settings(config, RunConfig, example="{'noise': 'fixed'}")


def read_config(path: Path) -> RunConfig:
    """Read settings from a YAML file, such as the ``config.yaml`` of an earlier run.

    Settings that the file does not name have their defaults.

    Raises:
        InputError: the file is missing, is not YAML, has an unknown key, or a value is out of
            bounds.
    """
    # Only now: `probevo run --help` should not wait for OpenCV.
    from probevo.sequences.yaml_file import load_yaml

    cure = "Take the config.yaml of a run as a pattern."
    content = load_yaml(path, cure)
    if content is not None and not isinstance(content, dict):
        what = f"holds a {type(content).__name__}; expected `key: value` lines."
        raise InputError(path, what, cure)
    try:
        return RunConfig.model_validate(content or {})
    except ValidationError as error:
        raise setting_error(error, path, RunConfig) from error


def config_text(config: RunConfig) -> str:
    """Return the settings as YAML; ``read_config`` reads back the same settings."""
    values = config.model_dump(mode="json")
    own_first = {name: values.pop(name) for name in OWN_KEYS} | values
    return yaml.safe_dump(own_first, sort_keys=False, allow_unicode=True)
