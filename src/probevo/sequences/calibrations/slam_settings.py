"""Settings files of VINS-Fusion and ORB-SLAM3: the part of them that is a calibration."""

from __future__ import annotations

import numpy as np

from probevo.camera.image_scale import SizePx
from probevo.camera.rectification import PinholeCamera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.calibrations.calibration_content import CalibrationContent, load_calibration
from probevo.sequences.calibrations.stereo_calibration import StereoCalibration


def is_vins_fusion(content: CalibrationContent) -> bool:
    """Return whether a file looks like the settings of VINS-Fusion."""
    return "cam0_calib" in content


def is_vins_camera(content: CalibrationContent) -> bool:
    """Return whether a file looks like one of the two cameras that VINS-Fusion's settings name."""
    return "model_type" in content and "projection_parameters" in content


def read_vins_fusion(content: CalibrationContent, size_px: SizePx | None) -> StereoCalibration:
    """Read the settings of VINS-Fusion, and the two camera files that they name.

    The IMU is the body; ``td`` is added to the clock of the images to get the clock of the IMU.

    Args:
        content: the settings.
        size_px: not needed here, since the camera files have the size.

    Raises:
        InputError: there is one camera only, a file or key is missing, or a camera model is not
            supported.
    """
    del size_px
    if "cam1_calib" not in content:
        what = "it names one camera, cam0_calib; stereo odometry needs cam1_calib, too."
        raise InputError(content.path, what)
    T_body_left = content.transform("body_T_cam0")
    T_body_right = content.transform("body_T_cam1")
    folder = content.path.parent
    has_imu = "imu" in content and content.number("imu") != 0
    return StereoCalibration(
        where=content.path,
        left=_vins_camera(load_calibration(folder / content.text("cam0_calib"))),
        right=_vins_camera(load_calibration(folder / content.text("cam1_calib"))),
        T_right_left=se3.inverse(T_body_right) @ T_body_left,
        T_left_imu=se3.inverse(T_body_left) if has_imu else None,
        time_offset_s=content.number("td") if "td" in content else 0.0,
    )


def _vins_camera(content: CalibrationContent) -> PinholeCamera:
    """Return a camera of VINS-Fusion's ``camodocal``.

    Raises:
        InputError: its model is not supported, or a key is missing.
    """
    model = content.text("model_type")
    size_px = (int(content.number("image_width")), int(content.number("image_height")))
    projection = content.inner("projection_parameters")
    if model == "PINHOLE":
        distortion = content.inner("distortion_parameters")
        return PinholeCamera(
            fu_px=projection.number("fx"),
            fv_px=projection.number("fy"),
            cu_px=projection.number("cx"),
            cv_px=projection.number("cy"),
            distortion_model="radtan",
            distortion=tuple(distortion.number(key) for key in ("k1", "k2", "p1", "p2")),
            size_px=size_px,
        )
    if model == "KANNALA_BRANDT":
        return PinholeCamera(
            fu_px=projection.number("mu"),
            fv_px=projection.number("mv"),
            cu_px=projection.number("u0"),
            cv_px=projection.number("v0"),
            distortion_model="equidistant",
            distortion=tuple(projection.number(key) for key in ("k2", "k3", "k4", "k5")),
            size_px=size_px,
        )
    what = f"the model {model!r} is not supported."
    raise InputError(content.where("model_type"), what, "Known are PINHOLE and KANNALA_BRANDT.")


def is_orb_slam(content: CalibrationContent) -> bool:
    """Return whether a file looks like the settings of ORB-SLAM3."""
    return "Camera.type" in content and "Camera1.fx" in content


def read_orb_slam(content: CalibrationContent, size_px: SizePx | None) -> StereoCalibration:
    """Read stereo settings of ORB-SLAM3 (file version 1.0).

    Args:
        content: the settings.
        size_px: not needed here, since the settings have the size.

    Raises:
        InputError: there is one camera only, a key is missing, or a camera model is not supported.
    """
    del size_px
    model = content.text("Camera.type")
    if model == "Rectified":
        left = _orb_camera(content, "Camera1")
        right = left
        T_right_left = se3.from_parts(np.eye(3), np.array([-content.number("Stereo.b"), 0.0, 0.0]))
    else:
        left = _orb_camera(content, "Camera1")
        right = _orb_camera(content, "Camera2")
        T_right_left = se3.inverse(content.transform("Stereo.T_c1_c2"))
    has_imu = "IMU.T_b_c1" in content
    return StereoCalibration(
        where=content.path,
        left=left,
        right=right,
        T_right_left=T_right_left,
        T_left_imu=se3.inverse(content.transform("IMU.T_b_c1")) if has_imu else None,
    )


def _orb_camera(content: CalibrationContent, name: str) -> PinholeCamera:
    """Return a camera of ORB-SLAM3.

    Raises:
        InputError: its model is not supported, or a key is missing.
    """
    model = content.text("Camera.type")
    if model not in ("PinHole", "KannalaBrandt8", "Rectified"):
        cure = "Known are PinHole, KannalaBrandt8 and Rectified."
        raise InputError(content.where("Camera.type"), f"{model!r} is not supported.", cure)
    is_fisheye = model == "KannalaBrandt8"
    keys = ("k1", "k2", "k3", "k4") if is_fisheye else ("k1", "k2", "p1", "p2", "k3")
    distortion: tuple[float, ...] = (0.0,) * 4
    if model != "Rectified":
        # ORB-SLAM3 takes a pinhole camera without coefficients for an undistorted one.
        names = [f"{name}.{key}" for key in keys]
        distortion = tuple(content.number(key) if key in content else 0.0 for key in names)
    return PinholeCamera(
        fu_px=content.number(f"{name}.fx"),
        fv_px=content.number(f"{name}.fy"),
        cu_px=content.number(f"{name}.cx"),
        cv_px=content.number(f"{name}.cy"),
        distortion_model="equidistant" if is_fisheye else "radtan",
        distortion=distortion,
        size_px=(int(content.number("Camera.width")), int(content.number("Camera.height"))),
    )
