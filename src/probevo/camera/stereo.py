"""The rectified stereo camera: y = f(p), its inverse p = g(y), and the Jacobian of g.

The equations are PROBE's (2) and (9).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.image_scale import ImageScale
from probevo.errors import InputError, brief

MAX_READOUT_S = 1.0
"""Longest time from the first row of an image to the last one."""
MAX_M = 1e9
"""Largest baseline."""
MAX_PX = 1e9
"""Largest focal length and coordinate of a principal point; much larger ones would overflow."""
MAX_FOCAL_LENGTHS = 100.0
"""Largest distance of the principal point from the first pixel, which is so seen at 89.4° from the
optical axis; rectified images of the widest lenses reach a tenth of it."""


@dataclass(frozen=True)
class StereoCamera:
    """Two identical pinhole cameras with parallel axes.

    The right camera is ``baseline_m`` along +x of the left one.
    Points are in the left camera's frame (x right, y down, z forward), m. Observations are
    y = (u_l, v_l, u_r, v_r) in px of the rectified images.
    """

    fu_px: float
    fv_px: float
    cu_px: float
    cv_px: float
    baseline_m: float
    size_px: tuple[int, int] | None = None
    """(width, height) of the images; None where only features are known."""
    readout_s: float = 0.0
    """Time from the exposure of the first row of an image to that of the last one, where it is
    known (``camera.rolling_shutter``). Otherwise 0, and the images show it."""

    def __post_init__(self) -> None:
        """Take a size that is a list, as YAML has it, for the tuple that it is compared with."""
        if isinstance(self.size_px, list | tuple | np.ndarray):
            sides: Any = self.size_px
            object.__setattr__(self, "size_px", tuple(_as_whole(side) for side in sides))

    @property
    def extent_px(self) -> tuple[float, float]:
        """(width, height) of the images; of a camera without a size, the principal point is taken
        for their middle.

        They have two pixels at least: where pixels count from the principal point, nothing tells.
        """
        if self.size_px is None:
            return max(2.0 * self.cu_px + 1.0, 2.0), max(2.0 * self.cv_px + 1.0, 2.0)
        return float(self.size_px[0]), float(self.size_px[1])

    @staticmethod
    def centered(focal_px: float, baseline_m: float, size_px: tuple[int, int]) -> StereoCamera:
        """Return a camera with square pixels and its principal point in the image centre.

        Args:
            focal_px: focal length, px.
            baseline_m: distance of the right camera from the left one, m.
            size_px: (width, height) of the images.
        """
        width, height = size_px
        return StereoCamera(
            fu_px=focal_px,
            fv_px=focal_px,
            cu_px=0.5 * (width - 1),
            cv_px=0.5 * (height - 1),
            baseline_m=baseline_m,
            size_px=size_px,
        )

    def resized(self, size_px: tuple[int, int], where: str | Path) -> StereoCamera:
        """Return the camera for its images scaled to another size.

        Args:
            size_px: (width, height) of the scaled images.
            where: the calibration, for the message.

        Raises:
            InputError: the size of the camera's own images is not known, or has a different aspect
                ratio.
        """
        if self.size_px is None:
            raise InputError(where, "the size of its images is not known.")
        scale = ImageScale.between(self.size_px, size_px, where)
        intrinsics = scale.intrinsics(self.fu_px, self.fv_px, self.cu_px, self.cv_px)
        return replace(self, **intrinsics, size_px=size_px)

    def project(self, points: FloatArray) -> FloatArray:
        """Project points: y = f(p) (PROBE eq. 2).

        Args:
            points: [..., 3], m, with z > 0.

        Returns:
            Observations, [..., 4], px.
        """
        x, y, z = np.moveaxis(points, -1, 0)
        u_l = self.fu_px * x / z + self.cu_px
        v = self.fv_px * y / z + self.cv_px
        return np.stack([u_l, v, u_l - self.fu_px * self.baseline_m / z, v], axis=-1)

    def triangulate(self, pixels: FloatArray) -> FloatArray:
        """Triangulate observations: p = g(y).

        The two rows are averaged, which makes g the least-squares inverse of f for rows of equal
        noise; f(g(y)) = y wherever v_l = v_r.

        Args:
            pixels: observations, [..., 4], px, with positive disparity.

        Returns:
            Points, [..., 3], m.
        """
        u_l, v_l, u_r, v_r = np.moveaxis(pixels, -1, 0)
        z = self.fu_px * self.baseline_m / (u_l - u_r)
        x = (u_l - self.cu_px) * z / self.fu_px
        y = (0.5 * (v_l + v_r) - self.cv_px) * z / self.fv_px
        return np.stack([x, y, z], axis=-1)

    def normalized(self, u_px: FloatArray, v_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the normalised coordinates x = (u − c_u)/f_u and y = (v − c_v)/f_v, left image."""
        return (u_px - self.cu_px) / self.fu_px, (v_px - self.cv_px) / self.fv_px

    def unit_rays(self, pixels: FloatArray) -> FloatArray:
        """Return unit vectors towards observations in the left image, [N, ≥ 2], px, to [N, 3]."""
        x, y = self.normalized(pixels[:, 0], pixels[:, 1])
        rays = np.column_stack([x, y, np.ones_like(x)])
        unit: FloatArray = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return unit

    def moved_rays(self, pixels: FloatArray, T_b_a: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Move the points at N observations [N, 4], px, each divided by its depth in a.

        The ray is taken from the left image, and no disparity is negative: a point that noise puts
        beyond infinity is at infinity. ``camera.transfer``, which predicts observations, takes the
        mean of both rows instead, and negative disparities as they are.

        Returns:
            q = C m + ρ t, [3, N], with the ray m = (x, y, 1); q_z is the depth in b over that in a.
            And the inverse depth ρ in a, [N], 1/m, which is 0 (at infinity) where the disparity is
            not positive.
        """
        # T p over the depth z in a: with p = z m and ρ = 1/z = d/(f_u b), C p + t = z (C m + ρ t).
        rho = np.maximum(pixels[:, 0] - pixels[:, 2], 0.0) / (self.fu_px * self.baseline_m)
        rays = np.empty((3, len(pixels)))
        rays[0], rays[1] = self.normalized(pixels[:, 0], pixels[:, 1])
        rays[2] = 1.0
        return T_b_a[:3, :3] @ rays + T_b_a[:3, 3, None] * rho, rho

    def triangulate_jacobian(self, pixels: FloatArray) -> FloatArray:
        """Return G = ∂g/∂y, [..., 3, 4], m/px, at observations [..., 4], px (PROBE eq. 9)."""
        u_l, _, u_r, _ = np.moveaxis(pixels, -1, 0)
        disparity = u_l - u_r
        point = self.triangulate(pixels)
        z = point[..., 2]
        # All of p scales with the depth, which goes with 1 / disparity: ∂p/∂d = −p/d, and ∂d/∂y =
        # (1, 0, −1, 0).
        jacobian: FloatArray = (
            -point[..., :, None] / disparity[..., None, None] * np.array([1.0, 0.0, -1.0, 0.0])
        )
        # Besides, x depends on u_l, and y on the mean of both rows.
        jacobian[..., 0, 0] += z / self.fu_px
        jacobian[..., 1, 1] += 0.5 * z / self.fv_px
        jacobian[..., 1, 3] += 0.5 * z / self.fv_px
        return jacobian


def check_camera(camera: StereoCamera, where: str | Path) -> None:
    """Refuse a calibration that no stereo camera can have.

    Args:
        camera: as read from a file or an option.
        where: that file or option, for the message.

    Raises:
        InputError: the baseline is not finite and positive, the readout time is impossibly long, or
            as ``check_intrinsics`` raises.
    """
    check_intrinsics(
        fu_px=camera.fu_px,
        fv_px=camera.fv_px,
        cu_px=camera.cu_px,
        cv_px=camera.cv_px,
        size_px=camera.size_px,
        where=where,
    )
    if not _is_number(camera.baseline_m) or not abs(camera.baseline_m) <= MAX_M:
        raise InputError(
            where, f"baseline_m is {brief(camera.baseline_m)}.", "It must be a finite number."
        )
    if camera.baseline_m == 0:
        raise InputError(
            where, "baseline_m is 0 m.", "Are the left and right calibration the same file?"
        )
    if camera.baseline_m < 0:
        raise InputError(
            where,
            f"baseline_m is {camera.baseline_m:g} m.",
            "Are the left and right cameras swapped? Exchange them: images or topics, and"
            " calibrations.",
        )
    if not _is_number(camera.readout_s) or not abs(camera.readout_s) <= MAX_READOUT_S:
        raise InputError(
            where,
            f"readout_s is {brief(camera.readout_s)} s.",
            f"An image takes at most {MAX_READOUT_S:g} s; Kalibr's line_delay is in seconds a row.",
        )


def check_intrinsics(
    *,
    fu_px: float,
    fv_px: float,
    cu_px: float,
    cv_px: float,
    size_px: tuple[int, int] | None,
    where: str | Path,
) -> None:
    """Refuse intrinsics that no pinhole camera can have.

    Raises:
        InputError: a value is no finite number, a focal length or the image size is not positive,
            or the principal point is more than half an image outside the image or a hundred focal
            lengths from the first pixel.
    """
    for name, value in {"fu_px": fu_px, "fv_px": fv_px, "cu_px": cu_px, "cv_px": cv_px}.items():
        if not _is_number(value) or not abs(value) <= MAX_PX:
            what = f"{name} is {brief(value)}."
            raise InputError(where, what, f"It must be a finite number, at most {MAX_PX:g} px.")
    for name, focal_px in {"fu_px": fu_px, "fv_px": fv_px}.items():
        if focal_px <= 0:
            raise InputError(where, f"{name} is {focal_px:g} px.", "A focal length is positive.")
    for name, center_px, focal_px in (("cu_px", cu_px, fu_px), ("cv_px", cv_px, fv_px)):
        if abs(center_px) > MAX_FOCAL_LENGTHS * focal_px:
            raise InputError(
                where,
                f"{name} is {center_px:g} px, with a focal length of {focal_px:g} px.",
                f"The principal point is at most {MAX_FOCAL_LENGTHS:g} focal lengths from the"
                " first pixel.",
            )
    if size_px is None:
        return
    is_pair = isinstance(size_px, tuple) and len(size_px) == 2
    if not is_pair or not all(isinstance(side, int | np.integer) for side in size_px):
        what = f"size_px is {brief(size_px)}."
        raise InputError(where, what, "It is (width, height), both whole numbers.")
    if max(size_px) > MAX_PX:
        what = f"size_px is {brief(tuple(size_px))}."
        raise InputError(where, what, f"An image has at most {MAX_PX:g} columns and rows.")
    size = f"{size_px[0]} × {size_px[1]}"
    if min(size_px) <= 0:
        raise InputError(where, f"size_px is {size}.", "It is (width, height), both positive.")
    for name, center_px, length_px in (("cu_px", cu_px, size_px[0]), ("cv_px", cv_px, size_px[1])):
        if not -0.5 * length_px <= center_px <= 1.5 * length_px:
            what = f"{name} is {center_px:g} px, far outside the image of {size} px."
            raise InputError(where, what, "Was the camera calibrated at another resolution?")


def _is_number(value: object) -> bool:
    """Return whether a value is a single number; one of another type cannot be compared."""
    return isinstance(value, int | float | np.integer | np.floating)


def _as_whole(side: object) -> object:
    """Return a side of an image as an int if it is a whole number, and else as it is."""
    if isinstance(side, np.integer):
        return int(side)
    if isinstance(side, float | np.floating) and side.is_integer():
        return int(side)
    return side
