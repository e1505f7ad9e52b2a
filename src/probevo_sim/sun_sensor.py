"""A simulated sun sensor: the sun's direction with noise, every so many frames (thesis 5.7)."""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import so3
from probevo.measurements.direction import Direction, tangent_axes
from probevo.measurements.sensor import NoMeasurement
from probevo.measurements.variables import pose_of
from probevo.sequences.frame import Frame

MIN_SIGMA_RAD = math.radians(0.1)
"""What a sensor without noise claims: a covariance of zero is none."""
OFFSET_RAD = math.radians(20.0)

Fault = Literal["offset", "inverted", "stuck"]


class SunSensor:
    """Measures the direction of the sun in the camera, with noise in the tangent plane.

    A step that is repeated gets the same measurement: its noise depends on the seed and the frame.

    Args:
        T_world_cam: true poses of the frames in the world, [K, 4, 4].
        sun_world: direction of the sun in the world, [3].
        sigma_rad: standard deviation of each of the two angles.
        every: frames from one sighting to the next.
        seed: of the noise.
        fault: None, or how it lies: its azimuth is 20° off, has the wrong sign, or stays at
            its first sighting.
    """

    name = "sun"

    def __init__(
        self,
        T_world_cam: FloatArray,
        sun_world: FloatArray,
        *,
        sigma_rad: float,
        every: int = 1,
        seed: int = 0,
        fault: Fault | None = None,
    ) -> None:
        self.T_world_cam = T_world_cam
        self.sun_world = sun_world / np.linalg.norm(sun_world)
        self.sigma_rad = sigma_rad
        self.every = every
        self.seed = seed
        self.fault = fault

    def __call__(self, prev_frame: Frame, frame: Frame) -> list[Direction] | NoMeasurement:
        """Return the direction of the sun, or that this frame has no sighting."""
        if frame.index % self.every:
            return NoMeasurement("between sightings")
        sigma_rad = max(self.sigma_rad, MIN_SIGMA_RAD)
        return [
            Direction(
                pose_of(frame.index),
                self.measured(frame.index),
                self.sun_world,
                sigma_rad**2 * np.eye(2),
            )
        ]

    def measured(self, index: int) -> FloatArray:
        """Return the unit vector in the camera that it measures in a frame, [3]."""
        shown = self.every if self.fault == "stuck" else index
        u = self.T_world_cam[shown, :3, :3].T @ self.sun_world
        if self.fault == "offset":
            u = so3.exp(np.array([0.0, OFFSET_RAD, 0.0])) @ u
        if self.fault == "inverted":
            u = u * np.array([-1.0, 1.0, 1.0])
        rng = np.random.default_rng([self.seed, index])
        first, second = tangent_axes(u).T
        slip = self.sigma_rad * rng.normal(size=2)
        # Azimuth grows by a turn about the second axis of the plane, zenith about the first.
        turned: FloatArray = so3.exp(slip[0] * np.cross(u, first)) @ u
        return so3.exp(slip[1] * np.cross(u, second)) @ turned
