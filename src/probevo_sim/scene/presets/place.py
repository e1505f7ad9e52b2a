"""A place, and what all presets have in common: effects on the place, the sun, a free road."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import cycle

import numpy as np

from probevo.arrays import FloatArray
from probevo_sim.scene.config import Daylight, SceneConfig
from probevo_sim.scene.drive import DrivePlan
from probevo_sim.scene.presets.foliage import foliage
from probevo_sim.scene.presets.traffic import traffic
from probevo_sim.scene.presets.vehicles import own_vehicle
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import Solids, join
from probevo_sim.scene.textures import Texture
from probevo_sim.scene.world import Ground, World

SUN_ASIDE_RAD = 0.6
"""Azimuth of the sun to the left of the direction back along the drive, on average."""
SUN_IRRADIANCE = 1.3
"""With SKY_IRRADIANCE, exposed so that a drive's mean grey is about 100."""
SKY_IRRADIANCE = 0.6
HEDGE_SPARE_M = 1.5
"""How far towards the road hedges and low branches of the effect ``foliage`` may reach."""
SHADOWED_SHARE = 0.25
"""Share of the light that black shadows take away, for which the exposure compensates."""
MARK_TOP_M = 0.02
"""Marks on the ground are lower than this."""

HALF_LANE_M = 1.5
"""Free distance to both sides of the camera's path in a street; a drive deviates by up to 0.3 m."""
HALF_TURN = np.diag([-1.0, -1.0, 1.0, 1.0])
"""Rotation by π about z: an object that faces along the road comes to face against it."""


@dataclass(frozen=True)
class Place:
    """A world, and the drive through it."""

    world: World
    plan: DrivePlan


@dataclass(frozen=True)
class Band:
    """A band of the ground along the road, on both sides; see ``Ground``."""

    edge_m: float
    """Outer edge, as a distance from the centre line; the last band reaches to infinity."""
    texture: Texture
    tile_m: float
    """Side of one tile of the texture."""
    albedo: float
    contrast: float
    is_road: bool = False
    """Whether the effect ``textureless`` fades its texture."""


def compose(
    config: SceneConfig,
    route: Route,
    plan: DrivePlan,
    *,
    bands: Sequence[Band],
    standing: Iterable[Solids],
    marks: Iterable[Solids] = (),
    foliage_m: float,
) -> Place:
    """Make a place of its parts, with the effects that add to it or remove from it.

    Args:
        config: seed, effects, and the preset, which decides what traffic there is.
        route: the road; the bands of the ground lie along it.
        plan: the drive.
        bands: bands of the ground, from the centre line outwards; at least one is the road.
        standing: objects in the world, kept as they are.
        marks: what lies flat on the road; it fades with the road's texture.
        foliage_m: distance from the centre line at which hedges line the road.
    """
    effects = config.effects
    parts = [*standing]
    if config.carried > 0.0:
        plan = plan.carried_by_hand(config.carried)

    # A textureless road: its marks fade into its albedo, and its own contrast falls.
    road_contrast = 1.0 - effects.textureless
    if road_contrast > 0.0:
        road_albedo = next(band.albedo for band in bands if band.is_road)
        parts.extend(_faded(mark, road_albedo, road_contrast) for mark in marks)
    ground = _ground(route, bands, road_contrast)

    # Hedges along the road, which leave the road itself free.
    if effects.foliage > 0.0:
        hedges = foliage(route, effects.foliage, foliage_m, rng=place_rng(config, 1))
        parts.extend(clear_of_road(hedges, route, foliage_m - HEDGE_SPARE_M))

    # Traffic; its solids belong to objects of their own.
    moving, movers = traffic(
        route, plan, effects.traffic, rng=place_rng(config, 2), kind=config.preset
    )
    parts.append(moving)

    # Light, brighter where shadows take some of it away.
    gain = 1.0 / (1.0 - SHADOWED_SHARE * effects.shadows)
    world = World(
        join(parts),
        movers,
        ground,
        to_sun=_to_sun(route, plan, config.daylight),
        sun_irradiance=gain * SUN_IRRADIANCE,
        sky_irradiance=gain * SKY_IRRADIANCE,
        sky_glow=config.daylight.glow,
    )
    if effects.shadows > 0.0:
        own = own_vehicle().of_object(world.own_vehicle)
        world = replace(world, solids=join([world.solids, own]))
    return Place(world, plan)


def place_rng(config: SceneConfig, part: int = 0) -> np.random.Generator:
    """Return the random generator of a part of the place, which the drive does not influence.

    Part 0 is what stands still. Foliage, 1, and traffic, 2, have generators of their own, so that
    these effects leave the rest of the place as it is.
    """
    return np.random.default_rng([config.seed, 0] if part == 0 else [config.seed, 0, 0, part])


def clear_of_road(
    objects: Iterable[Solids], route: Route, half_width_m: float, *, below_m: float = 4.0
) -> list[Solids]:
    """Return the objects that do not reach into the road, up to 40 m beyond its ends.

    Args:
        objects: each one or several solids, in the world.
        route: the road.
        half_width_m: distance from its centre line that is to stay free.
        below_m: height up to which it is to stay free; branches may hang above. Marks on the road
            do not count.
    """
    line_m = route.position(np.arange(-40.0, route.length_m + 40.0, 0.5))
    return [item for item in objects if not np.any(_gap_m(item, line_m, below_m) < half_width_m)]


