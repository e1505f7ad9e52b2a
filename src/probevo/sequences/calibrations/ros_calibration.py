"""The YAML files of ROS's ``camera_calibration``, one for each camera: left.yaml, right.yaml."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.image_scale import SizePx
from probevo.camera.rectification import PinholeCamera, without_unused
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.calibrations.calibration_content import CalibrationContent, load_calibration
from probevo.sequences.calibrations.ros_camera_info import DISTORTION_MODELS
from probevo.sequences.calibrations.stereo_calibration import StereoCalibration


def is_ros(content: CalibrationContent) -> bool:
    """Return whether a file looks like a camera of ROS."""
    return "camera_matrix" in content and "projection_matrix" in content


def read_ros(content: CalibrationContent, size_px: SizePx | None) -> StereoCalibration:
    """Read the file of one camera, and the other camera's, whose name has the other side.

    The pose of the pair follows from the rectification: with the rotations R and the baseline b
    of the right camera's P, C_right_left = R_rightᵀ R_left and t = R_rightᵀ (−b, 0, 0).

    Args:
        content: the file of the left or of the right camera.
        size_px: not needed here, since the files have the size.

    Raises:
        InputError: the other file or a key is missing, the distortion model is not supported, or
            the pair is not calibrated.
    """
    del size_px
    left, right = _both(content)
    R_left = _rotation(left)
    R_right = _rotation(right)
    P_left = left.matrix("projection_matrix", 3, 4)
    P_right = right.matrix("projection_matrix", 3, 4)
    if P_right[0, 0] <= 0.0 or P_right[0, 3] == P_left[0, 3]:
        what = "has no baseline: its fourth number, −fx·b, is that of the left camera."
        cure = "Calibrate both cameras together, as `cameracalibrator` does for stereo."
        raise InputError(right.where("projection_matrix"), what, cure)
    baseline_m = (P_left[0, 3] - P_right[0, 3]) / P_right[0, 0]
    t_right = R_right.T @ np.array([-baseline_m, 0.0, 0.0])
    return StereoCalibration(
        where=content.path,
        left=_pinhole(left),
        right=_pinhole(right),
        T_right_left=se3.from_parts(R_right.T @ R_left, t_right),
    )


def _both(content: CalibrationContent) -> tuple[CalibrationContent, CalibrationContent]:
    """Return the files of the left and of the right camera.

    Raises:
        InputError: the name of the file does not tell its side, or the other file is missing.
    """
    name = content.path.name
    if "left" in name:
        other = content.path.with_name(name.replace("left", "right"))
        return content, load_calibration(other)
    if "right" in name:
        other = content.path.with_name(name.replace("right", "left"))
        return load_calibration(other), content
    what = "it is one camera of ROS, and its name does not tell which is the other one."
    raise InputError(content.path, what, "Call the files left.yaml and right.yaml.")


def _rotation(camera: CalibrationContent) -> FloatArray:
    """Return the rotation from the raw to the rectified camera, [3, 3].

    Raises:
        InputError: the matrix is no rotation.
    """
    key = "rectification_matrix"
    return so3.check_rotation(camera.matrix(key, 3, 3), camera.where(key))


def _pinhole(camera: CalibrationContent) -> PinholeCamera:
    """Return a camera for the rectification.

    Raises:
        InputError: its distortion model is not supported, or a key is missing.
    """
    name = camera.text("distortion_model")
    if name not in DISTORTION_MODELS:
        what = f"the model {name!r} is not supported."
        known = ", ".join(model for model in DISTORTION_MODELS if model)
        raise InputError(camera.where("distortion_model"), what, f"Known are {known}.")
    K = camera.matrix("camera_matrix", 3, 3)
    distortion = camera.numbers("distortion_coefficients")
    return PinholeCamera(
        fu_px=float(K[0, 0]),
        fv_px=float(K[1, 1]),
        cu_px=float(K[0, 2]),
        cv_px=float(K[1, 2]),
        distortion_model=DISTORTION_MODELS[name],
        distortion=tuple(without_unused(distortion).tolist()),
        size_px=(int(camera.number("image_width")), int(camera.number("image_height"))),
    )
