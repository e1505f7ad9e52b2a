"""Kalibr's ``camchain.yaml`` and ``camchain-imucam.yaml``, and OpenVINS's variant of them.

Furgale, Rehder, Siegwart, "Unified temporal and spatial calibration for multi-sensor systems",
IROS 2013; the keys are those of Kalibr's wiki.
"""

from __future__ import annotations

from probevo.arrays import FloatArray
from probevo.camera.image_scale import SizePx
from probevo.camera.rectification import DistortionModel, PinholeCamera
from probevo.errors import InputError
from probevo.geometry import se3
from probevo.sequences.calibrations.calibration_content import CalibrationContent
from probevo.sequences.calibrations.stereo_calibration import StereoCalibration

MODELS: dict[str, DistortionModel] = {
    "radtan": "radtan",
    "equidistant": "equidistant",
    "none": "radtan",
}
"""Kalibr's names of distortion models."""
UNSUPPORTED = {
    "ds": "double sphere",
    "eucm": "extended unified",
    "omni": "omnidirectional (Mei)",
    "fov": "field of view",
}
"""Kalibr's names of models that are refused, in words."""


def is_kalibr(content: CalibrationContent) -> bool:
    """Return whether a file looks like Kalibr's."""
    cam0 = content.values.get("cam0")
    return isinstance(cam0, dict) and "intrinsics" in cam0


def read_kalibr(content: CalibrationContent, size_px: SizePx | None) -> StereoCalibration:
    """Read cam0 as the left and cam1 as the right camera.

    Their relative pose is ``T_cn_cnm1`` of cam1, or else follows from both poses of the IMU
    (``T_cam_imu``, or OpenVINS's inverse ``T_imu_cam``).

    Args:
        content: the file.
        size_px: not needed here, since the file has the resolution.

    Raises:
        InputError: there is one camera only, a key is missing or impossible, a camera model is not
            supported.
    """
    del size_px
    if "cam1" not in content:
        what = "it holds one camera, cam0; stereo odometry needs cam1, too."
        raise InputError(content.path, what, "Calibrate both cameras together.")
    left = content.inner("cam0")
    right = content.inner("cam1")
    T_left_imu = _imu_pose(left)
    T_right_imu = _imu_pose(right)
    if "T_cn_cnm1" in right:
        T_right_left = right.transform("T_cn_cnm1")
    elif T_left_imu is not None and T_right_imu is not None:
        T_right_left = T_right_imu @ se3.inverse(T_left_imu)
    else:
        what = "cam1.T_cn_cnm1 is missing: the pose of cam0 in the frame of cam1."
        raise InputError(content.path, what)
    has_shift = "timeshift_cam_imu" in left
    return StereoCalibration(
        where=content.path,
        left=_pinhole(left),
        right=_pinhole(right),
        T_right_left=T_right_left,
        T_left_imu=T_left_imu,
        time_offset_s=left.number("timeshift_cam_imu") if has_shift else 0.0,
        readout_s=_readout_s(left),
    )


def _readout_s(camera: CalibrationContent) -> float:
    """Return the time from the first row to the last one; 0 if the file does not give it."""
    if "line_delay" not in camera:
        return 0.0
    _, height_px = camera.size_px("resolution")
    return camera.number("line_delay") * (height_px - 1)


def _imu_pose(camera: CalibrationContent) -> FloatArray | None:
    """Return T_cam_imu, [4, 4]; None if the file has no IMU.

    Raises:
        InputError: it is no rigid transform.
    """
    if "T_cam_imu" in camera:
        return camera.transform("T_cam_imu")
    if "T_imu_cam" in camera:
        return se3.inverse(camera.transform("T_imu_cam"))
    return None


def _pinhole(camera: CalibrationContent) -> PinholeCamera:
    """Return a camera for the rectification.

    Raises:
        InputError: its model is not supported, or a key is missing.
    """
    model = camera.text("camera_model")
    if model != "pinhole":
        _refuse_model(camera, "camera_model", model)
    distortion_model = camera.text("distortion_model")
    if distortion_model not in MODELS:
        _refuse_model(camera, "distortion_model", distortion_model)
    fu, fv, cu, cv = camera.matrix("intrinsics", 1, 4)[0].tolist()
    is_distorted = distortion_model != "none"
    return PinholeCamera(
        fu_px=fu,
        fv_px=fv,
        cu_px=cu,
        cv_px=cv,
        distortion_model=MODELS[distortion_model],
        distortion=(
            tuple(camera.numbers("distortion_coeffs").tolist()) if is_distorted else (0.0,) * 4
        ),
        size_px=camera.size_px("resolution"),
    )


def _refuse_model(camera: CalibrationContent, key: str, model: str) -> None:
    """Refuse a camera model by its name.

    Raises:
        InputError: always.
    """
    name = f"{model!r} ({UNSUPPORTED[model]})" if model in UNSUPPORTED else repr(model)
    cure = "Calibrate with Kalibr's pinhole-radtan, or pinhole-equi for fisheye lenses."
    raise InputError(camera.where(key), f"the model {name} is not supported.", cure)