def repeated(pieces: Sequence[tuple[float, float]], distance_m: float) -> list[tuple[float, float]]:
    """Repeat pieces of a road, as of ``Route.from_turns``, until they are as long as the drive."""
    chosen: list[tuple[float, float]] = []
    for piece in cycle(pieces):
        if chosen and sum(length for length, _ in chosen) >= distance_m:
            break
        chosen.append(piece)
    return chosen


def crosswise(route: Route, s_m: float, lateral_m: float) -> FloatArray:
    """Return T_world_object, [4, 4], m, of an object that stands across a road, its x to the left.

    Args:
        route: the road.
        s_m: distance along the road.
        lateral_m: distance to the left of the centre line.
    """
    # The road's y becomes the object's x, and its −x the object's y.
    axes = np.array([1.0, -1.0, 1.0, 1.0])
    T_world_object: FloatArray = route.place(s_m, lateral_m)[:, [1, 0, 2, 3]] * axes
    return T_world_object


def stations(
    route: Route, lateral_m: float, start_m: float, end_m: float, spacing_m: float
) -> FloatArray:
    """Return places along a road, [K], m, for objects at equal distances from each other.

    There are none on the inner side of a bend that is too narrow for objects so far to the side.

    Args:
        route: the road.
        lateral_m: distance of the objects to the left of the centre line.
        start_m: first distance along the road.
        end_m: end along the road.
        spacing_m: distance from one object to the next.
    """
    # Length of the path at that lateral distance, which a bend stretches or compresses.
    s_m = np.arange(start_m, end_m, 0.25)
    stretch = np.maximum(1.0 - route.curvature(s_m) * lateral_m, 0.0)
    reached_m = np.cumsum(0.25 * stretch)
    chosen: FloatArray = s_m[np.flatnonzero(np.diff(np.floor(reached_m / spacing_m), prepend=-1.0))]
    return chosen


def _gap_m(item: Solids, line_m: FloatArray, below_m: float) -> FloatArray:
    """Return the distance of points from the rectangle of each solid on the ground, [N, M], m.

    Args:
        item: solids in the world; marks, and what hangs above ``below_m``, are left out of the N.
        line_m: points (x, y), [M, 2], m.
        below_m: height below which solids are in the way.
    """
    # The solids that reach into the heights in question.
    C = item.T_object_solid[:, :3, :3]
    center = item.T_object_solid[:, :3, 3]
    rise_m = np.abs(C[:, 2] * item.half_size_m).sum(axis=1)
    is_in_way = (center[:, 2] + rise_m > MARK_TOP_M) & (center[:, 2] - rise_m < below_m)
    C = C[is_in_way]
    center = center[is_in_way]
    half = item.half_size_m[is_in_way]

    # Distances in the axes of each rectangle.
    yaw = np.arctan2(C[:, 1, 0], C[:, 0, 0])
    axes = np.stack([np.cos(yaw), np.sin(yaw), -np.sin(yaw), np.cos(yaw)], axis=-1).reshape(
        -1, 2, 2
    )
    extent_m = (np.abs(axes @ C[:, :2]) @ half[:, :, None])[:, None, :, 0]
    offset_m = np.abs((line_m - center[:, None, :2]) @ axes.mT)
    gap_m: FloatArray = np.linalg.norm(np.maximum(offset_m - extent_m, 0.0), axis=-1)
    return gap_m


def _ground(route: Route, bands: Sequence[Band], road_contrast: float) -> Ground:
    """Return the ground of bands, with a share of the road's own contrast."""
    return Ground(
        route,
        edge_m=np.array([band.edge_m for band in bands]),
        texture=np.array([int(band.texture) for band in bands]),
        tile_m=np.array([band.tile_m for band in bands]),
        albedo=np.array([band.albedo for band in bands]),
        contrast=np.array(
            [band.contrast * (road_contrast if band.is_road else 1.0) for band in bands]
        ),
    )


def _faded(mark: Solids, road_albedo: float, share: float) -> Solids:
    """Return a mark of which only a share is visible, on a road of this albedo."""
    albedo = road_albedo + share * (mark.albedo - road_albedo)
    return replace(mark, albedo=albedo, contrast=share * mark.contrast)


def _to_sun(route: Route, plan: DrivePlan, daylight: Daylight) -> FloatArray:
    """Return the unit vector towards the sun, [3].

    Unless its azimuth is given, the sun is behind the camera on average, so that the own vehicle's
    shadow lies ahead.
    """
    if daylight.azimuth_deg is None:
        heading = route.heading(np.linspace(plan.start_m, plan.start_m + plan.distance_m, 200))
        towards = np.angle(-np.exp(1j * heading).mean()) - SUN_ASIDE_RAD
    else:
        start = float(route.heading(np.array([plan.start_m]))[0])
        towards = start - np.radians(daylight.azimuth_deg)
    elevation = np.radians(daylight.elevation_deg)
    flat = np.cos(elevation)
    return np.array([flat * np.cos(towards), flat * np.sin(towards), np.sin(elevation)])
