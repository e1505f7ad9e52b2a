"""EuRoC MAV data in the ASL layout: ``mav0`` with cam0, cam1, and perhaps an IMU and truth.

Burri et al., "The EuRoC micro aerial vehicle datasets", IJRR 2016.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, FiniteFloat, PositiveFloat, PositiveInt
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray, IntArray
from probevo.camera.image_scale import SizePx
from probevo.camera.rectification import PinholeCamera, Rectification
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.calibrations.calibration_files import read_stereo_calibration
from probevo.sequences.calibrations.stereo_calibration import StereoCalibration
from probevo.sequences.format_options import PAIR_TOLERANCE_MS
from probevo.sequences.frame import GroundTruth
from probevo.sequences.images import range_of_files, read_gray_of_any_depth
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import (
    ACCEL_BIAS_WALK_M_S3_SQRT_HZ,
    ACCEL_NOISE_M_S2_SQRT_HZ,
    ImuCalibration,
)
from probevo.sequences.poses import ground_truth, interpolate_poses
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamp_pairs import paired_images
from probevo.sequences.stamps import check_stamps
from probevo.sequences.text import parse_stamp_ns, read_lines, read_stamped_csv
from probevo.sequences.yaml_file import CalibrationModel, read_yaml

GYRO_BIAS_SIGMA_RAD_S = 0.1
"""Bias of a MEMS gyro at power-up, which sensor.yaml does not give. On the z axis of V1_01 it is
0.077 rad/s."""
ACCEL_BIAS_SIGMA_M_S2 = 0.1
"""Bias of the accelerometer at power-up, which sensor.yaml does not give. The largest on an axis of
V1_01 is 0.066 m/s²."""
IMU = "imu0"
"""Folder of the IMU."""
TRUTH = "state_groundtruth_estimate0"
"""Folder of the true poses."""
CURE = (
    "Both cam0 and cam1 need sensor.yaml, data.csv and data, as EuRoC's files have them;"
    " --calibration FILE, such as Kalibr's camchain, replaces sensor.yaml."
)
DISTORTION_MODELS: dict[str, Literal["radtan", "equidistant"]] = {
    "radial-tangential": "radtan",
    "equidistant": "equidistant",
}


class Extrinsics(CalibrationModel):
    """The matrix T_BS from sensor to body: 16 numbers, row by row."""

    data: Annotated[tuple[FiniteFloat, ...], Field(min_length=16, max_length=16)]


class SensorFile(CalibrationModel):
    """The part that all ``sensor.yaml`` have in common; comments and rates are ignored."""

    T_BS: Extrinsics

    def body_from_sensor(self, where: Path) -> FloatArray:
        """Return T_body_sensor, [4, 4].

        Raises:
            InputError: it holds no rotation.
        """
        T = np.reshape(self.T_BS.data, (4, 4))
        return se3.from_parts(so3.check_rotation(T[:3, :3], f"{where}: T_BS"), T[:3, 3])


class CameraFile(SensorFile):
    """The file ``sensor.yaml`` of a camera."""

    camera_model: Literal["pinhole"]
    intrinsics: tuple[FiniteFloat, FiniteFloat, FiniteFloat, FiniteFloat]
    distortion_model: Literal["radial-tangential", "equidistant"]
    distortion_coefficients: tuple[FiniteFloat, ...]
    resolution: tuple[PositiveInt, PositiveInt]

    def pinhole(self) -> PinholeCamera:
        """Return the camera for the rectification."""
        fu, fv, cu, cv = self.intrinsics
        return PinholeCamera(
            fu_px=fu,
            fv_px=fv,
            cu_px=cu,
            cv_px=cv,
            distortion_model=DISTORTION_MODELS[self.distortion_model],
            distortion=self.distortion_coefficients,
            size_px=self.resolution,
        )


class ImuFile(SensorFile):
    """The file ``sensor.yaml`` of the IMU."""

    gyroscope_noise_density: PositiveFloat
    gyroscope_random_walk: PositiveFloat
    accelerometer_noise_density: PositiveFloat = ACCEL_NOISE_M_S2_SQRT_HZ
    accelerometer_random_walk: PositiveFloat = ACCEL_BIAS_WALK_M_S3_SQRT_HZ


@dataclass(frozen=True)
class Cameras:
    """The rectified pair, and where the body and its IMU are."""

    rectification: Rectification
    T_body_cam: FloatArray | None
    """Pose of the rectified left camera in the body, [4, 4], m; None if nothing gives it."""
    imu_time_offset_s: float = 0.0
    """t_imu − t_cam."""


@dataclass(frozen=True)
class ImagePairs:
    """The pairs of the image files of cam0 and cam1, K of them."""

    stamps_ns: IntArray
    """Stamps of the left images, [K], ascending."""
    left_files: list[Path]
    right_files: list[Path]
    note: tuple[str, str]
    """Name and text of what is to be reported: how many have no partner."""


def open_euroc(
    path: Path,
    calibration: Path | None = None,
    *,
    resized: bool = False,
    pair_tolerance_ms: float = PAIR_TOLERANCE_MS,
) -> StereoRecording:
    """Open cam0 and cam1, which are rectified on the fly, and IMU and ground truth if present.

    Left and right images are paired by their stamps; images without a partner (V2_03 has some) are
    dropped. The truth of ``state_groundtruth_estimate0`` is interpolated to the images. Where
    nothing tells the pose of the camera in the body, IMU and truth are not used; a note says so.

    Args:
        path: ``mav0``, or the folder that holds it.
        calibration: a file of Kalibr or others (``calibration_files``) instead of the
            ``sensor.yaml`` of the cameras.
        resized: whether the images have been scaled since they were calibrated.
        pair_tolerance_ms: largest time between the images of a pair, ms.

    Raises:
        InputError: a file or field is missing, few images have a partner, or a value is impossible.
    """
    mav = path / "mav0" if (path / "mav0").is_dir() else path
    # The folder that holds mav0 has the name of the recording.
    if mav.resolve().name == "mav0":
        path = mav.resolve().parent

    if calibration is None:
        raw = _own_calibration(mav)
        pairs = pair_images(mav, pair_tolerance_ms)
        if resized:
            raw = raw.resized(_size_px(pairs.left_files[0]))
    else:
        pairs = pair_images(mav, pair_tolerance_ms)
        size_px = _size_px(pairs.left_files[0])
        raw = read_stereo_calibration(calibration, size_px, resized=resized)
    stamps_ns = pairs.stamps_ns
    cameras = _cameras_of(raw, mav)
    rectification = cameras.rectification

    imu = None
    imu_stream = None
    truth = None
    notes = (pairs.note, *raw.notes)
    T_body_cam = cameras.T_body_cam
    if T_body_cam is None:
        cure = "Give a Kalibr camchain with T_cam_imu as --calibration."
        notes += notes_without_body(mav, TRUTH, raw.where, cure=cure)
    else:
        if (mav / IMU).is_dir():
            imu, imu_stream = _read_imu(
                mav / IMU, T_body_cam, stamps_ns, time_offset_s=cameras.imu_time_offset_s
            )
        T_truth_cam = _truth_from_body(mav / TRUTH) @ T_body_cam
        truth = read_truth(mav / TRUTH, T_truth_cam, stamps_ns)
    return StereoRecording(
        path=path,
        format="euroc",
        camera=rectification.camera,
        stamps_ns=stamps_ns,
        left_files=pairs.left_files,
        right_files=pairs.right_files,
        imu=imu,
        imu_stream=imu_stream,
        truth=truth,
        rectification=rectification,
        gray_range=range_of_files(pairs.left_files, pairs.right_files),
        notes=notes,
    )


def notes_without_body(
    mav: Path, truth_folder: str, calibration: Path, *, cure: str
) -> tuple[tuple[str, str], ...]:
    """Say that IMU and truth are not used, where nothing tells the camera's pose in the body.

    Args:
        mav: the folder of the sensors.
        truth_folder: that of the true poses of the body, in it.
        calibration: the file that does not have the pose of the IMU.
        cure: how to give it.
    """
    notes = []
    if (mav / IMU / "data.csv").exists():
        text = (
            f"{IMU} is not used: {calibration.name} does not have its pose in the camera's frame."
            f" {cure}"
        )
        notes.append(("! IMU", text))
    if (mav / truth_folder / "data.csv").exists():
        text = (
            f"{truth_folder} is not used: its poses are those of the body, and"
            f" {calibration.name} does not tell where the camera is in it. {cure}"
        )
        notes.append(("! truth", text))
    return tuple(notes)


def _size_px(file: Path) -> SizePx:
    """Return width and height of an image."""
    height, width = read_gray_of_any_depth(file).shape
    return width, height


def _own_calibration(mav: Path) -> StereoCalibration:
    """Read the ``sensor.yaml`` of both cameras.

    Raises:
        InputError: a file or field is missing, or a value is impossible.
    """
    left_yaml = mav / "cam0" / "sensor.yaml"
    right_yaml = mav / "cam1" / "sensor.yaml"
    left = read_yaml(left_yaml, CameraFile, CURE)
    right = read_yaml(right_yaml, CameraFile, CURE)
    T_body_left = left.body_from_sensor(left_yaml)
    T_body_right = right.body_from_sensor(right_yaml)
    return StereoCalibration(
        where=right_yaml,
        left=left.pinhole(),
        right=right.pinhole(),
        T_right_left=se3.inverse(T_body_right) @ T_body_left,
    )


def _cameras_of(raw: StereoCalibration, mav: Path) -> Cameras:
    """Rectify the cameras of a calibration.

    Their pose in the body is that of the IMU with the calibration's ``T_cam_imu``, if it has one,
    or else that of ``cam0/sensor.yaml``, if there is one.

    Raises:
        InputError: a file is faulty, or the two cameras form no stereo pair.
    """
    rectification = raw.rectification()
    T_body_left = None
    imu_yaml = mav / IMU / "sensor.yaml"
    left_yaml = mav / "cam0" / "sensor.yaml"
    if raw.T_left_imu is not None and imu_yaml.parent.is_dir():
        T_body_imu = read_yaml(imu_yaml, ImuFile).body_from_sensor(imu_yaml)
        T_body_left = T_body_imu @ se3.inverse(raw.T_left_imu)
    elif left_yaml.exists():
        T_body_left = read_yaml(left_yaml, SensorFile).body_from_sensor(left_yaml)
    if T_body_left is None:
        return Cameras(rectification, None)
    T_body_cam = T_body_left @ _left_from_rectified(rectification)
    return Cameras(rectification, T_body_cam, raw.time_offset_s)


def _left_from_rectified(rectification: Rectification) -> FloatArray:
    """Return T_left_cam, [4, 4]: the rectified left camera is turned about its own center."""
    return se3.from_parts(rectification.C_rect_left.T, np.zeros(3))


def pair_images(mav: Path, tolerance_ms: float) -> ImagePairs:
    """Return the pairs of the images of cam0 and cam1, by the stamps in ``data.csv``.

    Raises:
        InputError: less than half of the images have a partner, or a file is missing or faulty.
    """
    left_images = _list_images(mav / "cam0")
    right_images = _list_images(mav / "cam1")
    left_ns = np.array(list(left_images), dtype=np.int64)
    right_ns = np.array(list(right_images), dtype=np.int64)
    where = mav / "cam1" / "data.csv"
    pairs, note = paired_images(left_ns, right_ns, tolerance_ms, where=where, by="data.csv")
    stamps_ns = left_ns[pairs.left]
    return ImagePairs(
        stamps_ns=stamps_ns,
        left_files=[left_images[stamp] for stamp in stamps_ns.tolist()],
        right_files=[right_images[stamp] for stamp in right_ns[pairs.right].tolist()],
        note=note,
    )


def _list_images(camera: Path) -> dict[int, Path]:
    """Return the image file of each stamp, ns, as ``data.csv`` lists them.

    Raises:
        InputError: the list is missing or faulty, or a file that it names is missing.
    """
    images: dict[int, Path] = {}
    on_disk = {file.name for file in (camera / "data").glob("*")}
    stamps = []
    for where, line in read_lines(camera / "data.csv"):
        text, _, name = (part.strip() for part in line.partition(","))
        if name not in on_disk:
            raise InputError(
                where, f"the image data/{name} is missing.", "Copy it, or remove this line."
            )
        stamp_ns = parse_stamp_ns(text, where)
        stamps.append(stamp_ns)
        images[stamp_ns] = camera / "data" / name
    check_stamps(np.array(stamps, dtype=np.int64), camera / "data.csv")
    return images


def _read_imu(
    folder: Path, T_body_cam: FloatArray, frames_ns: IntArray, *, time_offset_s: float
) -> tuple[ImuCalibration, ImuStream]:
    """Read the calibration of the IMU against the rectified left camera, and its samples.

    Raises:
        InputError: a file or field is missing or faulty.
    """
    sensor = read_yaml(folder / "sensor.yaml", ImuFile)
    T_body_imu = sensor.body_from_sensor(folder / "sensor.yaml")
    calibration = ImuCalibration(
        T_cam_imu=se3.inverse(T_body_cam) @ T_body_imu,
        gyro_noise_rad_s_sqrt_hz=sensor.gyroscope_noise_density,
        gyro_bias_sigma_rad_s=GYRO_BIAS_SIGMA_RAD_S,
        gyro_bias_walk_rad_s2_sqrt_hz=sensor.gyroscope_random_walk,
        accel_noise_m_s2_sqrt_hz=sensor.accelerometer_noise_density,
        accel_bias_sigma_m_s2=ACCEL_BIAS_SIGMA_M_S2,
        accel_bias_walk_m_s3_sqrt_hz=sensor.accelerometer_random_walk,
        time_offset_s=time_offset_s,
    )
    stamps_ns, values = read_stamped_csv(folder / "data.csv", 6, is_imu=True)
    stream = ImuStream.checked(
        stamps_ns=calibration.on_image_clock(stamps_ns),
        gyro_rad_s=values[:, :3],
        accel_m_s2=values[:, 3:],
        frames_ns=frames_ns,
        where=folder / "data.csv",
    )
    return calibration, stream


def _truth_from_body(folder: Path) -> FloatArray:
    """Return T_truth_body, [4, 4], m, of the sensor whose poses the truth has.

    Its ``sensor.yaml`` gives T_BS as that of any sensor, the identity in EuRoC's own files; without
    the file it is the body itself.

    Raises:
        InputError: the file is faulty.
    """
    path = folder / "sensor.yaml"
    if not path.exists():
        return np.eye(4)
    return se3.inverse(read_yaml(path, SensorFile).body_from_sensor(path))


def read_truth(folder: Path, T_truth_cam: FloatArray, frames_ns: IntArray) -> GroundTruth | None:
    """Return the truth of the rectified left camera at the frames; None if there is none.

    Args:
        folder: the folder of the truth, whose file gives position and quaternion (w, x, y, z) of a
            sensor in the map.
        T_truth_cam: pose of the rectified left camera in the frame of that sensor, [4, 4], m.
        frames_ns: times of the frames, [K].

    Raises:
        InputError: the file is faulty, or knows no pose of the frames.
    """
    path = folder / "data.csv"
    if not path.exists():
        return None
    stamps_ns, values = read_stamped_csv(path, 7)
    check_stamps(stamps_ns, path)
    if len(stamps_ns) < 2:
        raise InputError(path, f"{len(stamps_ns)} poses; at least 2 are needed.")
    quaternions = values[:, 3:7]
    bad = np.flatnonzero(np.abs(np.linalg.norm(quaternions, axis=1) - 1) > 0.01)
    if len(bad):
        what = f"the quaternion of pose {bad[0]} (from 0) is not of unit length."
        raise InputError(path, what, "Order: w, x, y, z.")
    # The camera is fixed to the sensor.
    C = Rotation.from_quat(quaternions, scalar_first=True).as_matrix()
    T_map_cam = se3.from_parts(C, values[:, :3]) @ T_truth_cam
    return ground_truth(frames_ns, interpolate_poses(stamps_ns, T_map_cam, frames_ns), path)
