"""A scene as a value: what stands in it, what moves, what the ground looks like, where the sun is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray
from probevo.geometry import se3
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import Solids


@dataclass(frozen=True)
class Ground:
    """The plane z = 0, textured in bands on both sides of a road's centre line."""

    route: Route
    """Centre line; the distance from it decides the band."""
    edge_m: FloatArray
    """Outer edge of each band, distance from the centre line, [B], ascending; the last one reaches
    to infinity."""
    texture: IntArray
    """[B]."""
    tile_m: FloatArray
    """Side of one tile, [B]."""
    albedo: FloatArray
    """[B]; see ``Solids.albedo``."""
    contrast: FloatArray
    """[B]."""


@dataclass(frozen=True)
class Movers:
    """G objects that move along a road or across it, at a constant speed or at the camera's.

    Object g has the ``object_index`` g + 1. An object's own frame has x forward, y left, z up, and
    lies on the ground. Along a road it keeps its distance from the centre line; beyond the ends of
    the road it goes straight on. With a negative speed it drives backwards along the road and faces
    that way.
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
    """Those that keep their distance to the camera: their ``s_m`` counts from where it is, their
    speed is its, [G]."""

    def __len__(self) -> int:
        """Number of movers, G."""
        return len(self.s_m)

    @property
    def fastest_m_s(self) -> float:
        """The highest speed against the ground, but for those that keep to the camera's."""
        return float(np.hypot(self.speed_m_s, self.lateral_speed_m_s).max(initial=0.0))

    @staticmethod
    def none() -> Movers:
        """Nothing moves."""
        none = np.zeros(0)
        return Movers(none, none, none, lateral_speed_m_s=none, ahead=np.zeros(0, np.bool_))

    def poses(self, route: Route, t_s: float, camera_s_m: float) -> FloatArray:
        """T_world_object of each mover at a time at which the camera is there along the road, [G,
        4, 4]."""
        lateral_m = self.lateral_m + t_s * self.lateral_speed_m_s
        T_world_object = route.place(
            self.s_m + np.where(self.ahead, camera_s_m, t_s * self.speed_m_s), lateral_m
        )
        turn = np.zeros((len(self), 6))
        turn[:, 5] = np.arctan2(self.lateral_speed_m_s, self.speed_m_s)
        return T_world_object @ se3.exp(turn)


@dataclass(frozen=True)
class World:
    """Everything that can be seen. World axes: x east, y north, z up; the ground is z = 0."""

    solids: Solids
    movers: Movers
    ground: Ground
    to_sun: FloatArray
    """Unit vector towards the sun, [3]; its z is at least 0.25."""
    sun: float = 0.75
    """Radiance that a white face square to the sun reflects of its light."""
    sky: float = 0.35
    """Radiance that the sky adds to a white face that looks up."""

    @property
    def own_vehicle(self) -> int:
        """``object_index`` of what moves with the camera."""
        return 1 + len(self.movers)

    def poses(self, t_s: float, T_world_cam: FloatArray) -> FloatArray:
        """T_world_object of each object at a time, [2 + G, 4, 4]: the ground, the movers, the own
        vehicle.

        The own vehicle's frame lies on the ground below the camera, x forward.
        """
        forward = T_world_cam[:3, 2]
        T_world_own = se3.exp(
            np.array([0.0, 0.0, 0.0, 0.0, 0.0, np.arctan2(forward[1], forward[0])])
        )
        T_world_own[:2, 3] = T_world_cam[:2, 3]
        route = self.ground.route
        camera_s_m = float(route.nearest(T_world_cam[:2, 3])[0]) if self.movers.ahead.any() else 0.0
        T_world_mover = self.movers.poses(route, t_s, camera_s_m)
        return np.concatenate([np.eye(4)[None], T_world_mover, T_world_own[None]])
