"""The part of the distortion field that changes from place to place, and moves a path by itself.

The distortion field is estimated as if it was that of the lenses alone. It then cancels where a
path comes back: the same pixels err in the same way. But features on other things, near or far,
which come nearer or recede, are mistracked in other ways, and part of what the field holds is that.
So there is a further field d beside that of the lenses, which changes along the path,

    d_k = φ d_{k−1} + noise,    cov(d_k) = ``SHARE`` τ²,

with τ the standard deviation of the coefficients (``camera.image_errors``). With the gain G_k =
∂ξ/∂c of each step, the error of the pose is e_k = Ad_k e_{k−1} + G_k d_k. Over cov(d_k), its
covariance P and its covariance X with d_k follow from

    X_k = φ Ad X_{k−1} + G_k,
    P_k = Ad P_{k−1} Adᵀ + φ Ad X_{k−1} G_kᵀ + φ G_k X_{k−1}ᵀ Adᵀ + G_k G_kᵀ.

It is part of the covariance of poses. Motions within the window are shorter than d lasts: there,
both fields do the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray
from probevo.camera.distortion_field import NUM_COEFFICIENTS
from probevo.estimation.window.equations import POSE
from probevo.geometry import se3

SHARE = 0.5
"""Variance of d over τ². On ways there and back (``benchmarks/there_and_back.py``), where the field
of the lenses cancels, errors of ten pieces of five recordings by four rigs then have a NEES / 6 of
1.0 in the geometric mean; without d, of 8, and with a quarter or all of τ², of 1.5 and 0.65."""
LASTS_FRAMES = 10.0
"""Frames after which the correlation of d has fallen to 1/e, as many as a window has by default:
by then, most features are other ones. With 3 or 30 frames, the NEES of these pieces is much the
same."""


@dataclass(frozen=True)
class FieldVariation:
    """How a field that changes from place to place moves the poses of K frames."""

    cov: FloatArray
    """P of each pose, for a field of unit variance, [K, 6, 6], m²/px² and rad²/px²."""
    cross: FloatArray
    """X of each, [K, 6, NUM_COEFFICIENTS], m/px and rad/px."""

    @staticmethod
    def none() -> FieldVariation:
        """Return that of the first frame, which is not moved."""
        return FieldVariation(np.zeros((1, POSE, POSE)), np.zeros((1, POSE, NUM_COEFFICIENTS)))

    def subset(self, frames: BoolArray | slice) -> FieldVariation:
        """Return that of some of the frames."""
        return FieldVariation(self.cov[frames], self.cross[frames])

    def with_new_frame(self, prev: int, T_curr_prev: FloatArray) -> FieldVariation:
        """Return it with one more frame, whose motion from another, [4, 4], adds no error."""
        adjoint = se3.adjoint(T_curr_prev)
        decay = math.exp(-1.0 / LASTS_FRAMES)
        cov = adjoint @ self.cov[prev] @ adjoint.T
        cross = decay * adjoint @ self.cross[prev]
        return FieldVariation(
            np.concatenate([self.cov, cov[None]]), np.concatenate([self.cross, cross[None]])
        )

    def with_step(self, gain: FloatArray) -> FieldVariation:
        """Return it with the error of the motion to the last frame, of a gain G, [6,
        NUM_COEFFICIENTS]."""
        cov = self.cov.copy()
        cross = self.cross.copy()
        with_before = cross[-1] @ gain.T
        cov[-1] += with_before + with_before.T + gain @ gain.T
        cross[-1] += gain
        return FieldVariation(cov, cross)

    def pose_cov(self, slot: int, sigma_px: float) -> FloatArray:
        """Return the covariance of a pose, [6, 6], with τ the standard deviation of the field."""
        cov: FloatArray = SHARE * sigma_px**2 * self.cov[slot]
        return cov
