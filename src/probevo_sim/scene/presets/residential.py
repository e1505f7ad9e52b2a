"""A winding street of houses in gardens behind hedges and fences, with cars at the kerb and on the
drives."""

from __future__ import annotations

import numpy as np

from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.drive import DrivePlan
from probevo_sim.scene.presets import furniture
from probevo_sim.scene.presets.place import (
    HALF_LANE_M,
    HALF_TURN,
    Band,
    Place,
    clear_of_road,
    compose,
    crosswise,
    place_rng,
    repeated,
    stations,
)
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import BOX, Solids, join, solid
from probevo_sim.scene.textures import Texture

DISTANCE_M = 220.0
SPEED_M_S = 8.0
LANE_M = 1.5
PIECES = (
    (24.0, 0.0),
    (32.0, 0.6),
    (40.0, -1.1),
    (36.0, 0.9),
    (18.0, 0.0),
    (34.0, -0.8),
    (36.0, 0.4),
)
"""Length, m, and turn, rad, of the pieces of the street; a long drive has them again and again."""
HALT_M = 124.0
REPEAT_M = 220.0
"""The first halt, and the distance from one to the next."""
LEAD_M = 110.0
BEHIND_M = 16.0
AHEAD_M = 90.0
"""Of street beyond its ends: how much there is, and how much of that is lined."""
KERB_M = 5.0
PARKED_M = 4.05
GARDEN_M = 7.3
HOUSE_M = 15.8
BACK_M = 30.0
"""Distances from the centre line: kerb, parked cars, where the gardens begin, middle of the houses,
trees behind."""
LOT_M = 17.0
"""Width of a garden along the street."""
BANDS = (
    Band(KERB_M, Texture.ASPHALT, 5.0, albedo=0.28, contrast=0.8, is_road=True),
    Band(GARDEN_M - 0.3, Texture.PAVING, 2.6, albedo=0.4, contrast=0.8),
    Band(np.inf, Texture.GRASS, 2.4, albedo=0.27, contrast=0.9),
)


def residential(config: SceneConfig) -> Place:
    """The street and a drive along it, 220 m unless told."""
    rng = place_rng(config)
    distance_m = config.distance_m or DISTANCE_M
    route = Route.from_turns(repeated(PIECES, distance_m), lead_m=LEAD_M)
    stops_m = tuple(float(s) for s in np.arange(HALT_M, distance_m - 20.0, REPEAT_M))
    plan = DrivePlan(0.0, distance_m, SPEED_M_S, lateral_m=-LANE_M, stops_m=stops_m)
    gardens = clear_of_road([*_lots(route, rng), *_behind(route, rng)], route, GARDEN_M - 0.6)
    street = clear_of_road(
        [*_kerbs(route), *_street(route, stops_m, rng)], route, LANE_M + HALF_LANE_M
    )
    marks = _marks(route, stops_m, rng)
    return compose(
        config,
        route,
        plan,
        bands=BANDS,
        standing=[*gardens, *street],
        marks=marks,
        foliage_m=GARDEN_M - 0.2,
    )


def _lots(route: Route, rng: np.random.Generator) -> list[Solids]:
    """A house on each lot, its garden in front."""
    things = []
    for side in (-1.0, 1.0):
        to_road = np.eye(4) if side < 0.0 else HALF_TURN
        for s in stations(
            route, side * HOUSE_M, -BEHIND_M, end_m=route.length_m + AHEAD_M, spacing_m=LOT_M
        ):
            shrink = 1.0 / max(1.0 - float(route.curvature(s)) * side * GARDEN_M, 0.5)
            for thing, along, away in [*_buildings(rng), *_garden(rng)]:
                things.append(thing.at(route.place(s + along * shrink, side * away) @ to_road))
    return things


def _buildings(rng: np.random.Generator) -> list[tuple[Solids, float, float]]:
    """House, garage, and perhaps a car on the drive: (object, place along the street, distance from
    it)."""
    home = furniture.house(rng)
    if rng.random() < 0.35:  # gable towards the street
        home = home.at(_QUARTER_TURN)
    parts = [(home, float(rng.uniform(-2.5, -1.5)), HOUSE_M + float(rng.uniform(-0.8, 1.5)))]
    if rng.random() < 0.6:
        parts.append((_garage(rng), DRIVE_M, HOUSE_M + 0.5))
    if rng.random() < 0.5:
        turned = _QUARTER_TURN if rng.random() < 0.5 else _QUARTER_TURN @ HALF_TURN
        parts.append((furniture.car(rng).at(turned), DRIVE_M, GARDEN_M + 2.6))
    return parts


def _garden(rng: np.random.Generator) -> list[tuple[Solids, float, float]]:
    """What bounds it, but for the drive, and what grows in it."""
    high = float(rng.uniform(0.9, 1.9))
    kind = rng.random()
    parts = []
    for along in (-5.6, -0.3):
        if kind < 0.45:
            bound = furniture.hedge(5.3, high, tile=2.6)
        elif kind < 0.75:
            bound = furniture.fence(5.3, 0.6 * high)
        else:
            bound = _wall(5.3, 0.5 * high)
        parts.append((bound, along, GARDEN_M))
    drive = solid(
        BOX, (3.4, 9.0, 0.01), (0, 0, 0.005), texture=Texture.CONCRETE, tile_m=3.0, albedo=0.4
    )
    parts.append((drive, DRIVE_M, GARDEN_M + 4.0))
    for _ in range(rng.integers(1, 4)):
        parts.append(
            (
                furniture.bush(rng),
                float(rng.uniform(-8.0, 3.0)),
                float(rng.uniform(GARDEN_M + 1.5, 11.0)),
            )
        )
    for _ in range(rng.integers(0, 3)):
        tree = furniture.tree(rng, rng.uniform(4.0, 8.0))
        parts.append(
            (tree, float(rng.uniform(-8.0, 3.0)), float(rng.uniform(GARDEN_M + 1.5, 10.5)))
        )
    if rng.random() < 0.6:
        parts.append(
            (
                join(furniture.litter_bin(rng).at(_shifted(x)) for x in (0.0, 0.8)),
                3.0,
                GARDEN_M + 0.2,
            )
        )
    return parts


