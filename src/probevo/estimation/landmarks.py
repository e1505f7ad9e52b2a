"""Triangulated points of a frame, with the covariance of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.noise import StereoNoise


@dataclass(frozen=True)
class Landmarks:
    """N points, in the frame of the left camera."""

    ids: IntArray
    """Identity of each point, the same from frame to frame, [N]."""
    pixels: FloatArray
    """(u_l, v_l, u_r, v_r), corrected by the rig's calibration, [N, 4], px."""
    points_m: FloatArray
    """Positions, [N, 3], m."""
    cov_m2: FloatArray
    """Covariance of each position, [N, 3, 3], m², to first order in the pixel noise. Errors of the
    calibration are not included: they are common to all points."""

    @staticmethod
    def none() -> Landmarks:
        """Return no points at all."""
        return Landmarks(
            ids=np.zeros(0, np.int64),
            pixels=np.zeros((0, 4)),
            points_m=np.zeros((0, 3)),
            cov_m2=np.zeros((0, 3, 3)),
        )

    def __len__(self) -> int:
        """Return the number of points, N."""
        return len(self.ids)

    def __repr__(self) -> str:
        """Return number and distance of the points in one line."""
        if not len(self):
            return "Landmarks(0)"
        near_m, far_m = np.percentile(self.points_m[:, 2], [10.0, 90.0])
        return f"Landmarks({len(self)}, {near_m:.3g} to {far_m:.3g} m ahead)"


def triangulated(
    ids: IntArray, pixels: FloatArray, noise: StereoNoise, camera: StereoCamera
) -> Landmarks:
    """Triangulate observations; those without positive disparity are left out.

    Args:
        ids: identity of each observation, [N].
        pixels: observations, [N, 4], px.
        noise: their noise. The scale of a residual counts half, for one of its two observations.
        camera: the rectified camera.
    """
    ahead = pixels[:, 0] > pixels[:, 2]
    pixels = pixels[ahead]
    scale = np.broadcast_to(noise.scale, (len(ahead), 4, 4))[ahead]
    factor = np.broadcast_to(noise.covariance_factor, (len(ahead),))[ahead]
    share = 0.5 if noise.refers_to == "residual" else 1.0
    cov_px2 = share * factor[:, None, None] * scale
    # The error of the disparity that all observations of a point have in common moves u_r.
    if noise.time_correlated is not None:
        cov_px2[:, 2, 2] += np.broadcast_to(noise.time_correlated, (len(ahead),))[ahead]
    G = camera.triangulate_jacobian(pixels)
    return Landmarks(
        ids=ids[ahead],
        pixels=pixels,
        points_m=camera.triangulate(pixels),
        cov_m2=G @ cov_px2 @ G.mT,
    )
