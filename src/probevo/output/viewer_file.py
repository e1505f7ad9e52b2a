"""A run as a recording of the Rerun viewer (``.rrd``): path, pose with its covariance, status.

The extra ``viewer`` installs ``rerun-sdk``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray
from probevo.errors import InputError
from probevo.estimation.motion_estimate import Status
from probevo.files import check_folder, written_together
from probevo.output.report_data import Drift, drift_of
from probevo.output.run_result import RunResult

SUFFIX = ".rrd"
BLUE_RGB = (23, 105, 170)
GREY_RGB = (139, 149, 161)
NUM_SIGMAS = 3.0
"""Half axes of the ellipsoids, in standard deviations."""


def check_viewer_path(path: Path, option: str) -> None:
    """Refuse a path that cannot be written, before anything is computed.

    Raises:
        InputError: rerun-sdk is not installed, the ending is another one, or the folder is not
            writable.
    """
    if path.suffix != SUFFIX:
        raise InputError(option, f"{path} does not end in {SUFFIX}.", "Rerun opens such files.")
    check_folder(path.parent, option)
    try:
        import rerun  # noqa: F401
    except ImportError as error:
        cure = "Install it: pip install 'probevo[viewer]'."
        raise InputError(option, "the viewer needs the package rerun-sdk.", cure) from error


def write_viewer_file(path: Path, result: RunResult, truth: FloatArray | None = None) -> None:
    """Write a run; ``rerun FILE`` shows it, on the timelines ``frame`` and ``time``.

    Entities: ``world/estimate`` and ``world/truth`` (the paths), ``world/camera`` (the pose of each
    frame), ``world/camera_3_sigma`` (ellipsoid of its position), ``step/…`` (standard deviations,
    tracks, inliers), and ``status`` (a line for each step that is not OK).

    Args:
        path: a file ``.rrd``.
        result: the run.
        truth: true poses T_world_cam, [N, 4, 4], m, in any world frame; NaN where unknown.

    Raises:
        InputError: rerun-sdk is not installed, or the file cannot be written.
    """
    check_viewer_path(path, str(path))
    import rerun as rr

    drift = drift_of(result, truth)
    with written_together(path.parent) as folder:
        recording = rr.RecordingStream("probevo", recording_id=path.stem)
        recording.save(folder / path.name)
        recording.log("world", rr.ViewCoordinates.RDF, static=True)
        recording.log("world/estimate", _line(rr, drift.T_world_cam, BLUE_RGB), static=True)
        if drift.T_world_cam_true is not None:
            line = _line(rr, drift.T_world_cam_true, GREY_RGB)
            recording.log("world/truth", line, static=True)
        for index in range(len(result)):
            recording.set_time("frame", sequence=index)
            recording.set_time("time", duration=float(drift.time_s[index]))
            _log_pose(rr, recording, drift, index=index)
            if index > 0:
                _log_step(rr, recording, result, step=index - 1)
        recording.flush()
        recording.disconnect()


def _line(rr: Any, T_world_cam: FloatArray, color: tuple[int, int, int]) -> Any:
    """Return the path through the known poses."""
    points_m = T_world_cam[:, :3, 3]
    known = points_m[np.isfinite(points_m).all(axis=1)]
    return rr.LineStrips3D([known], colors=[color])


def _log_pose(rr: Any, recording: Any, drift: Drift, *, index: int) -> None:
    """Add the pose of a frame, and the ellipsoid of its position."""
    T = drift.T_world_cam[index]
    recording.log("world/camera", rr.Transform3D(translation=T[:3, 3], mat3x3=T[:3, :3]))
    variances, axes = np.linalg.eigh(drift.position_cov_world[index])
    axes[:, 2] *= np.linalg.det(axes)  # a rotation
    ellipsoid = rr.Ellipsoids3D(
        centers=[T[:3, 3]],
        half_sizes=[NUM_SIGMAS * np.sqrt(np.maximum(variances, 0.0))],
        quaternions=[rr.Quaternion(xyzw=Rotation.from_matrix(axes).as_quat())],
        colors=[BLUE_RGB],
    )
    recording.log("world/camera_3_sigma", ellipsoid)


def _log_step(rr: Any, recording: Any, result: RunResult, *, step: int) -> None:
    """Add the figures of a step, and its status if it is not OK."""
    sigma = np.sqrt(np.diagonal(result.cov[step]))
    values = {
        "sigma_translation_m": float(sigma[:3].max()),
        "sigma_rotation_deg": float(np.degrees(sigma[3:].max())),
        "tracks": float(result.num_tracks[step]),
        "inliers": float(result.num_inliers[step]),
    }
    for name, value in values.items():
        recording.log(f"step/{name}", rr.Scalars([value]))
    status = Status(int(result.status[step]))
    if status is not Status.OK:
        recording.log("status", rr.TextLog(status.name, level="WARN"))
