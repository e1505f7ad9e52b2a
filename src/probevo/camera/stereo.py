"""The rectified stereo camera: y = f(p), its inverse p = g(y), and the Jacobian of each (PROBE eqs. 2, 9)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray


@dataclass(frozen=True)
class StereoCamera:
    """Two identical pinhole cameras with parallel axes, the right one ``baseline_m`` along +x of the left.

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

    def project(self, points: FloatArray) -> FloatArray:
        """y = f(p): points [..., 3], m, to observations [..., 4], px (PROBE eq. 2). Points need z > 0."""
        x, y, z = np.moveaxis(points, -1, 0)
        u_l = self.fu_px * x / z + self.cu_px
        v = self.fv_px * y / z + self.cv_px
        return np.stack([u_l, v, u_l - self.fu_px * self.baseline_m / z, v], axis=-1)

    def triangulate(self, pixels: FloatArray) -> FloatArray:
        """p = g(y): observations [..., 4], px, to points [..., 3], m. They need a positive disparity.

        The two rows are averaged, which makes g the least-squares inverse of f for rows of equal noise, and f(g(y)) = y
        wherever v_l = v_r.
        """
        u_l, v_l, u_r, v_r = np.moveaxis(pixels, -1, 0)
        z = self.fu_px * self.baseline_m / (u_l - u_r)
        x = (u_l - self.cu_px) * z / self.fu_px
        y = (0.5 * (v_l + v_r) - self.cv_px) * z / self.fv_px
        return np.stack([x, y, z], axis=-1)

    def project_jacobian(self, points: FloatArray) -> FloatArray:
        """F = ∂f/∂p at points [..., 3]: [..., 4, 3], px/m."""
        x, y, z = np.moveaxis(points, -1, 0)
        jacobian = np.zeros((*points.shape[:-1], 4, 3))
        jacobian[..., 0, 0] = jacobian[..., 2, 0] = self.fu_px / z
        jacobian[..., 1, 1] = jacobian[..., 3, 1] = self.fv_px / z
        jacobian[..., 0, 2] = -self.fu_px * x / z**2
        jacobian[..., 1, 2] = jacobian[..., 3, 2] = -self.fv_px * y / z**2
        jacobian[..., 2, 2] = -self.fu_px * (x - self.baseline_m) / z**2
        return jacobian

    def triangulate_jacobian(self, pixels: FloatArray) -> FloatArray:
        """G = ∂g/∂y at observations [..., 4]: [..., 3, 4], m/px (PROBE eq. 9)."""
        u_l, _, u_r, _ = np.moveaxis(pixels, -1, 0)
        disparity = u_l - u_r
        point = self.triangulate(pixels)
        z = point[..., 2]
        jacobian = -point[..., :, None] / disparity[..., None, None] * np.array([1.0, 0.0, -1.0, 0.0])
        jacobian[..., 0, 0] += z / self.fu_px
        jacobian[..., 1, 1] += 0.5 * z / self.fv_px
        jacobian[..., 1, 3] += 0.5 * z / self.fv_px
        return jacobian
