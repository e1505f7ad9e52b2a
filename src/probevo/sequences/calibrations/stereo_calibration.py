"""The calibration of a stereo pair that is not rectified yet, and perhaps of its IMU."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.image_scale import SizePx
from probevo.camera.rectification import PinholeCamera, Rectification
from probevo.camera.stereo import check_camera
from probevo.geometry import se3
from probevo.sequences.imu_calibration import ImuCalibration

GYRO_NOISE_RAD_S_SQRT_HZ = 1e-3
"""White noise of a consumer MEMS gyro as mounted, vibration included. Data sheets say 1e-4 to 3e-4,
and Kalibr's users are advised to inflate them five to tenfold."""
GYRO_BIAS_SIGMA_RAD_S = 0.1
"""Bias of a MEMS gyro at power-up. On the z axis of EuRoC's V1_01 it is 0.077 rad/s."""
GYRO_BIAS_WALK_RAD_S2_SQRT_HZ = 2e-5
"""Bias random walk as in EuRoC's sensor.yaml; TUM-VI's calibration gives 2.2e-5."""


@dataclass(frozen=True)
class StereoCalibration:
    """Two cameras before rectification, and the pose of an IMU if the file gives it."""

    where: Path
    """The file that it was read from."""
    left: PinholeCamera
    right: PinholeCamera
    T_right_left: FloatArray
    """p_right = T_right_left p_left, [4, 4], m."""
    T_left_imu: FloatArray | None = None
    """p_left = T_left_imu p_imu, [4, 4], m; None if the file gives no IMU."""
    time_offset_s: float = 0.0
    """t_imu − t_cam, as Kalibr's ``timeshift_cam_imu``."""
    readout_s: float = 0.0
    """Time from the exposure of the first row of an image to that of the last one; 0 if the file
    does not give it."""
    notes: tuple[tuple[str, str], ...] = ()
    """Name and text of what had to be assumed of the file."""

    def resized(self, size_px: SizePx) -> StereoCalibration:
        """Return the calibration for images that were scaled to another size.

        Raises:
            InputError: the scaled images have a different aspect ratio.
        """
        return replace(
            self,
            left=self.left.resized(size_px, self.where),
            right=self.right.resized(size_px, self.where),
        )

    def rectification(self) -> Rectification:
        """Return the maps that rectify the images.

        Raises:
            InputError: the two cameras form no stereo pair.
        """
        rectification = Rectification.from_calibration(
            self.left, self.right, self.T_right_left, where=self.where
        )
        camera = replace(rectification.camera, readout_s=self.readout_s)
        check_camera(camera, self.where)
        return replace(rectification, camera=camera)

    def imu(self, C_rect_left: FloatArray) -> ImuCalibration | None:
        """Return the IMU's calibration against the rectified left camera; None without an IMU.

        The noise is a consumer IMU's: a calibration of cameras does not give it.
        """
        if self.T_left_imu is None:
            return None
        T_rect_left = se3.from_parts(C_rect_left, np.zeros(3))
        return mems_imu(T_rect_left @ self.T_left_imu, self.time_offset_s)


def mems_imu(T_cam_imu: FloatArray, time_offset_s: float = 0.0) -> ImuCalibration:
    """Return the calibration of a consumer IMU of which only its pose and clock are known."""
    return ImuCalibration(
        T_cam_imu=T_cam_imu,
        gyro_noise_rad_s_sqrt_hz=GYRO_NOISE_RAD_S_SQRT_HZ,
        gyro_bias_sigma_rad_s=GYRO_BIAS_SIGMA_RAD_S,
        gyro_bias_walk_rad_s2_sqrt_hz=GYRO_BIAS_WALK_RAD_S2_SQRT_HZ,
        time_offset_s=time_offset_s,
    )
