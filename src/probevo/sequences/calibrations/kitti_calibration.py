"""Calibration files of KITTI, which hold one ``NAME: numbers`` a line."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray
from probevo.camera.stereo import StereoCamera, check_camera
from probevo.errors import InputError
from probevo.geometry import se3, so3
from probevo.sequences.text import parse_floats, read_lines


class KittiCalibration:
    """One calibration file. Fields are parsed on request, since some of them hold dates."""

    def __init__(self, path: Path, cure: str = "") -> None:
        """Read the file.

        Args:
            path: the file.
            cure: where to get the file if it is missing.

        Raises:
            InputError: the file is missing or empty.
        """
        self.path = path
        self._texts = dict(line.partition(":")[::2] for _, line in read_lines(path, cure))

    def array(self, field: str, *shape: int) -> FloatArray:
        """Return the numbers of one field in ``shape``.

        Raises:
            InputError: the field is missing, or has another count of numbers.
        """
        if field not in self._texts:
            raise InputError(
                self.path, f"the field {field} is missing.", f"Found: {', '.join(self._texts)}."
            )
        numbers = np.array(parse_floats(self._texts[field].split(), f"{self.path}: {field}"))
        if numbers.size != np.prod(shape):
            raise InputError(
                f"{self.path}: {field}", f"{numbers.size} numbers; expected {np.prod(shape)}."
            )
        return numbers.reshape(shape)

    def rotation(self, field: str) -> FloatArray:
        """Return the rotation matrix of one field, [3, 3].

        Raises:
            InputError: the field is missing, or no rotation.
        """
        return so3.check_rotation(self.array(field, 3, 3), f"{self.path}: {field}")

    def rigid_transform(self) -> FloatArray:
        """Return the transform of rotation R and translation T, [4, 4].

        Raises:
            InputError: a field is missing, or R is no rotation.
        """
        return se3.from_parts(self.rotation("R"), self.array("T", 3))

    def stereo_camera(self, left: str, right: str, size_px: tuple[int, int]) -> StereoCamera:
        """Return the stereo camera of two projections P = K [1 | −b e_x].

        Args:
            left: name of the field with the left projection.
            right: name of the field with the right projection.
            size_px: (width, height) of the images.

        Raises:
            InputError: the two differ in more than the baseline, or the baseline is not positive.
        """
        P_left = self.array(left, 3, 4)
        P_right = self.array(right, 3, 4)
        if not np.allclose(P_left[:, :3], P_right[:, :3]):
            what = f"{left} and {right} differ in focal length or principal point."
            raise InputError(self.path, what, "The images must be rectified to one common camera.")
        # The last column of P is −f b of the camera; only their difference is the baseline.
        shift_px_m = float(P_left[0, 3] - P_right[0, 3])
        fu = float(P_left[0, 0])
        fv = float(P_left[1, 1])
        baseline_m = shift_px_m / fu if fu else float("nan")
        camera = StereoCamera(
            fu_px=fu,
            fv_px=fv,
            cu_px=float(P_left[0, 2]),
            cv_px=float(P_left[1, 2]),
            baseline_m=baseline_m,
            size_px=size_px,
        )
        check_camera(camera, f"{self.path}: {right}")
        return camera

    def T_cam0_cam(self, projection: str) -> FloatArray:
        """Return the pose of a rectified camera in camera 0, [4, 4], m.

        Args:
            projection: name of the field with its projection P = K [1 | t].
        """
        P = self.array(projection, 3, 4)
        t = np.linalg.solve(P[:, :3], P[:, 3]).astype(float)
        return se3.from_parts(np.eye(3), -t)
