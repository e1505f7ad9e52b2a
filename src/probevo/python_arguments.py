"""Checks and conversions of the arguments of the Python interface."""

from __future__ import annotations

from collections.abc import Iterable
from numbers import Integral
from pathlib import Path
from typing import Any, cast

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.config import OdometryConfig
from probevo.config.validation import checked_settings
from probevo.errors import InputError, brief
from probevo.noise import NoiseModel, StudentT
from probevo.noise.named import noise_model
from probevo.predictors import PredictionSpace
from probevo.sequences.base import Sequence
from probevo.sequences.imu_calibration import ImuCalibration


def as_path(value: object, name: str) -> Path:
    """Return a path given as ``str`` or ``Path``.

    Raises:
        InputError: it is something else.
    """
    if not isinstance(value, str | Path):
        raise InputError(name, f"is {brief(value)}.", "Give a path, str or Path.")
    return Path(value)


def as_camera(camera: object) -> StereoCamera:
    """Return the camera if it is one that can be used.

    Raises:
        InputError: it is something else, or a value of it is impossible.
    """
    if not isinstance(camera, StereoCamera):
        cure = "Give a StereoCamera, such as sequence.camera."
        raise InputError("camera", f"is {brief(camera)}.", cure)
    check_camera(camera, "camera")
    return camera


def as_imu(imu: object) -> ImuCalibration | None:
    """Return the calibration of an IMU; None for no IMU.

    Raises:
        InputError: it is something else.
    """
    if imu is None or isinstance(imu, ImuCalibration):
        return imu
    raise InputError("imu", f"is {brief(imu)}.", "Give an ImuCalibration, such as sequence.imu.")


def as_noise(noise: object) -> NoiseModel:
    """Return a noise model given as itself, by its name, or by the path of its file.

    Args:
        noise: None for the static Student-t.

    Raises:
        InputError: it is no noise model, the name is unknown, or the file holds no model.
    """
    if noise is None:
        return StudentT()
    if isinstance(noise, str | Path):
        return noise_model(str(noise))
    members = ("columns", "predict", "check_camera")
    if isinstance(noise, type) or not all(hasattr(noise, member) for member in members):
        cure = "Give a noise model, a name such as 'student-t', or the path of a model file."
        raise InputError("noise", f"is {brief(noise)}.", cure)
    return cast(NoiseModel, noise)


def as_predictors(predictors: object) -> PredictionSpace | None:
    """Return a prediction space; None for that of the noise model.

    Raises:
        InputError: it is something else, such as a list of predictors.
    """
    if predictors is None or isinstance(predictors, PredictionSpace):
        return predictors
    cure = "Give a PredictionSpace, such as probevo.predictors.prediction_space(['blur', 'age'])."
    raise InputError("predictors", f"is {brief(predictors)}.", cure)


def as_sensors(sensors: object) -> tuple[Any, ...]:
    """Return several sensors, which are checked one by one later.

    Raises:
        InputError: it is one sensor, or none at all.
    """
    if not isinstance(sensors, Iterable):
        cure = "Give a list, such as sensors=[compass]; without any, leave it out."
        raise InputError("sensors", f"is {brief(sensors)}.", cure)
    return tuple(sensors)


def as_sequence(sequence: object) -> Sequence:
    """Return a recording, by whichever class it is one.

    Raises:
        InputError: it is something else, such as a path, or a list of frames.
    """
    members = ("path", "format", "camera", "imu", "stamps_ns", "truth", "__len__", "__iter__")
    if isinstance(sequence, type) or not all(hasattr(sequence, member) for member in members):
        cure = f"Give a Sequence, such as open_sequence(path); it has {', '.join(members)}."
        raise InputError("sequence", f"is {brief(sequence)}.", cure)
    return cast(Sequence, sequence)


def as_seed(seed: object) -> int:
    """Return a seed of random choices.

    Raises:
        InputError: it is no whole number, or negative.
    """
    if not isinstance(seed, Integral) or seed < 0:
        raise InputError("seed", f"is {brief(seed)}.", "Give a whole number from 0 on.")
    return int(seed)


def as_config(config: object) -> OdometryConfig:
    """Return settings given as themselves, or as a dictionary of those that differ.

    Args:
        config: None for the defaults; ``{"tracking": {"num_features": 800}}``.

    Raises:
        InputError: it is something else, a key is unknown, or a value is out of bounds.
    """
    example = "{'tracking': {'num_features': 800}}"
    return checked_settings(config, OdometryConfig, example=example)


def as_finite_array(value: object, name: str, shape: tuple[int | None, ...]) -> FloatArray:
    """Return an array of finite numbers.

    Args:
        value: an array, or nested lists.
        name: of the argument, for messages.
        shape: its shape, None where any length will do.

    Raises:
        InputError: it has another shape, or an entry is no finite number.
    """
    given: Any = value
    try:
        array = np.array(given, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise InputError(name, f"is not an array of numbers ({error}).") from error
    fits = array.ndim == len(shape) and all(
        wanted in (None, length) for wanted, length in zip(shape, array.shape, strict=True)
    )
    if not fits:
        wanted = ", ".join("N" if length is None else str(length) for length in shape)
        raise InputError(name, f"has shape {array.shape}.", f"Expected [{wanted}].")
    if not np.isfinite(array).all():
        raise InputError(name, "an entry is not finite.", "Leave out what is not known.")
    return array
