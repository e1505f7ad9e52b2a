"""A plain folder: probevo's own layout for rectified recordings from any source."""

from __future__ import annotations

import codecs
from collections.abc import Callable
from dataclasses import dataclass
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
from probevo.camera.rectification import Rectification
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.calibrations.calibration_files import (
    is_stereo_calibration,
    read_stereo_calibration,
)
from probevo.sequences.calibrations.imu_noise_file import with_noise_of
from probevo.sequences.format_options import FolderOptions
from probevo.sequences.frame import GroundTruth
from probevo.sequences.given_truth import truth_of_file
from probevo.sequences.images import list_images, list_pairs, range_of_files, read_gray_of_any_depth
from probevo.sequences.imu import ImuStream
from probevo.sequences.imu_calibration import (
    ACCEL_BIAS_SIGMA_M_S2,
    ACCEL_BIAS_WALK_M_S3_SQRT_HZ,
    ACCEL_NOISE_M_S2_SQRT_HZ,
    ImuCalibration,
)
from probevo.sequences.pose_files import read_kitti_truth
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamp_pairs import paired_images
from probevo.sequences.stamps import (
    FILE_NAMES,
    TIMES,
    check_rate,
    check_stamps,
    read_times,
    spaced_by_number,
    stamps_of_names,
)
from probevo.sequences.text import read_stamped_csv
from probevo.sequences.yaml_file import CalibrationModel, load_yaml, validated

SUN_FILE = "sun.txt"
"""Direction towards the sun, x y z, in the world of the poses: that of the first camera. Networks
of the sun read it."""
IMU_HEADER = "stamp_ns,wx,wy,wz,ax,ay,az"
EUROC_IMU_HEADER = "#timestamp [ns],w_RS_S_x [rad s^-1]"
"""How the first line of EuRoC's ``imu0/data.csv`` begins, which has the same columns."""


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
    readout_s: float = 0.0
    imu: ImuSection | None = None


@dataclass(frozen=True)
class Cameras:
    """The cameras of a recording, and what their file says of the IMU."""

    camera: StereoCamera
    rectification: Rectification | None
    imu: ImuCalibration | None
    where: Path
    """The file."""
    notes: tuple[tuple[str, str], ...] = ()
    """What had to be assumed of the file."""


def open_folder(path: Path, options: FolderOptions | None = None) -> StereoRecording:
    """Open a folder in probevo's own layout.

    It holds::

        left/ right/   images (PNG, JPEG, PGM, TIFF, WebP, BMP; gray or colour, 8 or 16 bits),
                       paired by name, in the natural order of names; rectified, unless the
                       calibration is that of raw images
        calib.yaml     fu_px, fv_px, cu_px, cv_px, baseline_m, width_px, height_px [, readout_s],
                       and with an IMU the section imu: T_cam_imu, gyro_noise_rad_s_sqrt_hz,
                       gyro_bias_sigma_rad_s
                       [, gyro_bias_walk_rad_s2_sqrt_hz] [, accel_noise_m_s2_sqrt_hz]
                       [, accel_bias_sigma_m_s2] [, accel_bias_walk_m_s3_sqrt_hz] [, time_offset_s];
                       or a calibration of raw images, see ``calibration_files``
        times.txt      time of each frame, one a line: seconds, or whole nanoseconds. Not needed
                       where file names are stamps (then these pair the images), or else with
                       rate_hz
        imu.csv        (optional) header stamp_ns,wx,wy,wz,ax,ay,az: rad/s and m/s² in the IMU
                       frame; or a data.csv of EuRoC's imu0
        poses.txt      (optional) ground truth T_world_cam: the 12 numbers of KITTI a line, nan
                       where unknown

    Args:
        path: the folder.
        options: a calibration file instead of ``calib.yaml``, frames a second, true poses.

    Raises:
        InputError: a file or key is missing, unknown or wrong, or counts differ.
    """
    options = options or FolderOptions()
    pictures = _list_pictures(path, options)
    stamps_ns = pictures.stamps_ns

    def size_px() -> tuple[int, int]:
        """Return width and height of the first image, which is read only if they are needed."""
        height, width = read_gray_of_any_depth(pictures.left_files[0]).shape
        return width, height

    cameras = read_cameras(path, options.calibration, size_px, resized=options.resized)
    imu = with_noise_of(cameras.imu, options.imu_noise)
    imu_stream = _read_imu(path, cameras, stamps_ns)
    return StereoRecording(
        path=path,
        format="folder",
        camera=cameras.camera,
        stamps_ns=stamps_ns,
        left_files=pictures.left_files,
        right_files=pictures.right_files,
        imu=imu if imu_stream is not None else None,
        imu_stream=imu_stream,
        truth=_read_truth(path, options, stamps_ns, imu=imu),
        rectification=cameras.rectification,
        gray_range=range_of_files(pictures.left_files, pictures.right_files),
        notes=(*pictures.notes, *cameras.notes, *_notes_on_imu(path, cameras)),
    )


