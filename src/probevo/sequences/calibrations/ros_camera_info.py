"""CameraInfo of ROS: the rectified stereo camera, and the maps that rectify raw images."""

from __future__ import annotations

from copy import copy
from typing import Any, NamedTuple

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.image_scale import ImageScale, SizePx
from probevo.camera.rectification import (
    DistortionModel,
    PinholeCamera,
    Rectification,
    without_unused,
)
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError

DISTORTION_MODELS: dict[str, DistortionModel] = {
    "": "radtan",
    "plumb_bob": "radtan",
    "rational_polynomial": "radtan",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
}
"""Names of distortion models in ROS; drivers of rectified cameras leave it empty."""


class _Roi(NamedTuple):
    """The part of the calibrated images that is sent, px; of no size where it is all."""

    x_offset: int
    y_offset: int
    width: int
    height: int


_NO_ROI = _Roi(0, 0, 0, 0)


class CameraInfo:
    """The fields of a sensor_msgs/CameraInfo; ROS 1 names them K, D, R, P, ROS 2 k, d, r, p."""

    def __init__(self, message: Any, where: str) -> None:
        self.where = where
        self.size_px = (int(message.width), int(message.height))
        self.K: FloatArray = _field(message, "K").reshape(3, 3)
        self.D: FloatArray = _field(message, "D").ravel()
        self.R: FloatArray = _field(message, "R").reshape(3, 3)
        self.P: FloatArray = _field(message, "P").reshape(3, 4)
        self.model: str = message.distortion_model
        roi = getattr(message, "roi", None)
        self.roi = _NO_ROI if roi is None else _roi(roi)
        # 0 is the same as 1: every pixel.
        binning_x = max(int(getattr(message, "binning_x", 1)), 1)
        binning_y = max(int(getattr(message, "binning_y", 1)), 1)
        self.binning = (binning_x, binning_y)
        if not self.R.any():  # what drivers send that do not know it
            self.R = np.eye(3)

    @property
    def is_rectified(self) -> bool:
        """Whether the raw images of this camera are rectified already."""
        is_same = np.allclose(self.K, self.P[:, :3], rtol=0.0, atol=1e-6)
        return not self.D.any() and np.allclose(self.R, np.eye(3), atol=1e-9) and is_same

    def as_sent(self, size_px: SizePx) -> CameraInfo:
        """Return the calibration of images of which only a region is sent, or only the means of
        some pixels (``roi``, ``binning_x``, ``binning_y``).

        Args:
            size_px: (width, height) of the images; those of the size that was calibrated are whole,
                whatever the message says.
        """
        is_whole = self.roi.width == 0 or self.roi.height == 0
        roi = _Roi(0, 0, *self.size_px) if is_whole else self.roi
        sent_px = (roi.width // self.binning[0], roi.height // self.binning[1])
        if sent_px == self.size_px or size_px == self.size_px:
            return self
        factors = np.array([[1.0 / self.binning[0]], [1.0 / self.binning[1]], [1.0]])
        sent = copy(self)
        sent.size_px = sent_px
        sent.roi = _NO_ROI
        sent.binning = (1, 1)
        sent.K = factors * self.K
        sent.P = factors * self.P  # the baseline of P is in pixels, too
        for matrix, whole in ((sent.K, self.K), (sent.P, self.P)):
            # Pixel (0, 0) has its centre at the origin: the corner of the region lies at −½.
            corner_px = np.array([roi.x_offset, roi.y_offset]) - 0.5
            matrix[:2, 2] = (whole[:2, 2] - corner_px) / self.binning - 0.5
        return sent

    def resized(self, size_px: SizePx) -> CameraInfo:
        """Return the calibration for images that were scaled to another size.

        Raises:
            InputError: the scaled images have another shape.
        """
        scale = ImageScale.between(self.size_px, size_px, self.where)
        factors = np.array([[scale.along_u], [scale.along_v], [1.0]])
        scaled = copy(self)
        scaled.size_px = size_px
        scaled.K = factors * self.K
        scaled.K[:2, 2] = scale.place(self.K[0, 2], self.K[1, 2])
        scaled.P = factors * self.P  # the baseline of P is in pixels, too
        scaled.P[:2, 2] = scale.place(self.P[0, 2], self.P[1, 2])
        return scaled

    def pinhole(self) -> PinholeCamera:
        """Return the camera before rectification.

        Raises:
            InputError: its distortion model is not supported.
        """
        if self.model not in DISTORTION_MODELS:
            known = ", ".join(name for name in DISTORTION_MODELS if name)
            what = f"the distortion model {self.model!r} is not supported."
            raise InputError(self.where, what, f"Supported are {known}.")
        model = DISTORTION_MODELS[self.model]
        distortion = without_unused(self.D) if len(self.D) else np.zeros(4)
        return PinholeCamera(
            fu_px=float(self.K[0, 0]),
            fv_px=float(self.K[1, 1]),
            cu_px=float(self.K[0, 2]),
            cv_px=float(self.K[1, 2]),
            distortion_model=model,
            distortion=tuple(distortion.tolist()),
            size_px=self.size_px,
        )


def stereo_camera(left: CameraInfo, right: CameraInfo) -> StereoCamera:
    """Return the rectified camera: P_left = K [1 | 0], and P_right = K [1 | −b e_x].

    Raises:
        InputError: the pair is not calibrated, is vertical, or has two focal lengths.
    """
    cure = "Give the calibration of the pair with --calibration FILE."
    if not left.P[0, 0] or not right.P[0, 0]:
        raise InputError(left.where, "P is zero: the camera is not calibrated.", cure)
    if not np.allclose(left.P[:, :3], right.P[:, :3], rtol=1e-6, atol=1e-3):
        what = f"P differs from that of {right.where} in more than the baseline."
        raise InputError(left.where, what, cure)
    if right.P[0, 3] == left.P[0, 3]:
        what = "P has no baseline: its fourth number, −fx·b, is that of the left camera."
        raise InputError(right.where, what, cure)
    fu_px = float(left.P[0, 0])
    camera = StereoCamera(
        fu_px=fu_px,
        fv_px=float(left.P[1, 1]),
        cu_px=float(left.P[0, 2]),
        cv_px=float(left.P[1, 2]),
        baseline_m=float(left.P[0, 3] - right.P[0, 3]) / fu_px,
        size_px=left.size_px,
    )
    check_camera(camera, right.where)
    return camera


def rectification_of(left: CameraInfo, right: CameraInfo) -> Rectification:
    """Return the maps from raw images to the images of ``stereo_camera``.

    Raises:
        InputError: a distortion model is not supported, or a value is impossible.
    """
    return Rectification.from_projections(
        left.pinhole(),
        right.pinhole(),
        stereo_camera(left, right),
        C_rect_left=left.R,
        C_rect_right=right.R,
        where=left.where,
    )


def _roi(message: Any) -> _Roi:
    """Return the fields of a sensor_msgs/RegionOfInterest."""
    return _Roi(
        x_offset=int(message.x_offset),
        y_offset=int(message.y_offset),
        width=int(message.width),
        height=int(message.height),
    )


def _field(message: Any, name: str) -> FloatArray:
    """Return a field of numbers by the name that it has in ROS 1."""
    values = getattr(message, name) if hasattr(message, name) else getattr(message, name.lower())
    return np.array(values, dtype=float)
