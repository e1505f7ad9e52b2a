"""A plain folder: probevo's own layout for rectified recordings from any source."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import (
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
)

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.images import list_pairs
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import (
    ACCEL_BIAS_SIGMA_M_S2,
    ACCEL_BIAS_WALK_M_S3_SQRT_HZ,
    ACCEL_NOISE_M_S2_SQRT_HZ,
    ImuCalibration,
)
from probevo.sequences.pose_files import read_kitti_truth
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamps import read_times
from probevo.sequences.text import read_stamped_csv
from probevo.sequences.yaml_file import CalibrationModel, load_yaml, validated

IMU_HEADER = "stamp_ns,wx,wy,wz,ax,ay,az"


def _join_rows(value: object) -> object:
    """Return a matrix that is written as a list of rows as one list of numbers."""
    if isinstance(value, list) and all(isinstance(row, list) for row in value):
        return [number for row in value for number in row]
    return value


class ImuSection(CalibrationModel):
    """The section ``imu`` of ``calib.yaml``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    T_cam_imu: Annotated[
        tuple[FiniteFloat, ...], Field(min_length=16, max_length=16), BeforeValidator(_join_rows)
    ]
    """p_cam = T_cam_imu p_imu: four rows of four numbers, or sixteen numbers row by row."""
    gyro_noise_rad_s_sqrt_hz: PositiveFloat
    gyro_bias_sigma_rad_s: NonNegativeFloat
    gyro_bias_walk_rad_s2_sqrt_hz: NonNegativeFloat = 0.0
    accel_noise_m_s2_sqrt_hz: PositiveFloat = ACCEL_NOISE_M_S2_SQRT_HZ
    accel_bias_sigma_m_s2: NonNegativeFloat = ACCEL_BIAS_SIGMA_M_S2
    accel_bias_walk_m_s3_sqrt_hz: NonNegativeFloat = ACCEL_BIAS_WALK_M_S3_SQRT_HZ
    time_offset_s: FiniteFloat = 0.0
    """t_imu − t_cam, as Kalibr's ``timeshift_cam_imu``: the reader takes it off the stamps of the
    samples."""

    def calibration(self, where: str) -> ImuCalibration:
        """Return the calibration that the section holds.

        Raises:
            InputError: T_cam_imu is no rigid transform.
        """
        matrix: FloatArray = np.reshape(self.T_cam_imu, (4, 4))
        return ImuCalibration(
            T_cam_imu=se3.check_transform(matrix, f"{where}: imu.T_cam_imu"),
            gyro_noise_rad_s_sqrt_hz=self.gyro_noise_rad_s_sqrt_hz,
            gyro_bias_sigma_rad_s=self.gyro_bias_sigma_rad_s,
            gyro_bias_walk_rad_s2_sqrt_hz=self.gyro_bias_walk_rad_s2_sqrt_hz,
            accel_noise_m_s2_sqrt_hz=self.accel_noise_m_s2_sqrt_hz,
            accel_bias_sigma_m_s2=self.accel_bias_sigma_m_s2,
            accel_bias_walk_m_s3_sqrt_hz=self.accel_bias_walk_m_s3_sqrt_hz,
            time_offset_s=self.time_offset_s,
        )


