"""Rectification: two distorted pinhole cameras to the one ``StereoCamera`` that the rest of probevo
sees."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import numpy as np

from probevo.arrays import AnyArray, FloatArray, Image
from probevo.camera.stereo import StereoCamera, check_camera, check_intrinsics
from probevo.errors import InputError
from probevo.geometry import so3

DistortionModel = Literal["radtan", "equidistant"]
_Maps = tuple[AnyArray, AnyArray]


@dataclass(frozen=True)
class PinholeCamera:
    """One camera as it was calibrated, before rectification."""

    fu_px: float
    fv_px: float
    cu_px: float
    cv_px: float
    distortion_model: DistortionModel
    """"radtan" (Brown-Conrady: k1, k2, p1, p2 and perhaps k3) or "equidistant" (Kannala-Brandt
    fisheye: k1 … k4)."""
    distortion: tuple[float, ...]
    """Coefficients of that model, in the order above."""
    size_px: tuple[int, int]
    """(width, height)."""

    @property
    def matrix(self) -> FloatArray:
        """K, [3, 3], px."""
        return np.array(
            [[self.fu_px, 0.0, self.cu_px], [0.0, self.fv_px, self.cv_px], [0.0, 0.0, 1.0]]
        )


@dataclass(frozen=True)
class Rectification:
    """Turns pairs of raw images into pairs whose rows align. Built once a recording by
    ``from_calibration``."""

    camera: StereoCamera
    """The rectified pair."""
    C_rect_left: FloatArray
    """Rotation from the raw left camera to the rectified one, [3, 3]; their origins are the same.
    """
    left_maps: _Maps
    """Where in the raw left image each rectified pixel lies, in OpenCV's fixed-point form."""
    right_maps: _Maps

    @classmethod
    def from_calibration(
        cls,
        left: PinholeCamera,
        right: PinholeCamera,
        T_right_left: FloatArray,
        where: str | Path = "calibration",
    ) -> Rectification:
        """Both cameras turned so that their rows align.

        A "radtan" pair is zoomed so that every pixel lies inside the raw image. An "equidistant"
        pair keeps its focal length, and with it the resolution at the center: to show all of a
        fisheye's field would cost most of that.

        Args:
            left: calibration of the left camera.
            right: that of the right one; of the same size and distortion model.
            T_right_left: p_right = T_right_left p_left, [4, 4], m.
            where: the file at fault, for messages.

        Raises:
            InputError: the two cameras do not match, T_right_left holds no rotation, or no
                horizontal stereo pair results that sees what the raw one saw.
        """
        _check_pair(left, right, T_right_left, where=where)
        C_rect_left, C_rect_right, P_left, P_right = _stereo_rectify(left, right, T_right_left)
        if abs(P_right[1, 3]) > abs(P_right[0, 3]):
            what = "the right camera lies above or below the left one."
            raise InputError(
                where, what, "Only cameras side by side are supported; turn both images by 90°."
            )
        camera = StereoCamera(
            fu_px=float(P_left[0, 0]),
            fv_px=float(P_left[1, 1]),
            cu_px=float(P_left[0, 2]),
            cv_px=float(P_left[1, 2]),
            baseline_m=float(-P_right[0, 3] / P_right[0, 0]),
            size_px=left.size_px,
        )
        check_camera(camera, where)
        _check_view(camera, where)
        left_maps = _raw_pixels(left, C_rect_left, P_left)
        right_maps = _raw_pixels(right, C_rect_right, P_right)
        return cls(camera, C_rect_left, left_maps, right_maps)

    def rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        """The rectified pair, [height, width] each, of a raw pair of the same size.

        Raises:
            InputError: an image has not the size that the cameras were calibrated with.
        """
        for name, image in (("left", left), ("right", right)):
            if image.shape[1::-1] != self.camera.size_px:
                what = (
                    f"the {name} image has shape {image.shape}, the cameras see"
                    f" {self.camera.size_px} px."
                )
                raise InputError(
                    "rectification", what, "Give raw images of the size of the calibration."
                )
        return _remap(left, self.left_maps), _remap(right, self.right_maps)


