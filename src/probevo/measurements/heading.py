"""The heading of the camera, as from GPS or a compass."""

from __future__ import annotations

import math

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import so3
from probevo.measurements.arguments import as_number, as_sigma
from probevo.measurements.north import attitude_of_enu, jacobian_of_enu
from probevo.measurements.variables import Values, Variable
from probevo.measurements.vector_measurement import VectorMeasurement

MIN_LEVEL = 0.1
"""Least share of the camera's z axis that is level: it is then 6° from the vertical, and an error
of the attitude of 1° is one of the heading of 10°."""


class Heading(VectorMeasurement):
    """A measured heading of the camera: the direction of its z axis over ground, clockwise.

    Args:
        pose: pose of the camera.
        heading_rad: what was measured, from north; without ``north``, from the heading of the first
            camera, which is then taken to be level.
        sigma_rad: its standard deviation.
        north: ``NORTH`` if it is from north; the attitude of the world relative to it is then
            estimated, too.

    Raises:
        InputError: either is no number, or the standard deviation not positive.
    """

    def __init__(
        self,
        pose: Variable,
        heading_rad: float,
        sigma_rad: float,
        *,
        north: Variable | None = None,
    ) -> None:
        sigma_rad = as_sigma(sigma_rad, "Heading: sigma_rad")
        super().__init__(np.array([[sigma_rad**2]]))
        self.pose = pose
        self.heading_rad = as_number(heading_rad, "Heading: heading_rad")
        self.north = north

    @property
    def variables(self) -> tuple[Variable, ...]:
        """The pose, and the attitude of the world relative to north if that is needed."""
        return (self.pose,) if self.north is None else (self.pose, self.north)

    def residual(self, values: Values) -> FloatArray:
        """Return measured minus predicted heading, from −π to π, [1]; NaN where the camera looks
        straight up or down, and has none."""
        east, north, _ = self._ahead_in_enu(values).tolist()
        if math.hypot(east, north) < MIN_LEVEL:
            return np.array([math.nan])
        difference = self.heading_rad - math.atan2(east, north)
        if not math.isfinite(difference):  # a receiver without a fix
            return np.array([math.nan])
        return np.array([math.remainder(difference, 2.0 * math.pi)])

    def jacobians(self, values: Values) -> tuple[FloatArray, ...]:
        """Return the Jacobians of e by the pose, [1, 6], and by the attitude relative to north,
        [1, 3]."""
        ahead = self._ahead_in_enu(values)
        level_squared = max(float(ahead[0] ** 2 + ahead[1] ** 2), MIN_LEVEL**2)
        # e = measured − atan2(east, north), so that ∂e/∂(east, north) = (−north, east)/(east² +
        # north²).
        ahead_jacobian = np.array([[-ahead[1], ahead[0], 0.0]]) / level_squared
        C_enu_world = attitude_of_enu(self._north(values)).T
        C_enu_cam = C_enu_world @ values[self.pose][:3, :3].T
        pose_jacobian = np.zeros((1, 6))
        # C_world_cam = C̄ Exp(−φ), which moves the z axis by C̄ (z × φ).
        pose_jacobian[:, 3:] = ahead_jacobian @ C_enu_cam @ so3.wedge(np.array([0.0, 0.0, 1.0]))
        if self.north is None:
            return (pose_jacobian,)
        # d = C_enu_world w with w fixed: 0 = ∂C_world_enu d + C_world_enu ∂d, so that ∂d =
        # −C_enu_world (∂C_world_enu) d.
        north_jacobian = -ahead_jacobian @ C_enu_world @ jacobian_of_enu(values[self.north], ahead)
        return pose_jacobian, north_jacobian

    def _north(self, values: Values) -> FloatArray:
        return np.zeros(3) if self.north is None else values[self.north]

    def _ahead_in_enu(self, values: Values) -> FloatArray:
        """Return the camera's z axis in east, north and up, [3]."""
        C_world_enu = attitude_of_enu(self._north(values))
        ahead: FloatArray = C_world_enu.T @ values[self.pose][2, :3]
        return ahead
