"""The stereo camera of a pair that a data set gives as rectified, by intrinsics and a transform."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.geometry import so3

MAX_ROTATION_RAD = 1e-4
"""Between cameras that are called rectified; over an image of 1,000 px, it is 0.1 px. Text files
with six decimals round rotations by less."""
MAX_OFFSET = 1e-3
"""Offset along the other two axes, relative to the baseline; it is a rounding error likewise."""


@dataclass(frozen=True)
class PinholeIntrinsics:
    """Focal lengths and principal point, px."""

    fu_px: float
    fv_px: float
    cu_px: float
    cv_px: float


def rectified_camera(
    left: PinholeIntrinsics,
    right: PinholeIntrinsics,
    T_right_left: FloatArray,
    *,
    size_px: tuple[int, int],
    where: str | Path,
) -> StereoCamera:
    """Return the stereo camera of a rectified pair.

    Args:
        left: of the left camera.
        right: of the right camera.
        T_right_left: p_right = T_right_left p_left, [4, 4], m.
        size_px: (width, height) of the images.
        where: file that the calibration comes from, for messages.

    Raises:
        InputError: the pair is not rectified, or a value is impossible.
    """
    if left != right:
        what = f"the intrinsics of both cameras differ: {left} and {right}."
        raise InputError(where, what, "Those of a rectified pair are equal.")
    rotation_rad = float(np.linalg.norm(so3.log(T_right_left[:3, :3])))
    offset_m = T_right_left[:3, 3]
    is_level = np.abs(offset_m[1:]).max() <= MAX_OFFSET * abs(offset_m[0])
    if rotation_rad > MAX_ROTATION_RAD or not is_level:
        what = (
            f"the right camera is turned by {np.rad2deg(rotation_rad):.3g}° and moved by"
            f" ({', '.join(f'{value:.4g}' for value in offset_m)}) m relative to the left one."
        )
        cure = "This pair is not rectified; use the layout folder with --calibration."
        raise InputError(where, what, cure)
    camera = StereoCamera(
        fu_px=left.fu_px,
        fv_px=left.fv_px,
        cu_px=left.cu_px,
        cv_px=left.cv_px,
        baseline_m=float(-offset_m[0]),
        size_px=size_px,
    )
    check_camera(camera, where)
    return camera