class FolderCalibration(CalibrationModel):
    """The content of ``calib.yaml``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    fu_px: float
    fv_px: float
    cu_px: float
    cv_px: float
    baseline_m: float
    width_px: PositiveInt
    height_px: PositiveInt
    imu: ImuSection | None = None


def open_folder(path: Path) -> StereoRecording:
    """Open a folder in probevo's own layout.

    It holds::

        left/ right/   rectified images (PNG, JPEG), paired by name, in the natural order of names
        calib.yaml     fu_px, fv_px, cu_px, cv_px, baseline_m, width_px, height_px, and with an IMU
                       the section imu: T_cam_imu, gyro_noise_rad_s_sqrt_hz, gyro_bias_sigma_rad_s
                       [, gyro_bias_walk_rad_s2_sqrt_hz] [, accel_noise_m_s2_sqrt_hz]
                       [, accel_bias_sigma_m_s2] [, accel_bias_walk_m_s3_sqrt_hz] [, time_offset_s]
        times.txt      time of each frame, one a line: seconds, or whole nanoseconds
        imu.csv        (optional) header stamp_ns,wx,wy,wz,ax,ay,az: rad/s and m/s² in the IMU frame
        poses.txt      (optional) ground truth T_world_cam: the 12 numbers of KITTI a line, nan
                       where unknown

    Raises:
        InputError: a file or key is missing, unknown or wrong, or counts differ.
    """
    calibration_file = path / "calib.yaml"
    calibration = _read_calibration(calibration_file)
    camera = StereoCamera(
        fu_px=calibration.fu_px,
        fv_px=calibration.fv_px,
        cu_px=calibration.cu_px,
        cv_px=calibration.cv_px,
        baseline_m=calibration.baseline_m,
        size_px=(calibration.width_px, calibration.height_px),
    )
    check_camera(camera, calibration_file)
    left_files, right_files = list_pairs(path / "left", path / "right")
    stamps_ns = read_times(path / "times.txt", len(left_files))
    imu, imu_stream = _read_imu(path, calibration.imu, stamps_ns)
    poses = path / "poses.txt"
    truth = read_kitti_truth(poses, stamps_ns) if poses.exists() else None
    return StereoRecording(
        path=path,
        format="folder",
        camera=camera,
        stamps_ns=stamps_ns,
        left_files=left_files,
        right_files=right_files,
        imu=imu,
        imu_stream=imu_stream,
        truth=truth,
    )


def _read_calibration(path: Path) -> FolderCalibration:
    """Read ``calib.yaml``.

    Raises:
        InputError: it is missing, no YAML, has a missing, unknown or wrong key, or the IMU's
            rotation of earlier versions instead of its transform.
    """
    cure = (
        "Its keys are fu_px, fv_px, cu_px, cv_px, baseline_m, width_px, height_px and, optionally,"
        " imu."
    )
    content = load_yaml(path, cure)
    section = content.get("imu") if isinstance(content, dict) else None
    if isinstance(section, dict) and "C_cam_imu" in section:
        what = "this rotation has been replaced by T_cam_imu, the whole transform p_cam ← p_imu."
        imu_cure = (
            "Write T_cam_imu instead: four rows of four, the rotation C_cam_imu with the position"
            " of the IMU in the camera's frame, m, as fourth column and 0 0 0 1 as fourth row; a"
            " zero position means what C_cam_imu meant."
        )
        if "time_offset_s" in section:
            imu_cure += " And reverse the sign of time_offset_s: it is t_imu − t_cam, as Kalibr's."
        raise InputError(f"{path}: imu.C_cam_imu", what, imu_cure)
    return validated(content, FolderCalibration, path, cure)


def _read_imu(
    path: Path, section: ImuSection | None, frames_ns: IntArray
) -> tuple[ImuCalibration | None, ImuStream | None]:
    """Read the IMU's calibration and its samples; None for both without an IMU.

    Raises:
        InputError: one of the two is missing, or holds a value that cannot be right.
    """
    samples = path / "imu.csv"
    if section is None:
        if samples.exists():
            what = "the section imu is missing, but there is an imu.csv."
            cure = "Give at least T_cam_imu and the two gyro noise figures."
            raise InputError(path / "calib.yaml", what, cure)
        return None, None
    cure = "Without an IMU, leave out the section imu of calib.yaml."
    stamps_ns, values = read_stamped_csv(samples, 6, header=IMU_HEADER, cure=cure)
    calibration = section.calibration(str(path / "calib.yaml"))
    stream = ImuStream.checked(
        calibration.on_image_clock(stamps_ns),
        gyro_rad_s=values[:, :3],
        accel_m_s2=values[:, 3:],
        frames_ns=frames_ns,
        where=samples,
    )
    return calibration, stream
