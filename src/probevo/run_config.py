"""All settings of a run, as one value and as one YAML file.

Flags of the command line override the file, and the file overrides the defaults.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping
from difflib import get_close_matches
from pathlib import Path
from typing import Any, Self, TypeVar

import yaml
from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from probevo.config import OdometryConfig
from probevo.errors import InputError, brief
from probevo.sequences.registry import format_names
from probevo.settings import Settings

FORMAT_HELP = (
    f"Layout of the recording: {', '.join(format_names())}; recognised if it is not named."
)

SettingsType = TypeVar("SettingsType", bound=Settings)

MAX_FAULTS = 8
"""Wrong settings that a message names."""


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


def checked_settings(
    value: object, model: type[SettingsType], *, example: str, name: str = "config"
) -> SettingsType:
    """Return settings given as themselves, as a dictionary of those that differ, or as None.

    Args:
        value: an argument of a function.
        model: the settings that it may be.
        example: a dictionary as the caller may write it, for messages.
        name: of the argument.

    Raises:
        InputError: it is something else, a key is unknown, or a value is out of bounds.
    """
    if value is None:
        return model()
    if isinstance(value, model):
        return value
    if not isinstance(value, Mapping):
        article = "an" if model.__name__[0] in "AEIOU" else "a"
        cure = f"Give {article} {model.__name__}, or a dict such as {example}."
        raise InputError(name, f"is {brief(value)}.", cure)
    try:
        return model.model_validate(dict(value))
    except ValidationError as error:
        raise setting_error(error, name, model) from error


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
        raise setting_error(error, path) from error


def config_text(config: RunConfig) -> str:
    """Return the settings as YAML; ``read_config`` reads back the same settings."""
    values = config.model_dump(mode="json")
    own_first = {name: values.pop(name) for name in OWN_KEYS} | values
    return yaml.safe_dump(own_first, sort_keys=False, allow_unicode=True)


def setting_error(
    error: ValidationError,
    where: str | Path,
    model: type[BaseModel] = RunConfig,
    spelled: Callable[[str], str] = lambda key: key,
) -> InputError:
    """Return pydantic's findings as one error: each wrong key with its value, and a cure.

    The cure concerns the first key; unknown keys come first.

    Args:
        error: raised by validating a ``model``.
        where: the file, or the kind of input.
        model: the settings that were validated.
        spelled: returns a key, ``section.key``, as the user writes it.
    """
    unknown_first = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    faults = [(".".join(map(str, fault["loc"])), fault) for fault in unknown_first]
    # Of a list with a wrong item, pydantic also says that it has too few right ones.
    keys = [key for key, _ in faults]
    faults = [
        (key, fault)
        for key, fault in faults
        if fault["type"] != "too_short" or not any(other.startswith(f"{key}.") for other in keys)
    ]
    texts = [_fault_text(spelled(key) if key else "", fault) for key, fault in faults[:MAX_FAULTS]]
    if len(faults) > MAX_FAULTS:
        texts.append(f"and {len(faults) - MAX_FAULTS} more")

    known = dict(_known_keys(model))
    first_key, first_fault = faults[0]
    if first_fault["type"] == "extra_forbidden":
        is_dotted = any("." in str(part) for part in first_fault["loc"])
        cure = _nearest_keys(first_key, known, is_dotted=is_dotted)
    else:
        cure = known.get(first_key, "") or known.get(first_key.rpartition(".")[0], "")
    return InputError(where, "; ".join(texts) + ".", cure)


def _fault_text(key: str, fault: ErrorDetails) -> str:
    """Return one fault in words; it has no key if several settings contradict each other."""
    if fault["type"] == "extra_forbidden":
        return f"the key {brief(key)[1:-1]} is not known"
    message = fault["msg"].removeprefix("Value error, ").replace("Input should", "it should")
    return f"{key} is {brief(fault['input'])}; {message}" if key else message


def _nearest_keys(key: str, known: Collection[str], *, is_dotted: bool) -> str:
    """Return the cure of an unknown key: the nearest ones, as they are nested if it was written
    with dots; or all."""
    key = key.replace("-", "_")
    last = key.rpartition(".")[2]
    # The right key in a wrong section, or in none, is nearer than any other spelling.
    near = [name for name in known if name.rpartition(".")[2] == last]
    if not near:
        near = get_close_matches(key, known, n=1)
    if is_dotted and key in known:
        return f"Nest it: {_nested(key)}."
    if is_dotted:
        near = [_nested(name) for name in near]
    return f"Did you mean {' or '.join(near)}?" if near else f"Known are {', '.join(known)}."


def _nested(key: str) -> str:
    """Return ``section.key`` as YAML has it: ``section: {key: …}``."""
    *sections, last = key.split(".")
    text = f"{last}: …"
    for section in reversed(sections):
        text = f"{section}: {{{text}}}"
    return text


def _known_keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Yield the dotted name and the description of each setting."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _known_keys(field.annotation, f"{prefix}{name}.")
        else:
            yield prefix + name, field.description or ""
