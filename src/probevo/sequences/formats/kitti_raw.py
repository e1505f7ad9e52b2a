"""KITTI raw data: a drive in its native layout, ``<date>/<date>_drive_<nnnn>_sync``.

Geiger et al., "Vision meets robotics: the KITTI dataset", IJRR 2013.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.calibrations.kitti_calibration import KittiCalibration
from probevo.sequences.images import list_pairs, natural_order
from probevo.sequences.imu import ImuStream, hold_over_interval
from probevo.sequences.imu_calibration import ImuCalibration
from probevo.sequences.poses import ground_truth, interpolate_poses
from probevo.sequences.recording import StereoRecording
from probevo.sequences.stamps import read_datetimes
from probevo.sequences.text import parse_floats, read_text

EARTH_RADIUS_M = 6378137.0
OXTS_VALUES = 30
LAT_LON_ALT = slice(0, 3)
ROLL_PITCH_YAW = slice(3, 6)
ACCEL_XYZ = slice(11, 14)
GYRO_XYZ = slice(17, 20)  # in the IMU frame; the next three are in a levelled frame

GYRO_NOISE_RAD_S_SQRT_HZ = 1e-3
"""Far more than the noise of the OXTS RT3003 itself, because 10 packets a second do not show how
the rate changed between them. On drive 0005 the gyro's rotation of a frame differs from the images'
by 0.019° rms on each axis, which is 1.0e-3 over 0.103 s."""
GYRO_BIAS_SIGMA_RAD_S = 1e-3
"""The OXTS removes its bias: the mean difference on drive 0005 is below 2e-4 rad/s on each axis."""
ACCEL_NOISE_M_S2_SQRT_HZ = 5e-2
"""Large for the same reason. On drive 0005 the integrated specific force of a packet differs from
the change of OXTS's velocity by 7 to 21 mm/s rms on an axis, which is 2e-2 to 7e-2."""
ACCEL_BIAS_SIGMA_M_S2 = 1e-2
"""The largest mean of that difference on an axis is 6e-3 m/s²."""


def open_kitti_raw(path: Path) -> StereoRecording:
    """Open the grayscale cameras 00 and 01 of a ``*_sync`` drive.

    The calibration is in the parent folder, which is named after the date. OXTS, if present, gives
    the IMU and the ground truth. The truth follows KITTI's development kit (Mercator projection
    scaled at the first latitude), is transformed to the rectified camera 00, and is interpolated
    from the times of the OXTS packets to those of the images: a *sync* drive pairs each image with
    the nearest packet, but that packet is up to 8 ms away, and the offset jumps by 10 ms from frame
    to frame. On drive 0005, interpolated truth differs from the rotation between frames in the
    images (essential matrix) by 0.018° in the median and 0.019° rms in yaw; without interpolation
    by 0.035° and 0.048°.

    Raises:
        InputError: a file or field is missing, counts differ, or a value is impossible.
    """
    calibration = _read_calibration(path, "calib_cam_to_cam.txt")
    width, height = calibration.array("S_rect_00", 2)
    camera = calibration.stereo_camera("P_rect_00", "P_rect_01", (int(width), int(height)))
    left_files, right_files = list_pairs(path / "image_00" / "data", path / "image_01" / "data")
    stamps_ns = read_datetimes(path / "image_00" / "timestamps.txt", len(left_files))
    recording = StereoRecording(
        path=path,
        format="kitti-raw",
        camera=camera,
        stamps_ns=stamps_ns,
        left_files=left_files,
        right_files=right_files,
    )
    return _with_oxts(recording, calibration) if (path / "oxts").is_dir() else recording


def _read_calibration(drive: Path, name: str) -> KittiCalibration:
    """Read a calibration file of the date.

    Raises:
        InputError: it is missing or empty.
    """
    cure = "KITTI's calibration of the date belongs in the folder above the drive."
    return KittiCalibration(drive.resolve().parent / name, cure)


