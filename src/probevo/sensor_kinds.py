"""The registry of learned sensors: the name of each kind, its loader and its trainer.

Networks need the extra ``nets``. What they need is imported only when one is loaded or trained, and
nothing else of probevo names their modules.
"""

from __future__ import annotations

from collections import abc
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from probevo.errors import InputError

if TYPE_CHECKING:  # the help of a command should not wait for SciPy
    from probevo.arrays import FloatArray
    from probevo.measurements.correction import MotionCorrection
    from probevo.measurements.sensor import Sensor
    from probevo.sequences.base import Sequence
    from probevo.sequences.content import SeenRecording

_MARK = b'"probevo-network"'
_LONGEST_HEADER = 1_000_000
_REQUIRE = "probevo.nets.extra:require_nets"
_READ_FACTS = "probevo.nets.network_file:read_facts"


@dataclass(frozen=True)
class SensorErrors:
    """Errors of the N measurements that a run would use, and what the sensor claims of them."""

    errors: FloatArray
    """Errors of the measurements, [N, d], rad, or m and rad."""
    covariances: FloatArray
    """Claimed covariances, [N, d, d]."""
    num_out_of_domain: int
    """Number of measurements whose covariance was widened."""
    num_silent: int
    """Inputs so far out of the domain that the sensor gives no measurement."""
    num_lengths: int = 0
    """Leading components that are lengths, in m instead of rad."""
    saliency: FloatArray | None = None
    """How much the loss depends on each cell of what the sensor sees, [rows, columns]."""
    kept: str = ""
    """Which epoch of the training the sensor is from, in words; empty if it is not known."""


@dataclass(frozen=True)
class SensorKind:
    """One kind of learned sensor; functions are written as ``module:function``."""

    name: str
    """Name of the kind in ``--kind`` and in the file of a sensor."""
    summary: str
    """One line for help texts."""
    sensor: str
    """Function of the path of a file and a camera, or a recording, that returns the sensor."""
    trainer: str
    """Function that learns one from recordings and writes its file: ``train_rotation``."""
    errors: str
    """Function of the path of a file and a recording with truth that returns ``SensorErrors``."""
    settings: tuple[str, ...] = ()
    """Further settings of a training that the trainer takes by their names, beside ``nets``."""
    nets: tuple[str, ...] = ()
    """Settings of networks that only this kind takes."""
    is_of_recording: bool = False
    """Whether the sensor is made for a recording, of which it needs more than the camera."""


SENSOR_KINDS: Mapping[str, SensorKind] = {
    kind.name: kind
    for kind in (
        SensorKind(
            name="rotation",
            summary="HydraNet: the rotation from one left image to the next",
            sensor="probevo.nets.rotation_sensor:RotationSensor.load",
            trainer="probevo.nets.rotation_training:train_rotation",
            errors="probevo.nets.rotation_training:errors_on",
            nets=("copies",),
        ),
        SensorKind(
            name="correction",
            summary="DPC-Net: how far the motion between two frames is off",
            sensor="probevo.nets.correction_sensor:CorrectionSensor.load",
            trainer="probevo.nets.correction_training:train_correction",
            errors="probevo.nets.correction_training:errors_on",
            settings=("odometry",),
            nets=("rotation_only", "constant_covariance"),
        ),
        SensorKind(
            name="sun",
            summary="Sun-BCNN: the direction of the sun in a left image",
            sensor="probevo.nets.sun_sensor:SunFromImages.load",
            trainer="probevo.nets.sun_training:train_sun",
            errors="probevo.nets.sun_training:errors_on",
            nets=("copies", "method", "dropout", "passes", "networks"),
            is_of_recording=True,
        ),
    )
}


def load_sensors(
    paths: abc.Sequence[Path], recording: Sequence
) -> tuple[Sensor | MotionCorrection, ...]:
    """Return the sensors of files, for images of a recording.

    Raises:
        InputError: a file is named twice, cannot be read, or holds no sensor; the recording is not
            one for it; or JAX, the extra ``nets``, is not installed.
    """
    resolved = [path.resolve() for path in paths]
    for path in resolved:
        if resolved.count(path) > 1:
            raise InputError("--sensor", f"{path} is given twice.", "Name it once.")
    kinds = [kind_of_file(path) for path in paths]
    return tuple(
        resolve(kind.sensor)(path, recording if kind.is_of_recording else recording.camera)
        for path, kind in zip(paths, kinds, strict=True)
    )


def kind_of_file(path: Path) -> SensorKind:
    """Return the kind of sensor that a file holds.

    Raises:
        InputError: it cannot be read, holds no sensor, or the extra ``nets`` is not installed.
    """
    resolve(_REQUIRE)("--sensor")
    name = resolve(_READ_FACTS)(path).get("kind")
    if not isinstance(name, str) or name not in SENSOR_KINDS:
        known = ", ".join(SENSOR_KINDS)
        what = f"it holds no sensor of a known kind, but {name!r}."
        raise InputError(path, what, f"Known are {known}: probevo train … --kind {known}.")
    return SENSOR_KINDS[name]


def recordings_of_file(path: Path) -> tuple[SeenRecording, ...]:
    """Return the recordings that the training of a sensor has seen.

    Those left out count, too: they stopped the training and calibrated the sensor.

    Raises:
        InputError: it cannot be read, names no recordings, or the extra ``nets`` is not installed.
    """
    from probevo.sequences.content import SeenRecording

    resolve(_REQUIRE)("--sensor")
    facts = resolve(_READ_FACTS)(path)
    names: list[str] = []
    for key in ("learned_from", "left_out"):
        named = facts.get(key, [])
        if not isinstance(named, list) or not all(isinstance(name, str) for name in named):
            raise InputError(f"{path}: {key}", "it is no list of names.", "Train it again.")
        names += named
    views = facts.get("views", [None] * len(names))  # older files lack them
    if not isinstance(views, list) or len(views) != len(names):
        raise InputError(f"{path}: views", "it is no list of a digest a name.", "Train it again.")
    return tuple(map(SeenRecording, names, views))


def trainer_of_sensor(kind: SensorKind) -> Callable[..., Any]:
    """Return the function that learns a sensor from recordings.

    Raises:
        InputError: the extra ``nets`` is not installed.
    """
    resolve(_REQUIRE)(f"--kind {kind.name}")
    return resolve(kind.trainer)


def is_sensor_file(path: Path) -> bool:
    """Return whether a file is that of a network, by its header; JAX is not needed."""
    try:
        with path.open("rb") as stream:
            size = int.from_bytes(stream.read(8), "little")
            return _MARK in stream.read(min(size, _LONGEST_HEADER))
    except OSError:
        return False


def resolve(function: str) -> Callable[..., Any]:
    """Import a function that is written as ``module:function``, or ``module:class.function``."""
    module, _, names = function.partition(":")
    found: Any = import_module(module)
    for name in names.split("."):
        found = getattr(found, name)
    function_found: Callable[..., Any] = found
    return function_found
