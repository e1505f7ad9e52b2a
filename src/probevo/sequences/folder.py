"""A plain folder: probevo's own layout for rectified recordings that come from nowhere in
particular."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    FiniteFloat,
    NonNegativeFloat,
    PositiveFloat,
    PositiveInt,
)

from probevo.arrays import IntArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.geometry import so3
from probevo.sequences.frame import ImuCalibration
from probevo.sequences.images import list_pairs
from probevo.sequences.imu import ImuStream
from probevo.sequences.pose_files import read_kitti_truth
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamps import NS_PER_S, read_times
from probevo.sequences.text import read_stamped_csv
from probevo.sequences.yaml_file import read_yaml

IMU_HEADER = "stamp_ns,wx,wy,wz,ax,ay,az"


def _join_rows(value: object) -> object:
    """A matrix written as a list of rows, as one list of numbers."""
    if isinstance(value, list) and all(isinstance(row, list) for row in value):
        return [number for row in value for number in row]
    return value


class ImuSection(BaseModel):
    """The ``imu`` section of ``calib.yaml``."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    C_cam_imu: Annotated[
        tuple[FiniteFloat, ...], Field(min_length=9, max_length=9), BeforeValidator(_join_rows)
    ]
    """Rotation from IMU to left camera coordinates: nine numbers row by row, or three rows of
    three."""
    gyro_noise_rad_s_sqrt_hz: PositiveFloat
    gyro_bias_sigma_rad_s: NonNegativeFloat
    gyro_bias_walk_rad_s2_sqrt_hz: NonNegativeFloat = 0.0
    time_offset_s: FiniteFloat = 0.0
    """Added to the stamps of the samples it gives the clock of the images."""


class FolderCalibration(BaseModel):
    """Content of ``calib.yaml``."""

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
    """Open a folder of this layout::

        left/ right/   rectified images (PNG, JPEG), paired by name, in the natural order of their
        names calib.yaml     fu_px, fv_px, cu_px, cv_px, baseline_m, width_px, height_px, and with
        an IMU the section
                       imu: C_cam_imu, gyro_noise_rad_s_sqrt_hz, gyro_bias_sigma_rad_s
                       [, gyro_bias_walk_rad_s2_sqrt_hz] [, time_offset_s]
        times.txt      time of each frame, one a line: seconds, or whole nanoseconds
        imu.csv        (optional) header stamp_ns,wx,wy,wz,ax,ay,az: rad/s and m/s² in the IMU frame
        poses.txt      (optional) ground truth T_world_cam: the 12 numbers of KITTI a line, nan
        where unknown

    Raises:
        InputError: a file or key is missing, unknown or wrong, or counts differ.
    """
    cure = (
        "Its keys are fu_px, fv_px, cu_px, cv_px, baseline_m, width_px, height_px and, optionally,"
        " imu."
    )
    calibration = read_yaml(path / "calib.yaml", FolderCalibration, cure)
    size_px = (calibration.width_px, calibration.height_px)
    intrinsics = (calibration.fu_px, calibration.fv_px, calibration.cu_px, calibration.cv_px)
    camera = StereoCamera(*intrinsics, calibration.baseline_m, size_px)
    check_camera(camera, path / "calib.yaml")
    left_files, right_files = list_pairs(path / "left", path / "right")
    stamps_ns = read_times(path / "times.txt", len(left_files))
    imu, imu_stream = _read_imu(path, calibration.imu, stamps_ns)
    poses = path / "poses.txt"
    truth = read_kitti_truth(poses, stamps_ns) if poses.exists() else None
    return StereoRecording(
        path,
        "folder",
        camera,
        stamps_ns=stamps_ns,
        left_files=left_files,
        right_files=right_files,
        imu=imu,
        imu_stream=imu_stream,
        truth=truth,
    )


def _read_imu(
    path: Path, section: ImuSection | None, frames_ns: IntArray
) -> tuple[ImuCalibration | None, ImuStream | None]:
    samples = path / "imu.csv"
    if section is None:
        if samples.exists():
            what = "the section imu is missing, but there is an imu.csv."
            raise InputError(
                path / "calib.yaml", what, "Give at least C_cam_imu and the two gyro noise figures."
            )
        return None, None
    cure = "Without an IMU, leave out the section imu of calib.yaml."
    stamps_ns, values = read_stamped_csv(samples, 6, header=IMU_HEADER, cure=cure)
    stamps_ns = stamps_ns + round(section.time_offset_s * NS_PER_S)
    calibration = ImuCalibration(
        so3.check_rotation(
            np.reshape(section.C_cam_imu, (3, 3)), f"{path / 'calib.yaml'}: imu.C_cam_imu"
        ),
        section.gyro_noise_rad_s_sqrt_hz,
        section.gyro_bias_sigma_rad_s,
        gyro_bias_walk_rad_s2_sqrt_hz=section.gyro_bias_walk_rad_s2_sqrt_hz,
    )
    return calibration, ImuStream.checked(
        stamps_ns, values[:, :3], values[:, 3:], frames_ns=frames_ns, where=samples
    )
