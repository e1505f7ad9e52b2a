"""Rectification of two distorted pinhole cameras to one ``StereoCamera``."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, NoReturn, get_args

import cv2
import numpy as np
from numpy.polynomial import Polynomial

from probevo.arrays import AnyArray, BoolArray, FloatArray, Image
from probevo.camera.image_scale import ImageScale
from probevo.camera.stereo import StereoCamera, check_camera, check_intrinsics
from probevo.errors import InputError, brief
from probevo.geometry import so3

DistortionModel = Literal["radtan", "equidistant"]
UPSIDE_DOWN_DEG = 135.0
"""Roll between the cameras above which half a turn of an image leaves less of it than a quarter
does."""
DIAGONAL_DEG = 1.0
"""Difference of the baseline from the diagonal up to which a quarter of a turn may leave it as far
from the rows; calibrations know its direction better."""
MAX_LEVEL_DEG = 5.0
"""Inclination of the baseline in the image up to which a pair is zoomed until only valid pixels are
left; without distortion, that costs an eighth of either side at most."""
_OUTSIDE_PX = -2.0
"""A place outside of each raw image, where a remapped pixel is black."""
_PixelMaps = tuple[AnyArray, AnyArray]
"""For each rectified pixel its place in the raw image, in OpenCV's fixed-point form."""


@dataclass(frozen=True)
class PinholeCamera:
    """The calibration of one camera before rectification."""

    fu_px: float
    fv_px: float
    cu_px: float
    cv_px: float
    distortion_model: DistortionModel
    """Either "radtan" (Brown-Conrady) or "equidistant" (Kannala-Brandt, for fisheye lenses)."""
    distortion: tuple[float, ...]
    """Coefficients of that model: k1, k2, p1, p2 and perhaps k3, or k3 … k6; or k1 … k4."""
    size_px: tuple[int, int]
    """(width, height)."""

    @property
    def matrix(self) -> FloatArray:
        """Camera matrix K, [3, 3], px."""
        return np.array(
            [[self.fu_px, 0.0, self.cu_px], [0.0, self.fv_px, self.cv_px], [0.0, 0.0, 1.0]]
        )

    def resized(self, size_px: tuple[int, int], where: str | Path) -> PinholeCamera:
        """Return the camera for its images scaled to another size; the distortion is the same.

        Args:
            size_px: (width, height) of the scaled images.
            where: the calibration, for the message.

        Raises:
            InputError: the scaled images have a different aspect ratio.
        """
        scale = ImageScale.between(self.size_px, size_px, where)
        intrinsics = scale.intrinsics(self.fu_px, self.fv_px, self.cu_px, self.cv_px)
        return replace(self, **intrinsics, size_px=size_px)