DRIVE_M = 5.8
"""Middle of the drive, along the street from the middle of the lot."""
_QUARTER_TURN = np.array(
    [[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)


def _shifted(x: float) -> np.ndarray:
    T_a_b = np.eye(4)
    T_a_b[0, 3] = x
    return T_a_b


def _garage(rng: np.random.Generator) -> Solids:
    """A flat-roofed garage whose doors look to both sides of y."""
    body = solid(
        BOX,
        (3.2, 6.0, 2.5),
        (0, 0, 1.25),
        texture=Texture.PLASTER,
        tile_m=3.0,
        albedo=rng.uniform(0.4, 0.55),
        contrast=1.0,
    )
    roof = solid(
        BOX, (3.5, 6.3, 0.2), (0, 0, 2.6), texture=Texture.CONCRETE, tile_m=3.0, albedo=0.3
    )
    door = solid(
        BOX,
        (2.5, 6.1, 2.1),
        (0, 0, 1.05),
        texture=Texture.FENCE,
        tile_m=(2.5, 2.1),
        albedo=rng.uniform(0.2, 0.5),
    )
    return join([body, roof, door])


def _wall(length: float, height: float) -> Solids:
    """A garden wall along x under a row of slabs."""
    bricks = solid(
        BOX,
        (length, 0.25, height),
        (0, 0, 0.5 * height),
        texture=Texture.BRICK,
        tile_m=2.2,
        albedo=0.35,
    )
    slabs = solid(
        BOX,
        (length + 0.05, 0.35, 0.08),
        (0, 0, height),
        texture=Texture.CONCRETE,
        tile_m=1.5,
        albedo=0.45,
    )
    return join([bricks, slabs])


def _behind(route: Route, rng: np.random.Generator) -> list[Solids]:
    """Tall trees behind the gardens, houses and trees across both ends of the street."""
    things = []
    end_m = route.length_m + AHEAD_M
    for side in (-1.0, 1.0):
        for s in stations(route, side * BACK_M, -BEHIND_M, end_m=end_m, spacing_m=6.0):
            crown = furniture.distant_tree(rng)
            things.append(crown.at(route.place(s, side * (BACK_M + rng.uniform(-4.0, 10.0)))))
    for s, back in ((-BEHIND_M - 26.0, -12.0), (end_m + 26.0, 12.0)):
        for y in np.arange(-33.0, 34.0, 11.0):
            things.append(furniture.house(rng).at(crosswise(route, s, y)))
        for y in np.arange(-60.0, 61.0, 8.0):
            things.append(furniture.distant_tree(rng).at(route.place(s + back, y)))
    return things


def _kerbs(route: Route) -> list[Solids]:
    return [
        furniture.kerb(5.1).at(route.place(s, side * (KERB_M + 0.1)))
        for side in (-1.0, 1.0)
        for s in stations(
            route, side * KERB_M, -BEHIND_M, end_m=route.length_m + AHEAD_M, spacing_m=5.0
        )
    ]


def _street(route: Route, stops_m: tuple[float, ...], rng: np.random.Generator) -> list[Solids]:
    """Cars at the kerb; lamp posts, signs and young trees on the pavement."""
    things = []
    end_m = route.length_m + AHEAD_M
    for side in (-1.0, 1.0):
        to_road = np.eye(4) if side < 0.0 else HALF_TURN
        for s in stations(route, side * PARKED_M, -BEHIND_M, end_m=end_m, spacing_m=8.0):
            vehicle = furniture.van(rng) if rng.random() < 0.08 else furniture.car(rng)
            if rng.random() < 0.3 and not any(-6.0 < s - stop < 10.0 for stop in stops_m):
                things.append(vehicle.at(route.place(s, side * PARKED_M) @ to_road))
        for s in stations(
            route, side * GARDEN_M, -BEHIND_M + 10.0 * side, end_m=end_m, spacing_m=28.0
        ):
            things.append(
                furniture.lamp_post(5.0).at(route.place(s, side * (GARDEN_M - 0.4)) @ to_road)
            )
            if rng.random() < 0.5:
                things.append(
                    furniture.road_sign(rng).at(
                        route.place(s + 11.0, side * (KERB_M + 0.4)) @ to_road
                    )
                )
            if rng.random() < 0.4:
                things.append(furniture.box(rng).at(route.place(s + 18.0, side * (GARDEN_M - 0.6))))
    return things


def _marks(route: Route, stops_m: tuple[float, ...], rng: np.random.Generator) -> list[Solids]:
    """A line at each halt, lids, and many mended pieces: a street that nobody has renewed for long."""
    marks = [
        furniture.lane_dash(0.4, KERB_M - 0.3).at(route.place(stop + 3.0, -0.5 * KERB_M))
        for stop in stops_m
    ]
    for s in stations(route, 0.0, -BEHIND_M, end_m=route.length_m + AHEAD_M, spacing_m=7.0):
        marks.append(
            furniture.patch(rng).at(route.place(s + rng.uniform(-3, 3), rng.uniform(-3.0, 3.0)))
        )
        if rng.random() < 0.35:
            marks.append(
                furniture.manhole().at(route.place(s + rng.uniform(-3, 3), rng.uniform(-2.5, 2.5)))
            )
    return marks