def _check_pair(
    left: PinholeCamera, right: PinholeCamera, T_right_left: FloatArray, where: str | Path
) -> None:
    _check_pinhole(left, f"{where}: left camera")
    _check_pinhole(right, f"{where}: right camera")
    for name in ("distortion_model", "size_px"):
        if getattr(left, name) != getattr(right, name):
            what = (
                f"{name} is {getattr(left, name)} on the left and {getattr(right, name)} on the"
                " right."
            )
            raise InputError(where, what, "Both cameras must be of the same kind.")
    if not np.isfinite(T_right_left).all():
        raise InputError(
            where,
            "T_right_left has an entry that is not finite.",
            "Check the extrinsics of both cameras.",
        )
    so3.check_rotation(T_right_left[:3, :3], f"{where}: T_right_left")
    if T_right_left[2, 2] <= 0.0:
        what = "the left and right cameras look in opposite directions."
        raise InputError(where, what, "Check the rotation between the cameras.")
    if not T_right_left[:3, 3].any():
        what = "the left and right cameras are at the same place."
        raise InputError(where, what, "Are the left and right calibration the same file?")


def _check_view(camera: StereoCamera, where: str | Path) -> None:
    """Refuse a rectified pair that looks past what it was made from."""
    width_px, height_px = camera.size_px or (0, 0)
    if not (0.0 <= camera.cu_px <= width_px and 0.0 <= camera.cv_px <= height_px):
        what = (
            f"the rectified cameras would look at ({camera.cu_px:.0f}, {camera.cv_px:.0f}) px,"
            " outside the image"
        )
        cure = (
            "Check the distortion, and the rotation between the cameras: both have to look the same"
            " way."
        )
        raise InputError(where, f"{what} of {width_px} × {height_px} px.", cure)


def _check_pinhole(camera: PinholeCamera, where: str) -> None:
    check_intrinsics(
        camera.fu_px,
        camera.fv_px,
        camera.cu_px,
        cv_px=camera.cv_px,
        size_px=camera.size_px,
        where=where,
    )
    allowed = (4, 5) if camera.distortion_model == "radtan" else (4,)
    if len(camera.distortion) not in allowed or not np.isfinite(camera.distortion).all():
        cure = (
            f"{camera.distortion_model} takes {' or '.join(map(str, allowed))} finite coefficients."
        )
        raise InputError(where, f"distortion is {camera.distortion}.", cure)


def _stereo_rectify(
    left: PinholeCamera, right: PinholeCamera, T_right_left: FloatArray
) -> tuple[AnyArray, AnyArray, AnyArray, AnyArray]:
    """C_rect_left, C_rect_right [3, 3] and the rectified projections P_left, P_right [3, 4]."""
    if left.distortion_model == "radtan":
        distortions = (np.array(left.distortion), np.array(right.distortion))
        alpha = 0.0
    else:  # without distortion and zoom: the raw focal length
        distortions = (np.zeros(4), np.zeros(4))
        alpha = -1.0
    C_rect_left, C_rect_right, P_left, P_right, *_ = cv2.stereoRectify(
        left.matrix,
        distortions[0],
        right.matrix,
        distortions[1],
        left.size_px,
        T_right_left[:3, :3].copy(),  # OpenCV wants contiguous blocks
        T_right_left[:3, 3:].copy(),
        flags=cv2.CALIB_ZERO_DISPARITY,
        alpha=alpha,
    )
    return C_rect_left, C_rect_right, P_left, P_right


def _raw_pixels(camera: PinholeCamera, C_rect_cam: FloatArray, P_rect: FloatArray) -> _Maps:
    is_radtan = camera.distortion_model == "radtan"
    undistort_maps = (
        cv2.initUndistortRectifyMap if is_radtan else cv2.fisheye.initUndistortRectifyMap
    )
    distortion = np.array(camera.distortion)
    u, v = undistort_maps(
        camera.matrix, distortion, C_rect_cam, P_rect[:, :3], camera.size_px, cv2.CV_32FC1
    )
    fixed_point, fraction = cv2.convertMaps(u, v, cv2.CV_16SC2)
    return fixed_point, fraction


def _remap(image: Image, maps: _Maps) -> Image:
    return cv2.remap(image, *maps, interpolation=cv2.INTER_LINEAR).astype(np.uint8, copy=False)