def _with_oxts(recording: StereoRecording, cam_to_cam: KittiCalibration) -> StereoRecording:
    """Return the recording with its IMU and ground truth.

    Raises:
        InputError: a file or field is missing, or a value is impossible.
    """
    oxts_ns, oxts = _read_oxts(recording.path / "oxts")
    T_cam_imu = _rectified_camera_from_imu(recording.path, cam_to_cam)
    T_map_cam = imu_poses(oxts[:, LAT_LON_ALT], oxts[:, ROLL_PITCH_YAW]) @ se3.inverse(T_cam_imu)
    # The packets have times of their own.
    T_map_cam_at_images = interpolate_poses(oxts_ns, T_map_cam, recording.stamps_ns)
    held_ns, gyro = hold_over_interval(oxts_ns, oxts[:, GYRO_XYZ])
    _, accel = hold_over_interval(oxts_ns, oxts[:, ACCEL_XYZ])
    return dataclasses.replace(
        recording,
        imu=ImuCalibration(
            T_cam_imu=T_cam_imu,
            gyro_noise_rad_s_sqrt_hz=GYRO_NOISE_RAD_S_SQRT_HZ,
            gyro_bias_sigma_rad_s=GYRO_BIAS_SIGMA_RAD_S,
            accel_noise_m_s2_sqrt_hz=ACCEL_NOISE_M_S2_SQRT_HZ,
            accel_bias_sigma_m_s2=ACCEL_BIAS_SIGMA_M_S2,
            accel_bias_walk_m_s3_sqrt_hz=0.0,
        ),
        imu_stream=ImuStream.checked(
            stamps_ns=held_ns,
            gyro_rad_s=gyro,
            accel_m_s2=accel,
            frames_ns=recording.stamps_ns,
            where=recording.path / "oxts",
        ),
        truth=ground_truth(recording.stamps_ns, T_map_cam_at_images, recording.path / "oxts"),
    )


def _rectified_camera_from_imu(drive: Path, cam_to_cam: KittiCalibration) -> FloatArray:
    """Return T_cam_imu = T_rect T_cam_velo T_velo_imu, [4, 4]; T_rect is the rotation R_rect_00.

    Raises:
        InputError: a file or field is missing, or a matrix is no rotation.
    """
    T_rect = se3.from_parts(cam_to_cam.rotation("R_rect_00"), np.zeros(3))
    T_cam_velo = _read_calibration(drive, "calib_velo_to_cam.txt").rigid_transform()
    T_velo_imu = _read_calibration(drive, "calib_imu_to_velo.txt").rigid_transform()
    return T_rect @ T_cam_velo @ T_velo_imu


def _read_oxts(folder: Path) -> tuple[IntArray, FloatArray]:
    """Read the stamps, [M], ns, and the packets, [M, 30], of an ``oxts`` folder.

    Raises:
        InputError: there are fewer than two packets, or a packet or stamp is faulty.
    """
    data_files = (folder / "data").glob("[!.]*.txt")  # not macOS's ._ files
    files = sorted(data_files, key=lambda file: natural_order(file.name))
    if len(files) < 2:
        raise InputError(folder / "data", f"{len(files)} OXTS packets; at least 2 are needed.")
    stamps_ns = read_datetimes(folder / "timestamps.txt", len(files))
    packets = []
    for file in files:
        texts = read_text(file).split()
        if len(texts) != OXTS_VALUES:
            raise InputError(file, f"this packet has {len(texts)} values; expected {OXTS_VALUES}.")
        packets.append(parse_floats(texts, str(file)))
    return stamps_ns, np.array(packets)


def imu_poses(lat_lon_alt: FloatArray, roll_pitch_yaw: FloatArray) -> FloatArray:
    """Return T_map_imu, [M, 4, 4], of OXTS packets as KITTI's development kit computes them.

    The axes of the map are east, north and up.

    Args:
        lat_lon_alt: latitude and longitude, degrees, and altitude, m, [M, 3].
        roll_pitch_yaw: attitude, [M, 3], rad; C = R_z(yaw) R_y(pitch) R_x(roll).
    """
    # Mercator projection, whose scale is right at the first latitude.
    lat, lon, alt = lat_lon_alt.T
    scale = np.cos(np.radians(lat[0]))
    east = scale * EARTH_RADIUS_M * np.radians(lon)
    north = scale * EARTH_RADIUS_M * np.log(np.tan(np.radians(90.0 + lat) / 2))
    C = Rotation.from_euler("xyz", roll_pitch_yaw).as_matrix()
    return se3.from_parts(C, np.stack([east, north, alt], axis=1))
