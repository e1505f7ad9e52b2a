"""Prediction of how a camera motion warps the windows around features, each taken as planar.

A window that shows a plane is warped by a homography. Around the feature, it maps a pixel offset x
to p + A x / (1 + g·x). The affine map A alone is not enough: on the road ahead, the lower half of a
window grows more than the upper half, so that an affine alignment would place it too far down.
A and g follow from the motion and from the slant of the plane, which the slope of the disparity
gives.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.camera.stereo import StereoCamera
from probevo.compiled import compiled

MIN_SCALED_DEPTH = 0.05
"""Ratio of new to old depth below which the motion of a point is not predicted."""


class SurfaceMotion(NamedTuple):
    """Where a motion takes the windows around N features."""

    pixels: FloatArray
    """The features p = (u, v), [N, 2], px."""
    growth: FloatArray
    """Old depth over new depth, [N]: the magnification of a surface that faces the camera."""
    ahead: BoolArray
    """Whether the feature is still ahead of the camera, [N]; the others have no prediction."""
    affine: FloatArray
    """Affine map A of the window, [N, 2, 2]."""
    perspective: FloatArray
    """Perspective g of the window, [N, 2], 1/px."""

    def subset(self, keep: BoolArray | IntArray) -> SurfaceMotion:
        """Select some features by a mask, [N], or by indices."""
        return SurfaceMotion(
            pixels=self.pixels[keep],
            growth=self.growth[keep],
            ahead=self.ahead[keep],
            affine=self.affine[keep],
            perspective=self.perspective[keep],
        )

    def where(self, keep: BoolArray, other: SurfaceMotion) -> SurfaceMotion:
        """Return the motion of those features that a mask, [N], keeps, and another one of the
        others."""
        return SurfaceMotion(
            pixels=np.where(keep[:, None], self.pixels, other.pixels),
            growth=np.where(keep, self.growth, other.growth),
            ahead=np.where(keep, self.ahead, other.ahead),
            affine=np.where(keep[:, None, None], self.affine, other.affine),
            perspective=np.where(keep[:, None], self.perspective, other.perspective),
        )


def move_surfaces(
    pixels: FloatArray, slope: FloatArray, T_b_a: FloatArray, camera: StereoCamera
) -> SurfaceMotion:
    """Move the windows around N features from camera pose a to b.

    Args:
        pixels: features in a, (u_l, v_l, u_r, v_r), [N, 4], px.
        slope: derivatives of the disparity by u and v in the window around each, [N, 2]; 0 for a
            surface that faces the camera.
        T_b_a: the motion, [4, 4].
        camera: the rectified camera.
    """
    # Where the features go: q = C m + ρ t, [3, N]; q_z is the new depth over the old one.
    moved_rays, _ = camera.moved_rays(pixels, T_b_a)
    ahead: BoolArray = moved_rays[2] > MIN_SCALED_DEPTH
    growth = 1.0 / np.where(ahead, moved_rays[2], 1.0)
    # Normalised coordinates in b; of points that are not ahead, they mean nothing.
    x = moved_rays[0] * growth
    y = moved_rays[1] * growth
    motion = SurfaceMotion(
        pixels=np.column_stack([camera.fu_px * x + camera.cu_px, camera.fv_px * y + camera.cv_px]),
        growth=growth,
        ahead=ahead,
        affine=np.empty((len(pixels), 2, 2)),
        perspective=np.empty((len(pixels), 2)),
    )
    # n = ∂ρ/∂m, [N, 2], 1/m: with ρ = d/(f_u b) and m = ((u − c_u)/f_u, (v − c_v)/f_v), it is the
    # slope of d times (f_u, f_v), over f_u b.
    focal_px = np.array([camera.fu_px, camera.fv_px])
    gradient = slope * focal_px / (camera.fu_px * camera.baseline_m)
    _differentiate(np.column_stack([x, y]), gradient, T_b_a, focal_px, motion=motion)
    return motion


@compiled
def _differentiate(
    places: FloatArray,
    gradient: FloatArray,
    T_b_a: FloatArray,
    focal_px: FloatArray,
    motion: SurfaceMotion,
) -> None:
    """Fill the affine maps and perspectives.

    A plane's inverse depth ρ is linear in the normalised coordinates m of its image in a, with the
    gradient n. The moved ray q = C m + ρ t is linear in m, too, and the place in b is q over its
    third coordinate. So A = (∂q₁₂/∂m − place · ∂q₃/∂m) / q₃, and g = ∂q₃/∂m / q₃.

    Args:
        places: normalised coordinates in b, [N, 2].
        gradient: n, [N, 2], 1/m.
        T_b_a: [C | t], [4, 4].
        focal_px: (f_u, f_v).
        motion: in: growth; out: affine and perspective.
    """
    for k in range(len(gradient)):
        growth = motion.growth[k]
        for j in range(2):
            # ∂q₃/∂mⱼ = C₃ⱼ + t₃ nⱼ; over the focal length, the derivative is by pixels.
            depth_change = T_b_a[2, j] + T_b_a[2, 3] * gradient[k, j]
            motion.perspective[k, j] = growth * depth_change / focal_px[j]
            for i in range(2):
                change = T_b_a[i, j] + T_b_a[i, 3] * gradient[k, j] - places[k, i] * depth_change
                motion.affine[k, i, j] = growth * change * focal_px[i] / focal_px[j]
