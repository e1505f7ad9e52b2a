"""A run in the Rerun viewer, or as a file of it (``.rrd``): images, features, path, covariances.

The extra ``viewer`` installs ``rerun-sdk``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import AnyArray, FloatArray, Image
from probevo.errors import InputError
from probevo.estimation.motion_estimate import Status
from probevo.odometry import StereoOdometry
from probevo.output.drawing import TRUST_COLORS_BGR
from probevo.output.report.report_data import Drift, drift_of
from probevo.output.run_files import VIEWER_SUFFIX
from probevo.output.run_result import RunResult
from probevo.sequences.frame import Frame
from probevo.storage.files import check_folder, written_together

WINDOW = Path("window")
"""Stands for a window of the viewer on this machine's display, in place of a file."""
BLUE_RGB = (23, 105, 170)
GREEN_RGB = (44, 140, 90)
GREY_RGB = (139, 149, 161)
JPEG_QUALITY = 80
NUM_SIGMAS = 3.0
"""Half axes of the ellipsoids, in standard deviations."""


def check_viewer_path(path: Path, option: str) -> None:
    """Refuse a path that cannot be written, before anything is computed.

    Args:
        path: a file ``.rrd``, or ``WINDOW``.
        option: what names it, for the message.

    Raises:
        InputError: rerun-sdk is not installed, the ending is another one, the folder is not
            writable, or a window is asked for where there is no display.
    """
    if path == WINDOW:
        _check_display(option)
    elif path.suffix != VIEWER_SUFFIX:
        cure = (
            f"Name a file {VIEWER_SUFFIX}, which Rerun opens, or none, behind SEQUENCE, for a"
            " window."
        )
        raise InputError(option, f"{path} does not end in {VIEWER_SUFFIX}.", cure)
    else:
        check_folder(path.parent, option)
    try:
        import rerun  # noqa: F401
    except ImportError as error:
        cure = "Install it: pip install 'probevo[viewer]'."
        raise InputError(option, "the viewer needs the package rerun-sdk.", cure) from error


def _check_display(option: str) -> None:
    """Refuse to open a window where there is no display, such as on a server.

    Raises:
        InputError: there is no display.
    """
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform == "linux" and not has_display:
        cure = f"Name a file, {option} drive{VIEWER_SUFFIX}, and open it with `rerun` elsewhere."
        raise InputError(option, "there is no display for a window of the viewer.", cure)


