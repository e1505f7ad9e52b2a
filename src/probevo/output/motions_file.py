"""``motions.npz``: the relative motions of a run.

Its trajectory, evaluation and report all follow from this file.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from probevo.arrays import AnyArray
from probevo.camera.focal_length import FocalLengthError
from probevo.errors import InputError
from probevo.estimation.motion_estimate import COMMON_MODE_COLUMNS
from probevo.evaluation.accelerometer_scale import AccelerometerScale
from probevo.evaluation.ground_height import GroundHeight
from probevo.geometry import se3
from probevo.output.run_result import RunResult
from probevo.storage.files import write_atomically
from probevo.storage.npz import NO_NPZ, read_npz

_STAGE = "ms_"
_REJECTED = "rejected_"
_UNUSABLE = "unusable_"
_CURE = "Expected a motions.npz written by `probevo run` of this version."


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
    }
    # What not every run knows is left out of the file.
    if result.num_used is not None:
        arrays["num_used"] = result.num_used
    if result.num_out_of_domain is not None:
        arrays["num_out_of_domain"] = result.num_out_of_domain
    if result.jitter_sigma_rad is not None:
        arrays["jitter_sigma_rad"] = result.jitter_sigma_rad
    for name, ms in result.stage_ms.items():
        arrays[_STAGE + name] = ms
    for name, count in result.rejected.items():
        arrays[_REJECTED + name.replace(" ", "_")] = np.array(count, dtype=np.int64)
    for name, count in result.unusable.items():
        arrays[_UNUSABLE + name] = np.array(count, dtype=np.int64)
    if result.right_late_frames:
        arrays["right_late_frames"] = np.array(result.right_late_frames, dtype=np.int64)
    if result.other_camera is not None:
        arrays["other_camera"] = np.array(result.other_camera)
    if result.imu_left_out is not None:
        arrays["imu_left_out"] = np.array(result.imu_left_out)
    scale = result.accelerometer_scale
    if scale is not None:
        arrays["accelerometer_scale"] = np.array([scale.ratio, scale.sigma, scale.count])
    height = result.ground_height
    if height is not None:
        arrays["ground_height"] = np.array([height.height_m, height.sigma_m, height.num_blocks])
        if height.known_m is not None:
            arrays["camera_height_m"] = np.array(height.known_m)
    focal = result.focal_length
    if focal is not None:
        arrays["focal_length"] = np.array([focal.log_ratio, focal.sigma])
    if result.stopped is not None:
        arrays["stopped"] = np.array(result.stopped)
    buffer = io.BytesIO()
    # allow_pickle is not passed: NumPy 2.0 would store it as an array.
    np.savez(buffer, **arrays)  # type: ignore[arg-type]
    write_atomically(path, buffer.getvalue())


def read_motions(path: Path | str) -> RunResult:
    """Read a run back as it was.

    Args:
        path: a ``motions.npz``, or the folder of a run.

    Raises:
        InputError: the file cannot be read, an array is missing, or its shape does not fit the
            number of stamps.
    """
    if not isinstance(path, str | Path):
        raise InputError("path", f"is a {type(path).__name__}.", "Give a path, str or Path.")
    path = Path(path) / "motions.npz" if Path(path).is_dir() else Path(path)
    try:
        arrays = read_npz(path)
    except NO_NPZ as error:
        raise InputError(path, f"cannot be read: {error}", _CURE) from error
    # The number of stamps says which shapes all other arrays have.
    n = len(_take(path, arrays, "stamps_ns", shape=None))
    steps = max(n - 1, 0)
    T_curr_prev = _take(path, arrays, "T_curr_prev", shape=(steps, 4, 4))
    stages = [name for name in arrays if name.startswith(_STAGE)]
    checks = [name for name in arrays if name.startswith(_REJECTED)]
    cov = _take(path, arrays, "cov", shape=(steps, 6, 6))
    # Whoever weighs by the inverse of a covariance relies on this.
    indefinite = np.flatnonzero(np.linalg.eigvalsh(cov).min(axis=1, initial=np.inf) <= 0.0)
    if len(indefinite) > 0:
        raise InputError(path, f"cov of motion {indefinite[0]} is not positive definite", _CURE)
    return RunResult(
        stamps_ns=arrays["stamps_ns"],
        T_world_cam=se3.chain_motions(T_curr_prev)[:n],
        T_curr_prev=T_curr_prev,
        cov=cov,
        common_mode=_take(path, arrays, "common_mode", shape=(steps, 6, COMMON_MODE_COLUMNS)),
        path_cross_cov=_take(path, arrays, "path_cross_cov", shape=(steps, 6, 6))
        if "path_cross_cov" in arrays
        else np.zeros((steps, 6, 6)),
        status=_take(path, arrays, "status", shape=(steps,)),
        num_tracks=_take(path, arrays, "num_tracks", shape=(steps,)),
        num_inliers=_take(path, arrays, "num_inliers", shape=(steps,)),
        stage_ms={
            name.removeprefix(_STAGE): _take(path, arrays, name, shape=(steps,)) for name in stages
        },
        total_ms=_take(path, arrays, "total_ms", shape=(steps,)),
        rejected={
            name.removeprefix(_REJECTED).replace("_", " "): int(_take(path, arrays, name, shape=()))
            for name in checks
        },
        num_used=_take(path, arrays, "num_used", shape=(steps,)) if "num_used" in arrays else None,
        num_out_of_domain=_take(path, arrays, "num_out_of_domain", shape=(steps,))
        if "num_out_of_domain" in arrays
        else None,
        unusable={
            name.removeprefix(_UNUSABLE): int(_take(path, arrays, name, shape=()))
            for name in arrays
            if name.startswith(_UNUSABLE)
        },
        right_late_frames=int(_take(path, arrays, "right_late_frames", shape=()))
        if "right_late_frames" in arrays
        else 0,
        other_camera=str(arrays["other_camera"]) if "other_camera" in arrays else None,
        imu_left_out=str(arrays["imu_left_out"]) if "imu_left_out" in arrays else None,
        accelerometer_scale=_scale(path, arrays),
        ground_height=_ground_height(path, arrays),
        focal_length=_focal_length(path, arrays),
        stopped=str(arrays["stopped"]) if "stopped" in arrays else None,
        jitter_sigma_rad=_take(path, arrays, "jitter_sigma_rad", shape=(3,))
        if "jitter_sigma_rad" in arrays
        else None,
    )


def _scale(path: Path, arrays: dict[str, AnyArray]) -> AccelerometerScale | None:
    if "accelerometer_scale" not in arrays:
        return None
    ratio, sigma, count = _take(path, arrays, "accelerometer_scale", shape=(3,)).tolist()
    return AccelerometerScale(ratio, sigma, int(count))


def _focal_length(path: Path, arrays: dict[str, AnyArray]) -> FocalLengthError | None:
    if "focal_length" not in arrays:
        return None
    log_ratio, sigma = _take(path, arrays, "focal_length", shape=(2,)).tolist()
    return FocalLengthError(log_ratio, sigma)


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
        raise InputError(path, f"{name} holds something that is no finite number", _CURE)
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
