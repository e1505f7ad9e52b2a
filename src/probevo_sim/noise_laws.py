"""Noise laws: the σ of a simulated observation by its place, and errors drawn from it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray
from probevo_sim.point_config import LawName, PointConfig

Profile = Callable[[FloatArray, FloatArray, FloatArray], FloatArray]
"""A function from the place in one image to the noise there, from 0, where σ is low, to 1, where it
is high.

Its arguments are u and v, from 0 to 1 across the image, and the disparity, from 0 to 1 at
the nearest landmarks; all are [N], as is the result."""


def _uniform(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    """Return the middle of the range, everywhere."""
    return np.full_like(u, 0.5)


def _row(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    """Return 0 at the bottom and 1 at the top."""
    return 1.0 - v


def _column(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    """Return 0 at the left and 1 at the right."""
    return u


def _radius(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    """Return 0 in the middle of the image and 1 in its corners."""
    distance: FloatArray = np.hypot(2.0 * u - 1.0, 2.0 * v - 1.0) / np.sqrt(2.0)
    return distance


def _disparity(u: FloatArray, v: FloatArray, disparity: FloatArray) -> FloatArray:
    """Return 0 far away and 1 for the nearest landmarks."""
    return disparity


PROFILES: dict[LawName, Profile] = {
    "constant": _uniform,
    "row": _row,
    "column": _column,
    "radius": _radius,
    "disparity": _disparity,
    "heavy-tailed": _uniform,
}
DOF: dict[LawName, float] = {"heavy-tailed": 5.0}
"""Degrees of freedom of the laws that are Student-t by default; 5 follows Kerl et al. 2013."""


@dataclass(frozen=True)
class NoiseLaw:
    """The zero-mean noise of stereo observations, which depends on where in the images each lies.

    The two coordinates in an image are independent and have the same σ. Left and right are
    correlated: u with u, and v with v.
    """

    profile: Profile
    sigma_px: tuple[float, float]
    """σ of a coordinate where the profile is 0, and where it is 1."""
    correlation: float
    """Correlation of the errors of a coordinate in the left and in the right image, −1 to 1."""
    dof: float
    """Degrees of freedom of the errors, over 2; np.inf is Gaussian.

    The covariance does not depend on it."""
    size_px: tuple[int, int]
    """Width and height of the images."""
    largest_disparity_px: float
    """Disparity for which the profile's argument is 1."""

    @staticmethod
    def of(config: PointConfig) -> NoiseLaw:
        """Return the law that the settings name."""
        noise = config.noise
        camera = config.camera
        return NoiseLaw(
            profile=PROFILES[noise.law],
            sigma_px=(noise.sigma_low_px, noise.sigma_high_px),
            correlation=noise.correlation,
            dof=noise.dof or DOF.get(noise.law, np.inf),
            size_px=(camera.width_px, camera.height_px),
            largest_disparity_px=camera.focal_px * camera.baseline_m / camera.nearest_m,
        )

    def sigma(self, pixels: FloatArray) -> FloatArray:
        """Return the standard deviation of each coordinate of true observations.

        Beyond the images and the nearest landmark it is taken from the nearest place within.

        Args:
            pixels: true observations (u_l, v_l, u_r, v_r), [N, 4], px.

        Returns:
            [N, 4], px.
        """
        # Normalised coordinates in the left and the right image, [N, 2].
        u = np.clip(pixels[:, 0::2] / (self.size_px[0] - 1), 0.0, 1.0)
        v = np.clip(pixels[:, 1::2] / (self.size_px[1] - 1), 0.0, 1.0)
        disparity = np.clip((pixels[:, 0] - pixels[:, 2]) / self.largest_disparity_px, 0.0, 1.0)
        low, high = self.sigma_px
        left = low + (high - low) * self.profile(u[:, 0], v[:, 0], disparity)
        right = low + (high - low) * self.profile(u[:, 1], v[:, 1], disparity)
        return np.column_stack([left, left, right, right])

    def covariance(self, pixels: FloatArray) -> FloatArray:
        """Return the covariance of the errors of true observations, [N, 4], px: [N, 4, 4], px²."""
        sigma = self.sigma(pixels)
        correlation = np.eye(4) + self.correlation * np.eye(4)[[2, 3, 0, 1]]
        return sigma[:, :, None] * correlation * sigma[:, None, :]

    def draw(self, pixels: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw errors of true observations, [N, 4], px: [N, 4], px.

        A Student-t error is a Gaussian one whose four coordinates are scaled by a common factor.
        """
        # Unit variance, and the correlation between left and right.
        white = rng.standard_normal((len(pixels), 4))
        white[:, 2:] = (
            self.correlation * white[:, :2] + np.sqrt(1.0 - self.correlation**2) * white[:, 2:]
        )
        if np.isfinite(self.dof):
            white *= np.sqrt((self.dof - 2.0) / rng.chisquare(self.dof, len(pixels)))[:, None]
        return self.sigma(pixels) * white