class ViewerFile:
    """A run that is written, or shown, while it goes on; ``rerun FILE`` shows a file.

    Its timelines are ``frame`` and ``time``. Entities of each frame, as it is processed:
    ``world/camera/image`` (JPEG), ``world/camera/image/features`` (coloured by weight, from
    distrusted red to trusted blue-green), ``world/camera/landmarks`` (the points of the solve, in
    the same colours), ``imu/gyro_rad_s`` and ``imu/accel_m_s2`` (means since the frame before).

    Of the whole run, at its end: ``world/estimate``, ``world/smoothed`` and ``world/truth`` (the
    paths; the estimate is the live one), ``world/camera`` (the pose of each frame),
    ``world/camera_3_sigma`` (ellipsoid of its position), ``step/…`` (standard deviations, tracks,
    inliers), and ``status`` (a line for each step that is not OK).

    The file appears when it is finished, with the name that was asked for.

    Args:
        path: a file ``.rrd``, or ``WINDOW``.

    Raises:
        InputError: rerun-sdk is not installed, the file cannot be written, or the viewer cannot be
            started.
    """

    def __init__(self, path: Path) -> None:
        check_viewer_path(path, str(path))
        import rerun as rr

        self._rr = rr
        self._written = ExitStack()
        self._partial: Path | None = None
        if path == WINDOW:
            self._recording: Any = rr.RecordingStream("probevo")  # a new one for each run
            _open_window(self._recording)
        else:
            self._partial = self._written.enter_context(written_together(path.parent)) / path.name
            self._recording = rr.RecordingStream("probevo", recording_id=path.stem)
            self._recording.save(self._partial)
        self._recording.log("world", rr.ViewCoordinates.RDF, static=True)
        self._first_ns: int | None = None
        self._is_open = True

    def add(self, frame: Frame, odometry: StereoOdometry) -> None:
        """Add what a frame shows, after the step of it."""
        if self._first_ns is None:
            self._first_ns = frame.stamp_ns
        self._set_time(frame.index, 1e-9 * (frame.stamp_ns - self._first_ns))
        if frame.left is not None:
            self._add_image(frame.left, odometry)
        colors = _colors(odometry.weights)
        features = self._rr.Points2D(odometry.tracks.curr_px[:, :2], colors=colors, radii=2.0)
        self._recording.log("world/camera/image/features", features)
        landmarks = odometry.landmarks
        weights = odometry.weights[np.isin(odometry.tracks.ids, landmarks.ids)]
        points = self._rr.Points3D(landmarks.points_m, colors=_colors(weights))
        self._recording.log("world/camera/landmarks", points)
        if frame.imu is not None and len(frame.imu.stamps_ns):
            gyro = self._rr.Scalars(frame.imu.gyro_rad_s.mean(axis=0))
            self._recording.log("imu/gyro_rad_s", gyro)
            accel = self._rr.Scalars(frame.imu.accel_m_s2.mean(axis=0))
            self._recording.log("imu/accel_m_s2", accel)

    def finish(self, result: RunResult, truth: FloatArray | None = None) -> None:
        """Add the whole run, and give the file its name.

        Args:
            result: the run.
            truth: true poses T_world_cam, [N, 4, 4], m, in any world frame; NaN where unknown.

        Raises:
            InputError: the file cannot be written.
        """
        rr = self._rr
        drift = drift_of(result, truth)
        self._recording.log("world/estimate", _line(rr, drift.T_world_cam, BLUE_RGB), static=True)
        if result.smoothed is not None:
            line = _line(rr, result.smoothed, GREEN_RGB)
            self._recording.log("world/smoothed", line, static=True)
        if drift.T_world_cam_true is not None:
            line = _line(rr, drift.T_world_cam_true, GREY_RGB)
            self._recording.log("world/truth", line, static=True)
        for index in range(len(result)):
            self._set_time(index, float(drift.time_s[index]))
            _log_pose(rr, self._recording, drift, index=index)
            if index > 0:
                _log_step(rr, self._recording, result, step=index - 1)
        self._close()

    def discard(self) -> None:
        """Write no file, unless it is finished; a window keeps what it shows."""
        if self._is_open:
            self._recording.disconnect()
            if self._partial is not None:
                self._partial.unlink(missing_ok=True)
            self._close()

    def _close(self) -> None:
        self._is_open = False
        self._recording.flush()
        self._recording.disconnect()
        self._written.close()

    def _set_time(self, index: int, time_s: float) -> None:
        self._recording.set_time("frame", sequence=index)
        self._recording.set_time("time", duration=time_s)

    def _add_image(self, left: Image, odometry: StereoOdometry) -> None:
        """Add a left image, and with it the camera that took it."""
        camera = odometry.camera
        height, width = left.shape
        pinhole = self._rr.Pinhole(
            focal_length=(camera.fu_px, camera.fv_px),
            principal_point=(camera.cu_px, camera.cv_px),
            resolution=(width, height),
        )
        self._recording.log("world/camera/image", pinhole)
        data = cv2.imencode(".jpg", left, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])[1].tobytes()
        encoded = self._rr.EncodedImage(contents=data, media_type="image/jpeg")
        self._recording.log("world/camera/image", encoded)


@contextmanager
def opened_viewer(path: Path | None) -> Iterator[ViewerFile | None]:
    """Give a file for the viewer, which is discarded unless it is finished; None without a path.

    Raises:
        InputError: rerun-sdk is not installed, or the file cannot be written.
    """
    if path is None:
        yield None
        return
    viewer = ViewerFile(path)
    try:
        yield viewer
    finally:
        viewer.discard()


def write_viewer_file(path: Path, result: RunResult, truth: FloatArray | None = None) -> None:
    """Write a finished run, without what its frames showed.

    Args:
        path: a file ``.rrd``.
        result: the run.
        truth: true poses T_world_cam, [N, 4, 4], m, in any world frame; NaN where unknown.

    Raises:
        InputError: rerun-sdk is not installed, or the file cannot be written.
    """
    with opened_viewer(path) as viewer:
        if viewer is not None:
            viewer.finish(result, truth)


def _open_window(recording: Any) -> None:
    """Start the viewer, and send it the recording from now on.

    Raises:
        InputError: it does not start.
    """
    try:
        recording.spawn()
    except (OSError, RuntimeError) as error:
        cure = f"Name a file, --viewer drive{VIEWER_SUFFIX}, and open it with `rerun`."
        raise InputError("--viewer", f"the viewer does not start: {error}.", cure) from error


def _colors(weights: FloatArray) -> AnyArray:
    """Return the colours of weights from 0 to 1, [N, 3], RGB."""
    classes = np.clip(weights * len(TRUST_COLORS_BGR), 0, len(TRUST_COLORS_BGR) - 1)
    return np.asarray(TRUST_COLORS_BGR[classes.astype(np.int64), ::-1], np.uint8)


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
