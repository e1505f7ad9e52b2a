"""What a preset makes, and what all presets have in common: effects on the place, the sun, a free
road."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np

from probevo.arrays import FloatArray
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.drive import DrivePlan
from probevo_sim.scene.presets.foliage import foliage
from probevo_sim.scene.presets.traffic import traffic
from probevo_sim.scene.presets.vehicles import own_vehicle
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import Solids, join
from probevo_sim.scene.textures import Texture
from probevo_sim.scene.world import Ground, World

SUN_ELEVATION_RAD = 0.6
SUN_ASIDE_RAD = 0.6
"""Height of the sun, and how far to the left of the drive's mean direction, looking back."""
SUN = 1.3
SKY = 0.6
"""Exposed so that a drive's mean grey is about 100."""
HEDGE_SPARE_M = 1.5
"""So far towards the road the effect's hedges and low branches may reach."""
SHADOWED_SHARE = 0.25
"""Of the light, that black shadows take away: the exposure makes up for it."""
MARK_TOP_M = 0.02
"""What lies on the ground lies below this."""

HALF_LANE_M = 1.5
"""To both sides of the camera's path a street has nothing standing so near: a drive wanders by up
to 0.3 m."""
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Makes what faces along the road face against it, with what was at its left now at the road's
right."""


@dataclass(frozen=True)
class Place:
    """A world, and the drive through it."""

    world: World
    plan: DrivePlan


@dataclass(frozen=True)
class Band:
    """One stripe of the ground along the road, on both sides; see ``Ground``."""

    edge_m: float
    """Its outer edge, distance from the centre line; the last band reaches to infinity."""
    texture: Texture
    tile_m: float
    albedo: float
    contrast: float
    is_road: bool = False
    """Loses its texture on a textureless road."""


def compose(
    config: SceneConfig,
    route: Route,
    plan: DrivePlan,
    bands: Sequence[Band],
    standing: Iterable[Solids],
    marks: Iterable[Solids] = (),
    *,
    foliage_m: float,
) -> Place:
    """The place made of these parts, with the effects that add to it or take from it.

    Args:
        config: its seed and effects; its preset decides what traffic there is.
        route: the road; the middle of the ground's bands.
        plan: the drive.
        bands: of the ground, from the centre line outwards; one at least is the road.
        standing: objects in the world, kept as they are.
        marks: what lies flat on the road; fades with its texture.
        foliage_m: distance from the centre line at which hedges line the road.
    """
    effects = config.effects
    left = 1.0 - effects.textureless
    parts = [*standing]
    if left > 0.0:
        road_albedo = next(band.albedo for band in bands if band.is_road)
        parts.extend(_faded(mark, road_albedo, left) for mark in marks)
    if effects.foliage > 0.0:
        hedges = foliage(route, effects.foliage, foliage_m, rng=place_rng(config, 1))
        parts.extend(clear_of_road(hedges, route, foliage_m - HEDGE_SPARE_M))
    moving, movers = traffic(
        route, plan, effects.traffic, rng=place_rng(config, 2), kind=config.preset
    )
    parts.append(moving)
    gain = 1.0 / (1.0 - SHADOWED_SHARE * effects.shadows)
    ground = _ground(route, bands, left)
    to_sun = _to_sun(route, plan)
    world = World(join(parts), movers, ground, to_sun=to_sun, sun=gain * SUN, sky=gain * SKY)
    if effects.shadows > 0.0:
        world = replace(
            world, solids=join([world.solids, own_vehicle().of_object(world.own_vehicle)])
        )
    return Place(world, plan)


def place_rng(config: SceneConfig, part: int = 0) -> np.random.Generator:
    """Randomness of a part of the place, which depends on the seed and not on the drive. Part 0 is
    what stands still; 1 and 2 are foliage and traffic, so that these effects leave the rest as it
    is."""
    return np.random.default_rng([config.seed, 0] if part == 0 else [config.seed, 0, 0, part])


def clear_of_road(
    objects: Iterable[Solids], route: Route, half_width_m: float, *, below_m: float = 4.0
) -> list[Solids]:
    """Those objects of which nothing reaches into the road, up to 40 m beyond its ends.

    Args:
        objects: each one or several solids, in the world.
        route: the road.
        half_width_m: distance from its centre line that is to stay free.
        below_m: height up to which it is; branches may hang above. Marks on the road are not in the
            way.
    """
    line_m = route.position(np.arange(-40.0, route.length_m + 40.0, 0.5))
    return [thing for thing in objects if not np.any(_gap_m(thing, line_m, below_m) < half_width_m)]


def repeated(pieces: Sequence[tuple[float, float]], distance_m: float) -> list[tuple[float, float]]:
    """Pieces of a road, as of ``Route.from_turns``, again and again until they are as long as the
    drive."""
    chosen: list[tuple[float, float]] = []
    for piece in cycle(pieces):
        if chosen and sum(length for length, _ in chosen) >= distance_m:
            break
        chosen.append(piece)
    return chosen


def crosswise(route: Route, s_m: float, lateral_m: float) -> FloatArray:
    """T_world_object [4, 4] of what stands across a road, its x to the left."""
    T_world_object: FloatArray = route.place(s_m, lateral_m)[:, [1, 0, 2, 3]] * [
        1.0,
        -1.0,
        1.0,
        1.0,
    ]
    return T_world_object


def stations(
    route: Route, lateral_m: float, start_m: float, end_m: float, spacing_m: float
) -> FloatArray:
    """Places along a road, [K], m, at which things ``lateral_m`` to its left are ``spacing_m``
    apart.

    On the inner side of a bend it may be narrower than things at that distance need: there are
    none.
    """
    s_m = np.arange(start_m, end_m, 0.25)
    stretch = np.maximum(1.0 - route.curvature(s_m) * lateral_m, 0.0)
    reached_m = np.cumsum(0.25 * stretch)
    chosen: FloatArray = s_m[np.flatnonzero(np.diff(np.floor(reached_m / spacing_m), prepend=-1.0))]
    return chosen


def _gap_m(thing: Solids, line_m: FloatArray, below_m: float) -> FloatArray:
    """Distance of a line's points, [M, 2], from the rectangle that each solid covers on the ground,
    [N, M]."""
    C = thing.T_object_solid[:, :3, :3]
    center = thing.T_object_solid[:, :3, 3]
    rise_m = np.abs(C[:, 2] * thing.half_size_m).sum(axis=1)
    in_way = (center[:, 2] + rise_m > MARK_TOP_M) & (center[:, 2] - rise_m < below_m)
    C = C[in_way]
    center = center[in_way]
    half = thing.half_size_m[in_way]
    yaw = np.arctan2(C[:, 1, 0], C[:, 0, 0])
    axes = np.stack([np.cos(yaw), np.sin(yaw), -np.sin(yaw), np.cos(yaw)], axis=-1).reshape(
        -1, 2, 2
    )
    extent_m = (np.abs(axes @ C[:, :2]) @ half[:, :, None])[:, None, :, 0]
    offset_m = np.abs((line_m - center[:, None, :2]) @ axes.mT)
    gap_m: FloatArray = np.linalg.norm(np.maximum(offset_m - extent_m, 0.0), axis=-1)
    return gap_m


def _ground(route: Route, bands: Sequence[Band], left: float) -> Ground:
    return Ground(
        route,
        edge_m=np.array([band.edge_m for band in bands]),
        texture=np.array([int(band.texture) for band in bands]),
        tile_m=np.array([band.tile_m for band in bands]),
        albedo=np.array([band.albedo for band in bands]),
        contrast=np.array([band.contrast * (left if band.is_road else 1.0) for band in bands]),
    )


def _faded(mark: Solids, road_albedo: float, left: float) -> Solids:
    """A mark of which only a share is left, on a road of this albedo."""
    return replace(
        mark, albedo=road_albedo + left * (mark.albedo - road_albedo), contrast=left * mark.contrast
    )


def _to_sun(route: Route, plan: DrivePlan) -> FloatArray:
    """Unit vector towards the sun, [3]: behind the camera on average, so that the own shadow lies
    ahead."""
    heading = route.heading(np.linspace(plan.start_m, plan.start_m + plan.distance_m, 200))
    behind = np.angle(-np.exp(1j * heading).mean()) - SUN_ASIDE_RAD
    flat = np.cos(SUN_ELEVATION_RAD)
    return np.array([flat * np.cos(behind), flat * np.sin(behind), np.sin(SUN_ELEVATION_RAD)])
