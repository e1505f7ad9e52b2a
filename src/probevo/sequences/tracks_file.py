"""A tracks file: stereo features of another front end, in one ``.npz``, without images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import AnyArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.files import NO_ARCHIVE
from probevo.geometry import se3, so3
from probevo.sequences.frame import Frame, GroundTruth, StereoFeatures
from probevo.sequences.imu import ImuStream, hold_over_interval
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.poses import ground_truth
from probevo.sequences.stamps import NS_PER_S, check_stamps
from probevo.sequences.text import INT64_LIMIT

SHAPES: dict[str, tuple[int | str, ...]] = {
    "frame": ("n",),
    "track": ("n",),
    "uv": ("n", 4),
    "t": ("K",),
    "camera": (5,),
    "omega": ("K", 3),
    "C_cam_imu": (3, 3),
    "p_imu_cam": (3,),
    "T_world_cam": ("K", 4, 4),
}
REQUIRED = ("frame", "track", "uv", "t", "camera")
GYRO_NOISE_RAD_S_SQRT_HZ = 2e-3
"""One sample a frame: over six KITTI drives, gyro and truth differ by 0.6e-3 to 2.6e-3 (0.01° to
0.05° a frame)."""
GYRO_BIAS_SIGMA_RAD_S = 2e-3
"""The largest mean difference on an axis of those drives is 1.8e-3 rad/s. It is no drift of the
gyro: their omega are OXTS's rates on levelled axes, off the IMU's by roll and pitch (compared for
drive 0005)."""


@dataclass(frozen=True, eq=False)
class TracksRecording:
    """A ``Sequence`` of features; ``open_tracks`` builds it."""

    path: Path
    camera: StereoCamera
    stamps_ns: IntArray
    features: StereoFeatures
    """Those of all frames, one frame after another."""
    first_of_frame: IntArray
    """Where the features of each frame begin, and the end of the last, [K + 1]."""
    imu: ImuCalibration | None
    imu_stream: ImuStream | None
    truth: GroundTruth | None
    format: str = "tracks"

    def __len__(self) -> int:
        """Number of frames, K."""
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[Frame]:
        """The frames, from the first."""
        for index in range(len(self)):
            rows = slice(*self.first_of_frame[index : index + 2])
            features = StereoFeatures(self.features.ids[rows], self.features.pixels[rows])
            imu = None
            if self.imu_stream is not None and index > 0:
                imu = self.imu_stream.between(
                    int(self.stamps_ns[index - 1]), int(self.stamps_ns[index])
                )
            yield Frame(index, int(self.stamps_ns[index]), features=features, imu=imu)


def open_tracks(path: Path) -> TracksRecording:
    """Open an ``.npz`` file with these arrays::

        frame [n], track [n]   frame (from 0, ascending) and identity of each observation, whole
                               numbers
        uv [n, 4]              (u_l, v_l, u_r, v_r), px
        t [K]                  time of each frame, s
        camera [5]             fu, fv, cu, cv, px, and baseline, m
        omega [K, 3]           (optional, with C_cam_imu) mean angular rate since the previous
                               frame, rad/s, IMU frame; the first one is not used
        C_cam_imu [3, 3]       (optional, with omega) rotation from IMU to left camera
        p_imu_cam [3]          (optional, 0 if left out) position of the left camera in the IMU
                               frame, m: p_cam = C_cam_imu (p_imu − p_imu_cam)
        T_world_cam [K, 4, 4]  (optional) ground truth, NaN where unknown

    Further arrays are ignored. Objects (pickles) are refused.

    Raises:
        InputError: names the array at fault.
    """
    arrays = _load(path)
    _check_shapes(arrays, path)
    t_ns = (
        arrays["t"].astype(np.float64) * NS_PER_S
    )  # whole seconds would overflow in their own type
    if np.abs(t_ns).max() >= INT64_LIMIT:
        raise InputError(
            f"{path}: t", "these times do not fit in 64 bits of nanoseconds.", "Give t in seconds."
        )
    stamps_ns = check_stamps(np.round(t_ns).astype(np.int64), f"{path}: t")
    fu, fv, cu, cv, baseline_m = (float(value) for value in arrays["camera"])
    camera = StereoCamera(fu, fv, cu, cv_px=cv, baseline_m=baseline_m)
    check_camera(camera, f"{path}: camera")
    ids = arrays["track"].astype(np.int64)
    first_of_frame = _split_frames(arrays["frame"].astype(np.int64), ids, len(stamps_ns), path=path)
    features = StereoFeatures(ids, arrays["uv"].astype(np.float64))
    imu, imu_stream = _imu(arrays, stamps_ns, path)
    truth = (
        ground_truth(stamps_ns, arrays["T_world_cam"], f"{path}: T_world_cam")
        if "T_world_cam" in arrays
        else None
    )
    return TracksRecording(
        path,
        camera,
        stamps_ns,
        features=features,
        first_of_frame=first_of_frame,
        imu=imu,
        imu_stream=imu_stream,
        truth=truth,
    )


def _load(path: Path) -> dict[str, AnyArray]:
    try:
        with np.load(path, allow_pickle=False) as archive:
            return {name: archive[name] for name in SHAPES if name in archive}
    except NO_ARCHIVE as error:
        if str(error).startswith("Object arrays"):
            what = "one of its arrays is pickled; expected plain arrays."
            raise InputError(
                path, what, "Save it as whole numbers or floats, not as objects."
            ) from error
        # NumPy's own words advise to load it unsafely
        what = "this is not a readable .npz file of plain arrays."
        raise InputError(
            path, what, "If it was one, it is cut short or damaged: copy it again."
        ) from error


def _check_shapes(arrays: dict[str, AnyArray], path: Path) -> None:
    """Every array is there, numeric, finite, and agrees with the others in n and K."""
    missing = [name for name in REQUIRED if name not in arrays]
    if missing:
        raise InputError(
            path, f"the array {missing[0]} is missing.", f"Needed: {', '.join(REQUIRED)}."
        )
    if ("omega" in arrays) != ("C_cam_imu" in arrays):
        raise InputError(path, "of omega and C_cam_imu, one is missing.", "Give both or neither.")
    sizes: dict[int | str, int] = {"n": arrays["frame"].size, "K": arrays["t"].size}
    if not sizes["K"]:
        raise InputError(f"{path}: t", "this array is empty.", "It holds the time of each frame.")
    for name, array in arrays.items():
        expected = tuple(sizes.get(axis, axis) for axis in SHAPES[name])
        where = f"{path}: {name}"
        if array.shape != expected:
            text = ", ".join(map(str, SHAPES[name]))
            raise InputError(
                where, f"shape {array.shape}; expected [{text}] with n as frame, K as t."
            )
        kinds = "iu" if name in ("frame", "track") else "iuf"
        if array.dtype.kind not in kinds:
            raise InputError(
                where, f"type {array.dtype}; expected {'whole ' if kinds == 'iu' else ''}numbers."
            )
        bad = np.flatnonzero(~np.isfinite(array).all(axis=tuple(range(1, array.ndim))))
        if len(bad) and name != "T_world_cam":
            raise InputError(where, f"row {bad[0]} (from 0) is not finite.")


def _split_frames(frame: IntArray, ids: IntArray, frames: int, path: Path) -> IntArray:
    """Where each frame begins, [K + 1]."""
    backwards = np.flatnonzero(np.diff(frame) < 0)
    if len(backwards):
        what = f"row {backwards[0] + 1} (from 0) goes back to frame {frame[backwards[0] + 1]}."
        raise InputError(f"{path}: frame", what, "Sort the observations by frame.")
    if len(frame) and not (frame[0] >= 0 and frame[-1] < frames):
        raise InputError(
            f"{path}: frame", f"frames {frame[0]} to {frame[-1]}, but t has {frames} times."
        )
    order = np.lexsort((ids, frame))
    twice = np.flatnonzero((np.diff(frame[order]) == 0) & (np.diff(ids[order]) == 0))
    if len(twice):
        row = order[twice[0]]
        raise InputError(f"{path}: track", f"track {ids[row]} appears twice in frame {frame[row]}.")
    return np.searchsorted(frame, np.arange(frames + 1))


def _imu(
    arrays: dict[str, FloatArray], stamps_ns: IntArray, path: Path
) -> tuple[ImuCalibration | None, ImuStream | None]:
    if "omega" not in arrays or len(stamps_ns) < 2:
        return None, None
    # p_cam = C_cam_imu (p_imu − p_imu_cam)
    C_cam_imu = so3.check_rotation(arrays["C_cam_imu"], f"{path}: C_cam_imu")
    p_imu_cam = arrays.get("p_imu_cam", np.zeros(3))
    calibration = ImuCalibration(
        T_cam_imu=se3.from_parts(C_cam_imu, -C_cam_imu @ p_imu_cam),
        gyro_noise_rad_s_sqrt_hz=GYRO_NOISE_RAD_S_SQRT_HZ,
        gyro_bias_sigma_rad_s=GYRO_BIAS_SIGMA_RAD_S,
    )
    held_ns, gyro = hold_over_interval(stamps_ns, arrays["omega"])
    stream = ImuStream.checked(
        held_ns, gyro, np.full_like(gyro, np.nan), frames_ns=stamps_ns, where=f"{path}: omega"
    )
    return calibration, stream
