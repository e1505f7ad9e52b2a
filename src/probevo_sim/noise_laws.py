"""How wrong a simulated observation is: σ as a function of where it lies, and errors drawn from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo_sim.point_config import LawName, PointConfig

Profile = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""Place in one image → how bad it is there: u and v from 0 to 1 across the image, and the disparity
from 0 to 1, that of the nearest landmarks, [N] each, to [N], 0 where σ is low and 1 where it is
high."""


def _middle(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    return np.full_like(u, 0.5)


def _row(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    return 1.0 - v


def _column(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    return u


def _radius(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    distance: FloatArray = np.hypot(2.0 * u - 1.0, 2.0 * v - 1.0) / np.sqrt(2.0)
    return distance


def _disparity(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    return disparity


PROFILES: dict[LawName, Profile] = {
    "constant": _middle,
    "row": _row,
    "column": _column,
    "radius": _radius,
    "disparity": _disparity,
    "heavy-tailed": _middle,
}
DOF: dict[LawName, float] = {"heavy-tailed": 5.0}
"""Degrees of freedom of the laws that are Student-t unless told otherwise; 5 is what Kerl et al.
2013 found."""


@dataclass(frozen=True)
class NoiseLaw:
    """Zero-mean noise of stereo observations, which depends on where in the images each lies.

    The two coordinates in an image are independent and have the same σ; left and right are
    correlated, u with u and v with v.
    """

    profile: Profile
    sigma_px: tuple[float, float]
    """σ of a coordinate where the profile is 0, and where it is 1."""
    correlation: float
    """Of the errors of a coordinate in the left and in the right image, −1 to 1."""
    dof: float
    """Degrees of freedom of the errors, over 2; np.inf is Gaussian. The covariance does not depend
    on it."""
    size_px: tuple[int, int]
    """Width and height of the images."""
    largest_disparity_px: float
    """Disparity at which the profile gets 1."""

    @staticmethod
    def of(config: PointConfig) -> NoiseLaw:
        """The law that the settings name."""
        noise = config.noise
        camera = config.camera
        return NoiseLaw(
            PROFILES[noise.law],
            (noise.sigma_low_px, noise.sigma_high_px),
            noise.correlation,
            dof=noise.dof or DOF.get(noise.law, np.inf),
            size_px=(camera.width_px, camera.height_px),
            largest_disparity_px=camera.focal_px * camera.baseline_m / camera.nearest_m,
        )

    def sigma(self, pixels: FloatArray) -> FloatArray:
        """Standard deviation of each coordinate of true observations [N, 4], px: [N, 4], px.

        Beyond the images and the nearest landmark it is that of the nearest place within.
        """
        u = np.clip(pixels[:, 0::2] / (self.size_px[0] - 1), 0.0, 1.0)  # [N, 2]: left, right
        v = np.clip(pixels[:, 1::2] / (self.size_px[1] - 1), 0.0, 1.0)
        disparity = np.clip((pixels[:, 0] - pixels[:, 2]) / self.largest_disparity_px, 0.0, 1.0)
        low, high = self.sigma_px
        sides = [
            low + (high - low) * self.profile(u[:, side], v[:, side], disparity) for side in (0, 1)
        ]
        return np.column_stack([sides[0], sides[0], sides[1], sides[1]])

    def covariance(self, pixels: FloatArray) -> FloatArray:
        """Covariance of the errors of true observations [N, 4], px: [N, 4, 4], px²."""
        sigma = self.sigma(pixels)
        between = np.eye(4) + self.correlation * np.eye(4)[[2, 3, 0, 1]]
        return sigma[:, :, None] * between * sigma[:, None, :]

    def draw(self, pixels: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Errors of true observations [N, 4], px: [N, 4], px.

        A Student-t error is a Gaussian one, all four coordinates of which are stretched alike.
        """
        white = rng.standard_normal((len(pixels), 4))
        white[:, 2:] = (
            self.correlation * white[:, :2] + np.sqrt(1.0 - self.correlation**2) * white[:, 2:]
        )
        if np.isfinite(self.dof):
            white *= np.sqrt((self.dof - 2.0) / rng.chisquare(self.dof, len(pixels)))[:, None]
        return self.sigma(pixels) * white
