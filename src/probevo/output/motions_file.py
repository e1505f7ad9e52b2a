"""``motions.npz``: a run as it was, but for the smoothed poses, which have a file of their own.

Its trajectory, evaluation and odometry bag all follow from this file.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import astuple, dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from pydantic import TypeAdapter, ValidationError

from probevo.arrays import AnyArray, FloatArray
from probevo.camera.focal_length import FocalLengthError
from probevo.camera.rig_calibration import RowErrors
from probevo.errors import InputError
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS
from probevo.evaluation.accelerometer_scale import AccelerometerScale
from probevo.evaluation.ground_height import GroundHeight
from probevo.geometry import se3
from probevo.measurements.imu_calibration_errors import ImuCalibrationErrors
from probevo.measurements.imu_reason import ImuFault
from probevo.output.run_files import MOTIONS
from probevo.output.run_result import RunResult, SensorUse
from probevo.storage.npz import NO_NPZ, read_npz, write_npz
from probevo.tracking.fixed_features import FixedFeatures, StepsAtRest

ABOUT = (
    "T_curr_prev [N-1, 4, 4]: points of the previous left camera to the current one, m."
    " cov [N-1, 6, 6]: covariance of the left perturbation [translation; rotation], m and rad:"
    " T_true = Exp(perturbation) T. Camera axes: x right, y down, z forward. All else:"
    " docs/results.md."
)
"""Tells whoever opens the file alone what it holds."""
_STAGE = "ms_"
_REJECTED = "rejected_"
_UNUSABLE = "unusable_"
_CURE = "Expected a motions.npz written by `probevo run` of this version."
_STEPS = -1
"""Stands for N-1 in a shape."""
_FRAMES = -2
"""Stands for N."""
_SENSORS = TypeAdapter(dict[str, SensorUse])


@dataclass(frozen=True)
class _Optional:
    """Conversion between an array and a field of ``RunResult`` that not every run has.

    The array has the name of the field. It is left out where the field is None, 0 or empty, and
    where it is missing, the field has its default.
    """

    shape: tuple[int, ...] | None
    """The shape of the array; None for a text."""
    read: Callable[[AnyArray], Any]
    """Converts the array to the field."""
    write: Callable[[Any], ArrayLike] = np.asarray
    """Converts the field to an array."""


def _sensors_to_text(sensors: dict[str, SensorUse]) -> ArrayLike:
    """Return the use of the sensors as JSON."""
    return _SENSORS.dump_json(sensors).decode()


def _sensors_from_text(text: AnyArray) -> dict[str, SensorUse]:
    """Return the use of the sensors from its JSON; a ValidationError if that is something else."""
    return _SENSORS.validate_json(str(text))


def _scale(array: AnyArray) -> AccelerometerScale:
    ratio, sigma, count = array.tolist()
    return AccelerometerScale(ratio, sigma, int(count))


def _fixed(array: AnyArray) -> FixedFeatures:
    """Return features that did not move, from their two numbers, center and spread, [6]."""
    num_moving, num_fixed, u, v, spread_u, spread_v = array.tolist()
    return FixedFeatures(int(num_moving), int(num_fixed), (u, v), (spread_u, spread_v))


def _fixed_as_array(fixed: FixedFeatures) -> ArrayLike:
    """Return the inverse of ``_fixed``, [6]."""
    return [fixed.num_moving, fixed.num_fixed, *fixed.center_px, *fixed.spread_px]


def _rows_of_calibration(found: ImuCalibrationErrors) -> ArrayLike:
    """Return errors, standard deviations and prior ones, [3, 9]."""
    return np.stack([found.errors, found.sigma, found.prior_sigma])


def _fault(text: AnyArray) -> ImuFault:
    """Return what is wrong with an IMU; a ValueError if it is nothing that is known."""
    try:
        return ImuFault(str(text))
    except ValueError as error:
        raise ValueError("is no kind of reason against an IMU that is known") from error


def _factors(array: AnyArray) -> FloatArray:
    """Return factors of variances; a ValueError if one is not positive."""
    if (array <= 0.0).any():
        raise ValueError("holds a factor that is not positive")
    return array


_OPTIONAL = {
    "num_used": _Optional((_STEPS,), np.asarray),
    "num_out_of_domain": _Optional((_STEPS,), np.asarray),
    "noise_factor": _Optional((_STEPS,), _factors),
    "cov_cam_world": _Optional((_FRAMES, 6, 6), np.asarray),
    "smoothed_cov": _Optional((_FRAMES, 6, 6), np.asarray),
    "jitter_sigma_rad": _Optional((3,), np.asarray),
    "row_errors": _Optional((2,), lambda array: RowErrors(*array.tolist())),
    "fixed_features": _Optional((6,), _fixed, _fixed_as_array),
    "steps_at_rest": _Optional((4,), lambda array: StepsAtRest(*map(int, array.tolist()))),
    "right_delay_s": _Optional((), float),
    "readout_s": _Optional((), float),
    "focal_length": _Optional((2,), lambda array: FocalLengthError(*array.tolist()), astuple),
    "right_late_frames": _Optional((), int),
    "is_interlaced": _Optional((), bool, int),
    "other_camera": _Optional(None, str),
    "noise_is_learned": _Optional((), bool, int),
    "imu_left_out": _Optional(None, str),
    "imu_fault": _Optional(None, _fault, attrgetter("value")),
    "imu_unused_from": _Optional((), int),
    "imu_noise_factor": _Optional((), float),
    "imu_calibration_errors": _Optional(
        (3, 9), lambda array: ImuCalibrationErrors(*array), _rows_of_calibration
    ),
    "accelerometer_scale": _Optional((3,), _scale, astuple),
    "stopped": _Optional(None, str),
    "sensors": _Optional(None, _sensors_from_text, _sensors_to_text),
}
"""The optional fields, by name; their arrays have the same names."""


def write_motions(path: Path, result: RunResult) -> None:
    """Write a run. The same run gives the same bytes, except for ``ms_<stage>`` and ``total_ms``.

    Raises:
        InputError: the file cannot be written.
    """
    arrays: dict[str, AnyArray] = {
        "stamps_ns": result.stamps_ns,
        "T_curr_prev": result.T_curr_prev,
        "cov": result.cov,
        "common_mode": result.common_mode,
        "path_cross_cov": result.path_cross_cov,
        "status": result.status,
        "num_tracks": result.num_tracks,
        "num_inliers": result.num_inliers,
        "total_ms": result.total_ms,
        "about": np.array(ABOUT),
    }
    # Motions do not tell the path that sensors have corrected.
    if not np.array_equal(result.T_world_cam, _compounded(result.T_curr_prev, len(result))):
        arrays["T_world_cam"] = result.T_world_cam
    for name, optional in _OPTIONAL.items():
        value = getattr(result, name)
        if isinstance(value, np.ndarray) or value:
            arrays[name] = np.asarray(optional.write(value))
    height = result.ground_height
    if height is not None:
        arrays["ground_height"] = np.array([height.height_m, height.sigma_m, height.num_blocks])
        if height.known_m is not None:
            arrays["camera_height_m"] = np.array(height.known_m)
    for name, ms in result.stage_ms.items():
        arrays[_STAGE + name] = ms
    for name, count in result.rejected.items():
        arrays[_REJECTED + name.replace(" ", "_")] = np.array(count, dtype=np.int64)
    for name, count in result.unusable.items():
        arrays[_UNUSABLE + name] = np.array(count, dtype=np.int64)
    write_npz(path, arrays)


def read_motions(path: Path | str) -> RunResult:
    """Read a run back as it was, without its smoothed path.

    A file without a path of its own has the one that the motions add up to.

    Args:
        path: a ``motions.npz``, or the folder of a run.

    Raises:
        InputError: the file cannot be read, an array is missing, or its shape does not fit the
            number of stamps.
    """
    if not isinstance(path, str | Path):
        raise InputError("path", f"is a {type(path).__name__}.", "Give a path, str or Path.")
    path = Path(path) / MOTIONS if Path(path).is_dir() else Path(path)
    try:
        arrays = read_npz(path)
    except NO_NPZ as error:
        raise InputError(path, f"cannot be read: {error}", _CURE) from error
    # The number of stamps says which shapes all other arrays have.
    n = len(_take(path, arrays, "stamps_ns", shape=None))
    steps = max(n - 1, 0)
    T_curr_prev = _take(path, arrays, "T_curr_prev", shape=(steps, 4, 4))
    cov = _take(path, arrays, "cov", shape=(steps, 6, 6))
    # Whoever weighs by the inverse of a covariance relies on this.
    indefinite = np.flatnonzero(np.linalg.eigvalsh(cov).min(axis=1, initial=np.inf) <= 0.0)
    if len(indefinite) > 0:
        raise InputError(path, f"cov of motion {indefinite[0]} is not positive definite", _CURE)
    T_world_cam = _compounded(T_curr_prev, n)
    if "T_world_cam" in arrays:
        T_world_cam = _take(path, arrays, "T_world_cam", shape=(n, 4, 4))
    rejected = _counts(path, arrays, _REJECTED)
    return RunResult(
        stamps_ns=arrays["stamps_ns"],
        T_world_cam=T_world_cam,
        T_curr_prev=T_curr_prev,
        cov=cov,
        common_mode=_take(path, arrays, "common_mode", shape=(steps, 6, COMMON_MODE_COLUMNS)),
        path_cross_cov=_take(path, arrays, "path_cross_cov", shape=(steps, 6, 6)),
        status=_take(path, arrays, "status", shape=(steps,)),
        num_tracks=_take(path, arrays, "num_tracks", shape=(steps,)),
        num_inliers=_take(path, arrays, "num_inliers", shape=(steps,)),
        stage_ms={
            name.removeprefix(_STAGE): _take(path, arrays, name, shape=(steps,))
            for name in arrays
            if name.startswith(_STAGE)
        },
        total_ms=_take(path, arrays, "total_ms", shape=(steps,)),
        rejected={name.replace("_", " "): count for name, count in rejected.items()},
        unusable=_counts(path, arrays, _UNUSABLE),
        ground_height=_ground_height(path, arrays),
        **{
            name: _read_optional(path, arrays, name, steps=steps, frames=n)
            for name in _OPTIONAL
            if name in arrays
        },
    )


def _compounded(T_curr_prev: FloatArray, num_frames: int) -> FloatArray:
    """Return the poses that motions [N-1, 4, 4] add up to, [N, 4, 4], m; none for no frame."""
    return se3.chain_motions(T_curr_prev)[:num_frames]


def _counts(path: Path, arrays: dict[str, AnyArray], prefix: str) -> dict[str, int]:
    """Take the numbers whose names begin with a prefix, by the rest of their names."""
    return {
        name.removeprefix(prefix): int(_take(path, arrays, name, shape=()))
        for name in arrays
        if name.startswith(prefix)
    }


def _read_optional(
    path: Path, arrays: dict[str, AnyArray], name: str, *, steps: int, frames: int
) -> Any:
    """Read a field of ``_OPTIONAL`` from its array.

    Raises:
        InputError: the array has another shape or type, or impossible values.
    """
    optional = _OPTIONAL[name]
    if optional.shape is None:
        array = arrays[name]
        if array.shape != () or array.dtype.kind != "U":
            raise InputError(path, f"{name} is not text", _CURE)
    else:
        sizes = {_STEPS: steps, _FRAMES: frames}
        shape = tuple(sizes.get(size, size) for size in optional.shape)
        array = _take(path, arrays, name, shape=shape)
    try:
        return optional.read(array)
    except ValidationError as error:
        raise InputError(path, f"{name} does not say how sensors were used", _CURE) from error
    except ValueError as error:
        raise InputError(path, f"{name} {error}", _CURE) from error


def _take(
    path: Path, arrays: dict[str, AnyArray], name: str, shape: tuple[int, ...] | None
) -> AnyArray:
    """Take the array of that name, of finite numbers.

    Args:
        path: the file, for messages.
        arrays: all arrays of the file.
        name: name of the array.
        shape: the shape that it must have; None for any with one axis.

    Raises:
        InputError: it is missing, has another shape, or holds something else.
    """
    if name not in arrays:
        raise InputError(path, f"{name} is missing", _CURE)
    array = arrays[name]
    if array.shape != shape and not (shape is None and array.ndim == 1):
        raise InputError(path, f"{name} has shape {array.shape}, expected {shape or '[N]'}", _CURE)
    if array.dtype.kind not in "if" or not np.isfinite(array).all():
        raise InputError(path, f"{name} holds values that are not finite numbers", _CURE)
    return array


def _ground_height(path: Path, arrays: dict[str, AnyArray]) -> GroundHeight | None:
    if "ground_height" not in arrays:
        return None
    height_m, sigma_m, num_blocks = _take(path, arrays, "ground_height", shape=(3,)).tolist()
    known_m = None
    if "camera_height_m" in arrays:
        known_m = float(_take(path, arrays, "camera_height_m", shape=()))
    if min(height_m, sigma_m, 1.0 if known_m is None else known_m) <= 0.0:
        raise InputError(path, "ground_height or camera_height_m is not positive", _CURE)
    return GroundHeight(height_m, sigma_m, int(num_blocks), known_m=known_m)