def _notes_on_imu(path: Path, cameras: Cameras) -> tuple[tuple[str, str], ...]:
    """Say where the samples of an IMU are not used, since its pose is not known."""
    samples = path / "imu.csv"
    if cameras.imu is not None or not samples.exists():
        return ()
    text = (
        f"{samples.name} is not used: {cameras.where.name} does not have its pose in the camera's"
        " frame. Give a Kalibr camchain with T_cam_imu as --calibration."
    )
    return (("! IMU", text),)


def _read_truth(
    path: Path, options: FolderOptions, stamps_ns: IntArray, *, imu: ImuCalibration | None
) -> GroundTruth | None:
    """Read the true poses: of the file that the user names, or of ``poses.txt``; None without.

    Raises:
        InputError: the file is faulty, or knows no pose of the frames; or ``truth_of`` is given
            without a file.
    """
    if options.truth is not None:
        return truth_of_file(options.truth, stamps_ns, truth_of=options.truth_of, imu=imu)
    if options.truth_of is not None:
        what = "says whose poses those of --truth are, which is not given."
        cure = "Name the file with --truth; those of poses.txt are the left camera's."
        raise InputError("--truth-of", what, cure)
    poses = path / "poses.txt"
    return read_kitti_truth(poses, stamps_ns) if poses.exists() else None


@dataclass(frozen=True)
class _Pictures:
    """The image files of a folder, and their times."""

    stamps_ns: IntArray
    left_files: list[Path]
    right_files: list[Path]
    notes: tuple[tuple[str, str], ...] = ()


def _list_pictures(path: Path, options: FolderOptions) -> _Pictures:
    """Return the pairs with their times: of ``times.txt``, of the file names, or at a rate.

    Raises:
        InputError: an image lacks its partner, nothing tells the times, or a rate contradicts them.
    """
    times = path / "times.txt"
    rate_hz = options.rate_hz
    if not times.exists() and (rate_hz is None or _are_named_by_stamps(path)):
        pictures = _pictures_by_stamps(path, options.pair_tolerance_ms)
        if rate_hz is not None:
            check_rate(rate_hz, pictures.stamps_ns, path / "left", source=FILE_NAMES)
        return pictures
    left_files, right_files = list_pairs(path / "left", path / "right")
    if rate_hz is None or times.exists():
        stamps_ns = read_times(times, len(left_files))
        if rate_hz is not None:
            check_rate(rate_hz, stamps_ns, times, source=TIMES)
    else:
        stamps_ns = spaced_by_number(left_files, rate_hz)
    return _Pictures(stamps_ns, left_files, right_files)


def _are_named_by_stamps(path: Path) -> bool:
    """Return whether the names of the left images are stamps, and those of the right ones.

    Raises:
        InputError: a folder is missing or empty, or the names are ambiguous.
    """
    return all(stamps_of_names(list_images(path / side)) is not None for side in ("left", "right"))


def _pictures_by_stamps(path: Path, tolerance_ms: float) -> _Pictures:
    """Return the pairs by the stamps in their names, which may differ from left to right.

    Raises:
        InputError: the names are no stamps or ambiguous ones, or few images have a partner.
    """
    left_files = list_images(path / "left")
    right_files = list_images(path / "right")
    left_ns = stamps_of_names(left_files)
    right_ns = stamps_of_names(right_files)
    if left_ns is None or right_ns is None:
        cure = (
            "It gives the time of each frame, in seconds, one a line. Without it, name the images"
            " by their stamps (as 1520530308199447626.png), or give --rate-hz."
        )
        raise InputError(path / "times.txt", "this file is missing.", cure)
    pairs, note = paired_images(left_ns, right_ns, tolerance_ms, where=path, by="the file names")
    return _Pictures(
        stamps_ns=check_stamps(left_ns[pairs.left], path / "left"),
        left_files=[left_files[index] for index in pairs.left],
        right_files=[right_files[index] for index in pairs.right],
        notes=(note,),
    )