@dataclass(frozen=True)
class Rectification:
    """A map from pairs of raw images to pairs whose rows align.

    ``from_calibration`` builds it once for a recording.
    """

    camera: StereoCamera
    """The rectified stereo camera."""
    C_rect_left: FloatArray
    """Rotation from the raw to the rectified left camera, [3, 3]; both have the same origin."""
    left_maps: _PixelMaps
    right_maps: _PixelMaps
    left_mask: Image | None
    """Where the rectified left image lies inside the raw one, [height, width], uint8: 255, and 0
    where it does not, or the distortion folds over, and is black. None if it does everywhere."""
    right_mask: Image | None
    """The same of the right image."""
    left: PinholeCamera
    """The left camera before rectification."""
    right: PinholeCamera

    @classmethod
    def from_calibration(
        cls,
        left: PinholeCamera,
        right: PinholeCamera,
        T_right_left: FloatArray,
        where: str | Path = "calibration",
    ) -> Rectification:
        """Rotate both cameras so that their rows align.

        A "radtan" pair is zoomed until every rectified pixel lies inside the raw image. Where the
        line between the cameras is inclined in the images by more than ``MAX_LEVEL_DEG``, that
        would leave little of the view: such a pair is not magnified, and what lies outside of the
        raw images is masked. An "equidistant" pair keeps its focal length, and with it the
        resolution at the centre: the whole field of view of a fisheye lens would cost most of that
        resolution.

        Args:
            left: calibration of the left camera.
            right: calibration of the right camera, of the same size and distortion model.
            T_right_left: p_right = T_right_left p_left, [4, 4], m.
            where: file that the calibration comes from, for messages.

        Raises:
            InputError: a camera is impossible, the two do not match, T_right_left is no rigid
                motion, or the rectified pair is not horizontal or looks elsewhere than the raw
                pair.
        """
        T_right_left = _as_transform(T_right_left, where)
        _check_pair(left, right, T_right_left, where=where)
        C_rect_left, C_rect_right, P_left, P_right = _stereo_rectify(left, right, T_right_left)

        # P_right = K [1 | −b e_x] of a horizontal pair; of a vertical one, the offset is along y.
        # Its fourth column is therefore (−f_u b, 0, 0), from which the baseline follows, with its
        # sign: it is negative if left and right are exchanged.
        if abs(P_right[1, 3]) > abs(P_right[0, 3]):
            _refuse_vertical(T_right_left, where)
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
        left_maps = _pixel_maps(left, C_rect_left, P_left)
        right_maps = _pixel_maps(right, C_rect_right, P_right)
        return cls(
            camera=camera,
            C_rect_left=C_rect_left,
            left_maps=left_maps,
            right_maps=right_maps,
            left_mask=_mask_of(left_maps, left.size_px),
            right_mask=_mask_of(right_maps, right.size_px),
            left=left,
            right=right,
        )

    @classmethod
    def from_projections(
        cls,
        left: PinholeCamera,
        right: PinholeCamera,
        camera: StereoCamera,
        *,
        C_rect_left: FloatArray,
        C_rect_right: FloatArray,
        where: str | Path = "calibration",
    ) -> Rectification:
        """Rectify by rotations and a rectified camera that are known, as ROS's CameraInfo has them.

        Args:
            left: calibration of the left camera.
            right: calibration of the right camera, of the same size.
            camera: the rectified stereo camera.
            C_rect_left: rotation from the raw to the rectified left camera, [3, 3].
            C_rect_right: the same of the right camera.
            where: file that the calibration comes from, for messages.

        Raises:
            InputError: a camera or a rotation is impossible, or the sizes differ.
        """
        _check_pinhole(left, f"{where}: left camera")
        _check_pinhole(right, f"{where}: right camera")
        _check_same("size_px", left, right, where=where)
        # Both rectified cameras have the same K; the maps do not use the fourth column.
        P_rect = np.array(
            [
                [camera.fu_px, 0.0, camera.cu_px, 0.0],
                [0.0, camera.fv_px, camera.cv_px, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ]
        )
        C_rect_left = so3.check_rotation(C_rect_left, f"{where}: R of the left camera")
        C_rect_right = so3.check_rotation(C_rect_right, f"{where}: R of the right camera")
        left_maps = _pixel_maps(left, C_rect_left, P_rect)
        right_maps = _pixel_maps(right, C_rect_right, P_rect)
        return cls(
            camera=camera,
            C_rect_left=C_rect_left,
            left_maps=left_maps,
            right_maps=right_maps,
            left_mask=_mask_of(left_maps, left.size_px),
            right_mask=_mask_of(right_maps, right.size_px),
            left=left,
            right=right,
        )

    def rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Rectify a pair of raw images, [height, width] each.

        Raises:
            InputError: an image is not grey with 8 bits, or its size differs from the
                calibration's.
        """
        self._check_image("left", left)
        self._check_image("right", right)
        return _remapped(left, self.left_maps), _remapped(right, self.right_maps)

    def _check_image(self, name: str, image: object) -> None:
        """Refuse a raw image of another kind than 8-bit grey, or of a wrong size.

        Raises:
            InputError: names the image.
        """
        where = "rectification"
        if not isinstance(image, np.ndarray):
            what = f"the {name} image is {brief(image)}."
            raise InputError(where, what, "Give a NumPy array, [height, width], of type uint8.")
        if image.ndim != 2 or image.dtype != np.uint8:
            what = f"the {name} image is {image.dtype} of shape {image.shape}."
            raise InputError(where, what, "Give a grey image, [height, width], of type uint8.")
        if image.shape[::-1] != self.camera.size_px:
            what = (
                f"the {name} image has shape {image.shape}, the cameras see"
                f" {self.camera.size_px} px."
            )
            raise InputError(where, what, "Give raw images of the size of the calibration.")


def without_unused(distortion: FloatArray) -> FloatArray:
    """Return "radtan" coefficients without thin-prism and tilt terms of zero, which OpenCV and ROS
    append to the eight others."""
    if len(distortion) in (12, 14) and not np.any(distortion[8:]):
        return distortion[:8]
    return distortion


def _as_transform(T_right_left: object, where: str | Path) -> FloatArray:
    """Return a transform between the cameras as an array, [4, 4].

    Raises:
        InputError: it has another shape, or holds something else than numbers.
    """
    given: Any = T_right_left
    try:
        T = np.array(given, np.float64)
    except (TypeError, ValueError):
        T = np.empty(0)
    if T.shape != (4, 4):
        what = f"T_right_left is {brief(T_right_left)}."
        raise InputError(where, what, "Give p_right = T_right_left p_left as [4, 4], in m.")
    return T


def _check_pair(
    left: PinholeCamera, right: PinholeCamera, T_right_left: FloatArray, where: str | Path
) -> None:
    """Refuse two cameras that form no stereo pair.

    Raises:
        InputError: names the property at fault.
    """
    _check_pinhole(left, f"{where}: left camera")
    _check_pinhole(right, f"{where}: right camera")
    _check_same("distortion_model", left, right, where=where)
    _check_same("size_px", left, right, where=where)
    if not np.isfinite(T_right_left).all():
        raise InputError(
            where,
            "T_right_left has an entry that is not finite.",
            "Check the extrinsics of both cameras.",
        )
    so3.check_rotation(T_right_left[:3, :3], f"{where}: T_right_left")
    # The entry is the cosine of the angle between both optical axes.
    if T_right_left[2, 2] <= 0.0:
        what = "the left and right cameras look in opposite directions."
        raise InputError(where, what, "Check the rotation between the cameras.")
    if not T_right_left[:3, 3].any():
        what = "the left and right cameras are at the same place."
        raise InputError(where, what, "Are the left and right calibration the same file?")


def _check_same(name: str, left: PinholeCamera, right: PinholeCamera, where: str | Path) -> None:
    """Refuse two cameras that differ in a property.

    Raises:
        InputError: names the property.
    """
    if getattr(left, name) != getattr(right, name):
        what = (
            f"{name} is {getattr(left, name)} on the left and {getattr(right, name)} on the right."
        )
        raise InputError(where, what, "Both cameras must be of the same kind.")


def _refuse_vertical(T_right_left: FloatArray, where: str | Path) -> NoReturn:
    """Refuse cameras that, rotated halfway towards each other, lie one above the other.

    Raises:
        InputError: always; says whether the right camera is upside down, and how to turn the
            images.
    """
    roll_deg = np.rad2deg(np.arctan2(T_right_left[1, 0], T_right_left[0, 0]))
    if abs(roll_deg) > UPSIDE_DOWN_DEG:
        what = (
            f"the right camera is turned by {abs(roll_deg):.0f}° about its optical axis against the"
            " left one."
        )
        raise InputError(where, what, "Turn its images by 180°, and calibrate with these.")
    C_right_left = T_right_left[:3, :3]
    baseline = so3.exp(-0.5 * so3.log(C_right_left)) @ T_right_left[:3, 3]
    diagonal_deg = np.rad2deg(np.arctan2(abs(baseline[1]), abs(baseline[0]))) - 45.0
    if abs(diagonal_deg) < DIAGONAL_DEG:
        what = f"the line between the cameras is inclined by {45.0 + diagonal_deg:.0f}°."
        cure = "Only cameras side by side are supported; mount them so, or one above the other."
        raise InputError(where, what, cure)
    # v counts downwards: p_right has a larger v than p_left where the right camera lies above.
    is_above = baseline[1] > 0.0
    what = f"the right camera lies {'above' if is_above else 'below'} the left one."
    cure = (
        "Only cameras side by side are supported; turn both images by 90°"
        f" {'clockwise' if is_above else 'anticlockwise'}, and calibrate with these."
    )
    raise InputError(where, what, cure)


def _check_view(camera: StereoCamera, where: str | Path) -> None:
    """Refuse a rectified camera whose optical axis misses the image.

    Raises:
        InputError: the principal point is outside the image.
    """
    # Wrong distortion or rotation moves the principal point far away.
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
    """Refuse intrinsics or distortion coefficients that no camera can have.

    Raises:
        InputError: names the value at fault.
    """
    if camera.distortion_model not in get_args(DistortionModel):
        what = f"distortion_model is {brief(camera.distortion_model)}."
        cure = (
            "Give radtan, which is ROS's plumb_bob, with k1, k2, p1, p2 and then k3 if there is"
            " one; or equidistant, for fisheye lenses, with k1 … k4."
        )
        raise InputError(where, what, cure)
    check_intrinsics(
        fu_px=camera.fu_px,
        fv_px=camera.fv_px,
        cu_px=camera.cu_px,
        cv_px=camera.cv_px,
        size_px=camera.size_px,
        where=where,
    )
    allowed = (4, 5, 8) if camera.distortion_model == "radtan" else (4,)
    given: Any = camera.distortion
    try:
        distortion = np.array(given, np.float64)
    except (TypeError, ValueError):
        distortion = np.empty(0)
    is_list = distortion.ndim == 1 and len(distortion) in allowed
    if not is_list or not np.isfinite(distortion).all():
        cure = (
            f"{camera.distortion_model} takes {' or '.join(map(str, allowed))} finite coefficients."
        )
        raise InputError(where, f"distortion is {brief(camera.distortion)}.", cure)


class _RectifiedPair(NamedTuple):
    """The rectifying rotations and the rectified projections of a pair."""

    C_rect_left: AnyArray
    C_rect_right: AnyArray
    """[3, 3] each."""
    P_left: AnyArray
    P_right: AnyArray
    """[3, 4] each."""


def _stereo_rectify(
    left: PinholeCamera, right: PinholeCamera, T_right_left: FloatArray
) -> _RectifiedPair:
    """Compute the rectifying rotations and the rectified projections."""
    # OpenCV's function knows no fisheye model. Without distortion and zoom it keeps the focal
    # length; the pixel maps undo the distortion.
    unzoomed = _rectified_by_opencv(left, right, T_right_left, zoom=-1.0)
    if left.distortion_model != "radtan":
        return unzoomed
    # OpenCV's alpha of 0: zoom until only valid pixels are left. Where the baseline is inclined in
    # the images, these turn, and little of them would be left.
    zoomed = _rectified_by_opencv(left, right, T_right_left, zoom=0.0)
    baseline = zoomed.C_rect_left[0]  # its direction, in the raw left camera
    is_inclined = abs(baseline[1]) > np.tan(np.deg2rad(MAX_LEVEL_DEG)) * abs(baseline[0])
    is_magnified = zoomed.P_left[0, 0] > unzoomed.P_left[0, 0]
    return unzoomed if is_inclined and is_magnified else zoomed


def _rectified_by_opencv(
    left: PinholeCamera, right: PinholeCamera, T_right_left: FloatArray, *, zoom: float
) -> _RectifiedPair:
    """Compute the rectifying rotations and projections for a zoom, OpenCV's alpha.

    A negative one leaves distortion and zoom out.
    """
    left_distortion = np.array(left.distortion) if zoom >= 0.0 else np.zeros(4)
    right_distortion = np.array(right.distortion) if zoom >= 0.0 else np.zeros(4)
    C_rect_left, C_rect_right, P_left, P_right, *_ = cv2.stereoRectify(
        cameraMatrix1=left.matrix,
        distCoeffs1=left_distortion,
        cameraMatrix2=right.matrix,
        distCoeffs2=right_distortion,
        imageSize=left.size_px,
        R=T_right_left[:3, :3].copy(),  # OpenCV needs contiguous arrays
        T=T_right_left[:3, 3:].copy(),
        flags=cv2.CALIB_ZERO_DISPARITY,  # same principal point: points at infinity have d = 0
        alpha=zoom,
    )
    return _RectifiedPair(C_rect_left, C_rect_right, P_left, P_right)


def _pixel_maps(camera: PinholeCamera, C_rect_cam: FloatArray, P_rect: FloatArray) -> _PixelMaps:
    """Compute where in the raw image each rectified pixel lies."""
    distortion = np.array(camera.distortion)
    if camera.distortion_model == "radtan":
        u, v = cv2.initUndistortRectifyMap(
            cameraMatrix=camera.matrix,
            distCoeffs=distortion,
            R=C_rect_cam,
            newCameraMatrix=P_rect[:, :3],
            size=camera.size_px,
            m1type=cv2.CV_32FC1,
        )
        u[_is_folded(camera, C_rect_cam, P_rect)] = _OUTSIDE_PX
    else:
        u, v = cv2.fisheye.initUndistortRectifyMap(
            K=camera.matrix,
            D=distortion,
            R=C_rect_cam,
            P=P_rect[:, :3],
            size=camera.size_px,
            m1type=cv2.CV_32FC1,
        )
    # (u, v) are places in the raw image, px, [height, width] each. Fixed-point maps make cv2.remap
    # faster than pairs of floats.
    fixed_point, fraction = cv2.convertMaps(u, v, cv2.CV_16SC2)
    return fixed_point, fraction


def _is_folded(camera: PinholeCamera, C_rect_cam: FloatArray, P_rect: FloatArray) -> BoolArray:
    """Return which rectified pixels, [height, width], the "radtan" model maps into the raw image a
    second time: the distorted radius shrinks there instead of growing with the angle."""
    width_px, height_px = camera.size_px
    v, u = np.indices((height_px, width_px))
    x = (u - P_rect[0, 2]) / P_rect[0, 0]
    y = (v - P_rect[1, 2]) / P_rect[1, 1]
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ C_rect_cam
    z = rays[..., 2]
    radius_sq = (rays[..., 0] ** 2 + rays[..., 1] ** 2) / np.where(z > 0.0, z, np.nan) ** 2
    is_beyond: BoolArray = ~(radius_sq < _fold_radius_sq(camera.distortion))
    return is_beyond


def _fold_radius_sq(distortion: Sequence[float]) -> float:
    """Return the squared normalised radius up to which the distorted one grows; it may be inf.

    The small tangential terms are left out.
    """
    coefficients = np.zeros(8)
    coefficients[: len(distortion)] = distortion
    k1, k2, _, _, k3, k4, k5, k6 = coefficients.tolist()
    # With s = r², the distorted radius is r N(s) / D(s). Its derivative has the sign of
    # N D + 2 s (N' D − N D').
    numerator = Polynomial([1.0, k1, k2, k3])
    denominator = Polynomial([1.0, k4, k5, k6])
    change = numerator.deriv() * denominator - numerator * denominator.deriv()
    sign = numerator * denominator + Polynomial([0.0, 2.0]) * change
    roots = np.concatenate([sign.trim().roots(), denominator.trim().roots()])
    is_real = np.abs(roots.imag) <= 1e-9 * np.abs(roots)
    positive = roots.real[is_real & (roots.real > 0.0)]
    return float(positive.min(initial=np.inf))


def _remapped(image: Image, maps: _PixelMaps) -> Image:
    """Sample an image bilinearly at the places that the maps give."""
    map_1, map_2 = maps
    remapped = cv2.remap(image, map_1, map_2, interpolation=cv2.INTER_LINEAR)
    return remapped.astype(np.uint8, copy=False)


def _mask_of(maps: _PixelMaps, size_px: tuple[int, int]) -> Image | None:
    """Return which rectified pixels lie inside the raw image, as 255 or 0; None if all do.

    Those of the outermost rows and columns do not count where all others do: a zoom that leaves
    only valid pixels leaves these at the border of the raw image, up to rounding.
    """
    white = np.full(size_px[::-1], 255, np.uint8)
    remapped = _remapped(white, maps)
    if np.all(remapped[1:-1, 1:-1] == 255):
        return None
    # Between black and white, a pixel lies partly inside.
    return np.where(remapped == 255, 255, 0).astype(np.uint8)
