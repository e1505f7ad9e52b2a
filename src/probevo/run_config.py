"""Everything that decides what a run does, as one value and one file. Defaults < file < flags."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator
from difflib import get_close_matches
from pathlib import Path
from typing import Self

import yaml
from pydantic import BaseModel, Field, ValidationError, field_validator, model_validator
from pydantic_core import ErrorDetails

from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.sequences.registry import format_names

FORMAT_HELP = (
    f"Layout of the recording: {', '.join(format_names())}; recognised if it is not named."
)


class SharedConfig(OdometryConfig):
    """What runs can have in common, whatever recording and noise model each has: all settings of a
    comparison."""

    format: str | None = Field(None, description=FORMAT_HELP)
    max_frames: int | None = Field(None, ge=2, description="Stop after this many frames.")
    imu: bool = Field(True, description="Use the recording's IMU, if it has one.")

    @field_validator("format")
    @classmethod
    def _check_format(cls, name: str | None) -> str | None:
        if name is not None and name not in format_names():
            raise ValueError("it should be the name of a format")
        return name

    @model_validator(mode="after")
    def _check_imu(self) -> Self:
        if not self.imu and (self.gyro.prior or self.ransac.rotation_from == "gyro"):
            raise ValueError(
                "gyro.prior and ransac.rotation_from gyro need the IMU that no-imu leaves out"
            )
        return self


class RunConfig(SharedConfig):
    """All settings of ``probevo run``: those of the odometry, and what it runs on."""

    sequence: Path | None = Field(
        None, description="The recording: a folder, or a tracks file (.npz)."
    )
    noise: str = Field(
        "student-t",
        description=(
            "Noise of the features: fixed is one Gaussian, student-t forgives outliers, and the"
            " path of a model file (.safetensors) is what was learned."
        ),
    )


OWN_KEYS = ("sequence", "format", "noise", "max_frames", "imu")
"""Settings of the run that are none of the odometry's."""


def run_config(settings: OdometryConfig, sequence: Path, noise: str) -> RunConfig:
    """The settings of one run, from those that several share."""
    shared = {name: getattr(settings, name) for name in type(settings).model_fields}
    return RunConfig.model_validate(shared | {"sequence": sequence, "noise": noise})


def read_config(path: Path) -> RunConfig:
    """The settings of a YAML file, such as the ``config.yaml`` of an earlier run; what it leaves
    out has its default.

    Raises:
        InputError: the file is missing, is not YAML, or has an unknown key or a value out of
            bounds.
    """
    from probevo.sequences.yaml_file import (
        load_yaml,
    )  # here: `probevo run --help` should not wait for OpenCV

    cure = "Take the config.yaml of a run as a pattern."
    content = load_yaml(path, cure)
    if content is not None and not isinstance(content, dict):
        raise InputError(
            path, f"holds a {type(content).__name__}; expected `key: value` lines.", cure
        )
    try:
        return RunConfig.model_validate(content or {})
    except ValidationError as error:
        raise setting_error(error, path) from error


def config_text(config: RunConfig) -> str:
    """The settings as YAML that ``read_config`` reads back as they are."""
    values = config.model_dump(mode="json")
    own_first = {name: values.pop(name) for name in OWN_KEYS} | values
    return yaml.safe_dump(own_first, sort_keys=False, allow_unicode=True)


def setting_error(
    error: ValidationError,
    where: str | Path,
    model: type[BaseModel] = RunConfig,
    spelled: Callable[[str], str] = lambda key: key,
) -> InputError:
    """What pydantic found wrong, in our words: each key at fault with its value, and how to mend
    the first one.

    Args:
        error: of validating a ``model``.
        where: the file, or the kind of input.
        model: the settings.
        spelled: how the user writes a key, if not as ``section.key``.
    """
    unknown_first = sorted(error.errors(), key=lambda fault: fault["type"] != "extra_forbidden")
    faults = [(".".join(map(str, fault["loc"])), fault) for fault in unknown_first]
    texts = [_fault_text(spelled(key) if key else "", fault) for key, fault in faults]
    first, fault = faults[0]
    known = dict(_known_keys(model))
    cure = (
        _nearest_keys(first, known) if fault["type"] == "extra_forbidden" else known.get(first, "")
    )
    return InputError(where, "; ".join(texts) + ".", cure)


def _fault_text(key: str, fault: ErrorDetails) -> str:
    """One fault; without a key it is of several settings that do not go together."""
    if fault["type"] == "extra_forbidden":
        return f"the key {key} is not known"
    message = fault["msg"].removeprefix("Value error, ").replace("Input should", "it should")
    return f"{key} is {fault['input']!r}; {message}" if key else message


def _nearest_keys(key: str, known: Collection[str]) -> str:
    key = key.replace("-", "_")
    last = key.rpartition(".")[2]
    # The right key without its section, or in a wrong one, is nearer than any other spelling.
    near = [name for name in known if name.rpartition(".")[2] == last] or get_close_matches(
        key, known, n=1
    )
    return f"Did you mean {' or '.join(near)}?" if near else f"Known are {', '.join(known)}."


def _known_keys(model: type[BaseModel], prefix: str = "") -> Iterator[tuple[str, str]]:
    """Dotted name and description of each setting."""
    for name, field in model.model_fields.items():
        if isinstance(field.annotation, type) and issubclass(field.annotation, BaseModel):
            yield from _known_keys(field.annotation, f"{prefix}{name}.")
        else:
            yield prefix + name, field.description or ""