def read_cameras(
    folder: Path,
    calibration: Path | None,
    size_px: Callable[[], tuple[int, int]],
    *,
    resized: bool = False,
) -> Cameras:
    """Read the calibration of the cameras: probevo's own, or one of raw images.

    Args:
        folder: where ``calib.yaml`` is.
        calibration: another file; None for that one.
        size_px: returns (width, height) of an image, if that is asked for.
        resized: whether the images may have been scaled since they were calibrated.

    Raises:
        InputError: the file is missing or faulty.
    """
    own_file = folder / "calib.yaml"
    if calibration is None and own_file.exists() and is_stereo_calibration(own_file):
        calibration = own_file
    if calibration is not None:
        raw = read_stereo_calibration(calibration, size_px(), resized=resized)
        rectification = raw.rectification()
        return Cameras(
            camera=rectification.camera,
            rectification=rectification,
            imu=raw.imu(rectification.C_rect_left),
            where=calibration,
            notes=raw.notes,
        )
    own = _read_calibration(own_file)
    camera = StereoCamera(
        fu_px=own.fu_px,
        fv_px=own.fv_px,
        cu_px=own.cu_px,
        cv_px=own.cv_px,
        baseline_m=own.baseline_m,
        size_px=(own.width_px, own.height_px),
        readout_s=own.readout_s,
    )
    if resized:
        camera = camera.resized(size_px(), own_file)
    check_camera(camera, own_file)
    imu = own.imu.calibration(str(own_file)) if own.imu is not None else None
    return Cameras(camera=camera, rectification=None, imu=imu, where=own_file)


def _read_calibration(path: Path) -> FolderCalibration:
    """Read ``calib.yaml``.

    Raises:
        InputError: it is missing, no YAML, or has a missing, unknown or wrong key.
    """
    cure = (
        "Its keys are fu_px, fv_px, cu_px, cv_px, baseline_m, width_px, height_px and, optionally,"
        " readout_s and imu; or it is Kalibr's or OpenCV's file. --calibration FILE reads one from"
        " elsewhere."
    )
    content = load_yaml(path, cure)
    return validated(content, FolderCalibration, path, cure)


def _read_imu(path: Path, cameras: Cameras, frames_ns: IntArray) -> ImuStream | None:
    """Read the IMU's samples; None without an IMU.

    Raises:
        InputError: samples or calibration are missing, or hold a value that cannot be right.
    """
    samples = path / "imu.csv"
    is_own = cameras.where.name == "calib.yaml" and cameras.rectification is None
    if cameras.imu is None:
        if samples.exists() and is_own:
            what = "the section imu is missing, but there is an imu.csv."
            cure = "Give at least T_cam_imu and the two gyro noise figures."
            raise InputError(cameras.where, what, cure)
        return None
    if not samples.exists() and not is_own:
        return None  # a calibration of cameras and IMU, of a recording of the cameras
    cure = "Without an IMU, leave out the section imu of calib.yaml."
    header = None if _is_of_euroc(samples) else IMU_HEADER
    stamps_ns, values = read_stamped_csv(samples, 6, header=header, cure=cure, is_imu=True)
    return ImuStream.checked(
        cameras.imu.on_image_clock(stamps_ns),
        gyro_rad_s=values[:, :3],
        accel_m_s2=values[:, 3:],
        frames_ns=frames_ns,
        where=samples,
    )


def _is_of_euroc(samples: Path) -> bool:
    """Return whether a file of samples begins as those of EuRoC do."""
    if not samples.is_file():
        return False  # whoever reads it says that it is missing
    with samples.open("rb") as file:
        start = file.read(len(codecs.BOM_UTF8) + len(EUROC_IMU_HEADER))
    return start.removeprefix(codecs.BOM_UTF8).startswith(EUROC_IMU_HEADER.encode())
