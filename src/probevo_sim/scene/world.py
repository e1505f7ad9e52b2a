"""A scene as a value: its solids, what moves, the texture of the ground, and the light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.geometry import se3
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import Solids


@dataclass(frozen=True)
class Ground:
    """The plane z = 0, textured in B bands on both sides of a road's centre line."""

    route: Route
    """Centre line; the distance from it decides the band."""
    edge_m: FloatArray
    """Outer edge of each band as a distance from the centre line, [B], ascending.

    The last band reaches to infinity."""
    texture: IntArray
    """Layer of each band's texture, [B]."""
    tile_m: FloatArray
    """Side of one tile of the texture, [B]."""
    albedo: FloatArray
    """Mean reflectance, [B]; see ``Solids.albedo``."""
    contrast: FloatArray
    """How far the texture varies the reflectance, [B]; see ``Solids.contrast``."""


@dataclass(frozen=True)
class Movers:
    """G objects that move along a road or across it, at a constant speed or at the camera's.

    Object g has the ``object_index`` g + 1. An object's own frame has x forward, y left, z up, and
    its origin on the ground. Along a road an object keeps its distance from the centre line; beyond
    the ends of the road it goes straight on. An object of negative speed moves against the
    direction of the road and faces that way.
    """

    s_m: FloatArray
    """Place along the centre line at time 0, [G]."""
    lateral_m: FloatArray
    """Distance to the left of the centre line at time 0, [G]."""
    speed_m_s: FloatArray
    """Along the centre line, [G]."""
    lateral_speed_m_s: FloatArray
    """Across it, to the left, [G]: people who cross the road."""
    ahead: BoolArray
    """Objects that keep their distance to the camera, [G].

    Their ``s_m`` counts from the camera's place, and their speed is the camera's."""

    def __len__(self) -> int:
        """Return the number of movers, G."""
        return len(self.s_m)

    @property
    def fastest_m_s(self) -> float:
        """Highest speed over the ground, of those that do not move at the camera's speed."""
        return float(np.hypot(self.speed_m_s, self.lateral_speed_m_s).max(initial=0.0))

    @staticmethod
    def none() -> Movers:
        """Return no movers at all."""
        none = np.zeros(0)
        return Movers(
            s_m=none,
            lateral_m=none,
            speed_m_s=none,
            lateral_speed_m_s=none,
            ahead=np.zeros(0, np.bool_),
        )

    def poses(self, route: Route, t_s: float, camera_s_m: float) -> FloatArray:
        """Return T_world_object of each mover, [G, 4, 4], m.

        Args:
            route: the road.
            t_s: the time.
            camera_s_m: place of the camera along the road at that time.
        """
        s_m = self.s_m + np.where(self.ahead, camera_s_m, t_s * self.speed_m_s)
        lateral_m = self.lateral_m + t_s * self.lateral_speed_m_s

        # Objects face the way that they move.
        heading = np.zeros((len(self), 6))
        heading[:, 5] = np.arctan2(self.lateral_speed_m_s, self.speed_m_s)
        return route.place(s_m, lateral_m) @ se3.exp(heading)


@dataclass(frozen=True)
class World:
    """Everything that can be seen. World axes: x east, y north, z up; the ground is z = 0."""

    solids: Solids
    movers: Movers
    ground: Ground
    to_sun: FloatArray
    """Unit vector towards the sun, [3]; its z is at least 0.25."""
    sun_irradiance: float = 0.75
    """Irradiance of the sun on a face square to it, over π.

    That is the radiance which a white Lambertian face reflects; 1 is white in an image."""
    sky_irradiance: float = 0.35
    """Irradiance of the sky on a face that looks up, over π."""
    sky_glow: float = 0.0
    """Brightness of the sun's disk and of the sky around it, 0 … 1."""

    @property
    def own_vehicle(self) -> int:
        """The ``object_index`` of the vehicle that carries the camera."""
        return 1 + len(self.movers)

    def poses(self, t_s: float, T_world_cam: FloatArray) -> FloatArray:
        """Return T_world_object of the ground, the movers and the own vehicle, [2 + G, 4, 4], m.

        The own vehicle's frame lies on the ground below the camera, x forward.

        Args:
            t_s: the time.
            T_world_cam: pose of the left camera at that time, [4, 4], m.
        """
        forward = T_world_cam[:3, 2]
        yaw = np.arctan2(forward[1], forward[0])
        T_world_own = se3.exp(np.array([0.0, 0.0, 0.0, 0.0, 0.0, yaw]))
        T_world_own[:2, 3] = T_world_cam[:2, 3]

        # Finding the camera on the road takes time, and only objects ahead of it need that.
        route = self.ground.route
        camera_s_m = float(route.nearest(T_world_cam[:2, 3])[0]) if self.movers.ahead.any() else 0.0
        T_world_mover = self.movers.poses(route, t_s, camera_s_m)
        return np.concatenate([np.eye(4)[None], T_world_mover, T_world_own[None]])
