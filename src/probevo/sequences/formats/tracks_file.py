"""A tracks file: stereo features of another front end, in one ``.npz``, without images."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import AnyArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.frame import Frame, GroundTruth, StereoFeatures
from probevo.sequences.imu import ImuStream, hold_over_interval
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.poses import ground_truth
from probevo.sequences.stamps import NS_PER_S, check_stamps
from probevo.sequences.text import INT64_LIMIT
from probevo.storage.npz import NO_NPZ, read_npz

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
"""Noise for one sample a frame: on six KITTI drives, gyro and truth differ by 0.6e-3 to 2.6e-3
(0.01° to 0.05° a frame)."""
GYRO_BIAS_SIGMA_RAD_S = 2e-3
"""The largest mean difference on an axis of those drives is 1.8e-3 rad/s. It does not come from the
gyro: their omega are OXTS's rates in a levelled frame, which differs from the IMU's by roll and
pitch (compared for drive 0005)."""


@dataclass(frozen=True, eq=False)
class TracksRecording:
    """A ``Sequence`` of tracked features; ``open_tracks`` builds it."""

    path: Path
    camera: StereoCamera
    stamps_ns: IntArray
    features: StereoFeatures
    """Features of all frames, one frame after another."""
    first_of_frame: IntArray
    """Row of the first feature of each frame, and the number of all features, [K + 1]."""
    imu: ImuCalibration | None
    imu_stream: ImuStream | None
    truth: GroundTruth | None
    format: str = "tracks"

    def __len__(self) -> int:
        """Return the number of frames, K."""
        return len(self.stamps_ns)

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames from the first."""
        for index in range(len(self)):
            rows = slice(self.first_of_frame[index], self.first_of_frame[index + 1])
            features = StereoFeatures(self.features.ids[rows], self.features.pixels[rows])
            imu = None
            if self.imu_stream is not None and index > 0:
                imu = self.imu_stream.between(
                    int(self.stamps_ns[index - 1]), int(self.stamps_ns[index])
                )
            stamp_ns = int(self.stamps_ns[index])
            yield Frame(index, stamp_ns, features=features, imu=imu)


def open_tracks(path: Path) -> TracksRecording:
    """Open an ``.npz`` file of tracked features.

    Its arrays are::

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
    # Whole seconds of an integer type would overflow in that type.
    t_ns = arrays["t"].astype(np.float64) * NS_PER_S
    if np.abs(t_ns).max() >= INT64_LIMIT:
        what = "these times do not fit in 64 bits of nanoseconds."
        raise InputError(f"{path}: t", what, "Give t in seconds.")
    stamps_ns = check_stamps(np.round(t_ns).astype(np.int64), f"{path}: t")
    fu, fv, cu, cv, baseline_m = (float(value) for value in arrays["camera"])
    camera = StereoCamera(fu_px=fu, fv_px=fv, cu_px=cu, cv_px=cv, baseline_m=baseline_m)
    check_camera(camera, f"{path}: camera")
    ids = arrays["track"].astype(np.int64)
    first_of_frame = _split_frames(arrays["frame"].astype(np.int64), ids, len(stamps_ns), path=path)
    features = StereoFeatures(ids, arrays["uv"].astype(np.float64))
    imu, imu_stream = _imu(arrays, stamps_ns, path)
    truth = None
    if "T_world_cam" in arrays:
        truth = ground_truth(stamps_ns, arrays["T_world_cam"], f"{path}: T_world_cam")
    return TracksRecording(
        path=path,
        camera=camera,
        stamps_ns=stamps_ns,
        features=features,
        first_of_frame=first_of_frame,
        imu=imu,
        imu_stream=imu_stream,
        truth=truth,
    )


def _load(path: Path) -> dict[str, AnyArray]:
    """Read the known arrays of the file, without unpickling anything.

    Raises:
        InputError: the file is no readable archive of plain arrays.
    """
    try:
        return read_npz(path, SHAPES)
    except NO_NPZ as error:
        if str(error).startswith("Object arrays"):
            what = "one of its arrays is pickled; expected plain arrays."
            cure = "Save it as whole numbers or floats, not as objects."
        else:
            # NumPy's own message would advise to allow pickles, which is unsafe.
            what = "this is not a readable .npz file of plain arrays."
            cure = "If it was one, it is cut short or damaged: copy it again."
        raise InputError(path, what, cure) from error


def _check_shapes(arrays: dict[str, AnyArray], path: Path) -> None:
    """Check that every array is present, numeric, finite, and agrees with the others in n and K.

    Raises:
        InputError: names the array at fault.
    """
    missing = [name for name in REQUIRED if name not in arrays]
    if missing:
        raise InputError(
            path, f"the array {missing[0]} is missing.", f"Needed: {', '.join(REQUIRED)}."
        )
    if ("omega" in arrays) != ("C_cam_imu" in arrays):
        raise InputError(path, "of omega and C_cam_imu, one is missing.", "Give both or neither.")
    # n and K are what frame and t have; the other arrays must agree.
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
    """Return the row at which each frame begins, and the number of rows, [K + 1].

    Raises:
        InputError: the frames do not ascend or do not exist, or a track is twice in a frame.
    """
    backwards = np.flatnonzero(np.diff(frame) < 0)
    if len(backwards):
        what = f"row {backwards[0] + 1} (from 0) goes back to frame {frame[backwards[0] + 1]}."
        raise InputError(f"{path}: frame", what, "Sort the observations by frame.")
    if len(frame) and not (frame[0] >= 0 and frame[-1] < frames):
        raise InputError(
            f"{path}: frame", f"frames {frame[0]} to {frame[-1]}, but t has {frames} times."
        )
    # Sorted by frame and identity, a track that is twice in a frame is its own neighbour.
    order = np.lexsort((ids, frame))
    twice = np.flatnonzero((np.diff(frame[order]) == 0) & (np.diff(ids[order]) == 0))
    if len(twice):
        row = order[twice[0]]
        raise InputError(f"{path}: track", f"track {ids[row]} appears twice in frame {frame[row]}.")
    return np.searchsorted(frame, np.arange(frames + 1))


def _imu(
    arrays: dict[str, FloatArray], stamps_ns: IntArray, path: Path
) -> tuple[ImuCalibration | None, ImuStream | None]:
    """Return the IMU's calibration and samples; None for both without an IMU.

    Raises:
        InputError: C_cam_imu is no rotation.
    """
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
        stamps_ns=held_ns,
        gyro_rad_s=gyro,
        accel_m_s2=np.full_like(gyro, np.nan),
        frames_ns=stamps_ns,
        where=f"{path}: omega",
    )
    return calibration, stream
