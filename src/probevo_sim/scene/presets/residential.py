"""The preset ``residential``: a winding street of houses in gardens, with parked cars."""

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
LANE_OFFSET_M = 1.5
"""Distance of the driven lane's middle from the centre line, to the right."""
PIECES = (
    (24.0, 0.0),
    (32.0, 0.6),
    (40.0, -1.1),
    (36.0, 0.9),
    (18.0, 0.0),
    (34.0, -0.8),
    (36.0, 0.4),
)
"""Length, m, and change of heading, rad, of the pieces of the street; a long drive repeats them."""
HALT_M = 124.0
"""Distance of the first halt from the start."""
REPEAT_M = 220.0
"""Distance from one halt to the next."""
LEAD_M = 110.0
"""Length of straight street beyond both ends."""
BEHIND_M = 16.0
"""Part of it before the start that is lined."""
AHEAD_M = 90.0
"""Part of it after the end that is lined."""
KERB_M = 5.0
"""Distance of the kerb from the centre line; so the next four."""
PARKED_M = 4.05
"""Parked cars."""
GARDEN_M = 7.3
"""Edge of the gardens."""
HOUSE_M = 15.8
"""Middle of the houses."""
BACK_M = 30.0
"""Trees behind the gardens."""
LOT_M = 17.0
"""Width of a garden along the street."""
DRIVEWAY_M = 5.8
"""Middle of the driveway, along the street from the middle of the lot."""
_QUARTER_TURN = np.array(
    [[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
)
"""Rotation by π/2 about z."""
BANDS = (
    Band(KERB_M, Texture.ASPHALT, 5.0, albedo=0.28, contrast=0.8, is_road=True),
    Band(GARDEN_M - 0.3, Texture.PAVING, 2.6, albedo=0.4, contrast=0.8),
    Band(np.inf, Texture.GRASS, 2.4, albedo=0.27, contrast=0.9),
)


def residential(config: SceneConfig) -> Place:
    """Build the street and a drive along it, 220 m long by default."""
    # The street, its halts, and the drive.
    rng = place_rng(config)
    distance_m = config.distance_m or DISTANCE_M
    route = Route.from_turns(repeated(PIECES, distance_m), lead_m=LEAD_M)
    stops_m = tuple(float(s) for s in np.arange(HALT_M, distance_m - 20.0, REPEAT_M))
    plan = DrivePlan(
        start_m=0.0,
        distance_m=distance_m,
        speed_m_s=SPEED_M_S,
        lateral_m=-LANE_OFFSET_M,
        stops_m=stops_m,
    )

    # What stands beside it, and what lies on it.
    gardens = clear_of_road([*_lots(route, rng), *_behind(route, rng)], route, GARDEN_M - 0.6)
    street = clear_of_road(
        [*_kerbs(route), *_street(route, stops_m, rng)], route, LANE_OFFSET_M + HALF_LANE_M
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
    """Build a house on each lot, with its garden in front."""
    objects = []
    for side in (-1.0, 1.0):
        to_road = np.eye(4) if side < 0.0 else HALF_TURN
        for s in stations(
            route, side * HOUSE_M, -BEHIND_M, end_m=route.length_m + AHEAD_M, spacing_m=LOT_M
        ):
            # On the outer side of a bend a garden is narrower than at its house.
            shrink = 1.0 / max(1.0 - float(route.curvature(s)) * side * GARDEN_M, 0.5)
            for item, along, away in [*_buildings(rng), *_garden(rng)]:
                objects.append(item.at(route.place(s + along * shrink, side * away) @ to_road))
    return objects


def _buildings(rng: np.random.Generator) -> list[tuple[Solids, float, float]]:
    """Build the house, perhaps a garage, and perhaps a car on the driveway.

    Each comes with its place along the street from the middle of the lot, and its distance from the
    centre line, m.
    """
    house = furniture.house(rng)
    if rng.random() < 0.35:  # gable towards the street
        house = house.at(_QUARTER_TURN)
    along = float(rng.uniform(-2.5, -1.5))
    parts = [(house, along, HOUSE_M + float(rng.uniform(-0.8, 1.5)))]

    # At the driveway, a garage behind and a car in front.
    if rng.random() < 0.6:
        parts.append((_garage(rng), DRIVEWAY_M, HOUSE_M + 0.5))
    if rng.random() < 0.5:
        turned = _QUARTER_TURN if rng.random() < 0.5 else _QUARTER_TURN @ HALF_TURN
        parts.append((furniture.car(rng).at(turned), DRIVEWAY_M, GARDEN_M + 2.6))
    return parts


def _garden(rng: np.random.Generator) -> list[tuple[Solids, float, float]]:
    """Build the bounds of a garden, beside its driveway, and what grows in it.

    Each comes with its place along the street from the middle of the lot, and its distance from the
    centre line, m.
    """
    # Hedge, fence or wall.
    height = float(rng.uniform(0.9, 1.9))
    kind = rng.random()
    parts = []
    for along in (-5.6, -0.3):
        if kind < 0.45:
            bound = furniture.hedge(5.3, height, tile=2.6)
        elif kind < 0.75:
            bound = furniture.fence(5.3, 0.6 * height)
        else:
            bound = _wall(5.3, 0.5 * height)
        parts.append((bound, along, GARDEN_M))
    driveway = solid(
        BOX, (3.4, 9.0, 0.01), (0, 0, 0.005), texture=Texture.CONCRETE, tile_m=3.0, albedo=0.4
    )
    parts.append((driveway, DRIVEWAY_M, GARDEN_M + 4.0))

    # Bushes and trees.
    for _ in range(rng.integers(1, 4)):
        bush = furniture.bush(rng)
        along = float(rng.uniform(-8.0, 3.0))
        parts.append((bush, along, float(rng.uniform(GARDEN_M + 1.5, 11.0))))
    for _ in range(rng.integers(0, 3)):
        tree = furniture.tree(rng, rng.uniform(4.0, 8.0))
        along = float(rng.uniform(-8.0, 3.0))
        parts.append((tree, along, float(rng.uniform(GARDEN_M + 1.5, 10.5))))

    # A pair of bins at the driveway.
    if rng.random() < 0.6:
        bins = join(furniture.litter_bin(rng).at(_shifted(x)) for x in (0.0, 0.8))
        parts.append((bins, 3.0, GARDEN_M + 0.2))
    return parts


def _shifted(x: float) -> np.ndarray:
    """Return a translation by x along the first axis, [4, 4], m."""
    T_a_b = np.eye(4)
    T_a_b[0, 3] = x
    return T_a_b


def _garage(rng: np.random.Generator) -> Solids:
    """Build a flat-roofed garage with doors on both sides along y."""
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
    """Build a garden wall along x under a row of slabs."""
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
    """Build tall trees behind the gardens, and houses and trees across both ends of the street."""
    objects = []
    end_m = route.length_m + AHEAD_M
    for side in (-1.0, 1.0):
        for s in stations(route, side * BACK_M, -BEHIND_M, end_m=end_m, spacing_m=6.0):
            crown = furniture.distant_tree(rng)
            objects.append(crown.at(route.place(s, side * (BACK_M + rng.uniform(-4.0, 10.0)))))

    # Across the ends: a row of houses, and trees behind it.
    for s, back in ((-BEHIND_M - 26.0, -12.0), (end_m + 26.0, 12.0)):
        for y in np.arange(-33.0, 34.0, 11.0):
            objects.append(furniture.house(rng).at(crosswise(route, s, y)))
        for y in np.arange(-60.0, 61.0, 8.0):
            objects.append(furniture.distant_tree(rng).at(route.place(s + back, y)))
    return objects


def _kerbs(route: Route) -> list[Solids]:
    """Build the kerbs on both sides."""
    return [
        furniture.kerb(5.1).at(route.place(s, side * (KERB_M + 0.1)))
        for side in (-1.0, 1.0)
        for s in stations(
            route, side * KERB_M, -BEHIND_M, end_m=route.length_m + AHEAD_M, spacing_m=5.0
        )
    ]


def _street(route: Route, stops_m: tuple[float, ...], rng: np.random.Generator) -> list[Solids]:
    """Build cars at the kerb, and lamp posts, signs and boxes on the pavement."""
    objects = []
    end_m = route.length_m + AHEAD_M
    for side in (-1.0, 1.0):
        to_road = np.eye(4) if side < 0.0 else HALF_TURN
        for s in stations(route, side * PARKED_M, -BEHIND_M, end_m=end_m, spacing_m=8.0):
            # Parked cars, none where the drive halts.
            vehicle = furniture.van(rng) if rng.random() < 0.08 else furniture.car(rng)
            is_at_stop = any(-6.0 < s - stop < 10.0 for stop in stops_m)
            if rng.random() < 0.3 and not is_at_stop:
                objects.append(vehicle.at(route.place(s, side * PARKED_M) @ to_road))
        for s in stations(
            route, side * GARDEN_M, -BEHIND_M + 10.0 * side, end_m=end_m, spacing_m=28.0
        ):
            objects.append(
                furniture.lamp_post(5.0).at(route.place(s, side * (GARDEN_M - 0.4)) @ to_road)
            )
            if rng.random() < 0.5:
                objects.append(
                    furniture.road_sign(rng).at(
                        route.place(s + 11.0, side * (KERB_M + 0.4)) @ to_road
                    )
                )
            if rng.random() < 0.4:
                objects.append(
                    furniture.box(rng).at(route.place(s + 18.0, side * (GARDEN_M - 0.6)))
                )
    return objects


def _marks(route: Route, stops_m: tuple[float, ...], rng: np.random.Generator) -> list[Solids]:
    """Build the marks: a line at each halt, lids, and the many patches of an old street."""
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
