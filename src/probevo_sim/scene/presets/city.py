"""The preset ``city``: a dense street of town houses, with bends and a halt at traffic lights."""

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
from probevo_sim.scene.solids import BOX, Solids, solid
from probevo_sim.scene.textures import Texture

DISTANCE_M = 220.0
SPEED_M_S = 8.0
LANE_OFFSET_M = 1.7
"""Distance of the driven lane's middle from the centre line, to the right."""
PIECES = ((66.0, 0.0), (26.0, -0.5 * np.pi), (52.0, 0.0), (26.0, 0.5 * np.pi), (50.0, 0.0))
"""Length, m, and change of heading, rad, of the pieces of the street; a long drive repeats them."""
HALT_M = 112.0
"""Distance of the first halt from the start."""
REPEAT_M = 220.0
"""Distance from one halt to the next."""
LEAD_M = 120.0
"""Length of straight street beyond both ends."""
BEHIND_M = 16.0
"""Part of it before the start that is lined."""
AHEAD_M = 90.0
"""Part of it after the end that is lined."""
KERB_M = 5.3
"""Distance of the kerb from the centre line; so the next four."""
PARKED_M = 4.3
"""Parked cars."""
POSTS_M = 7.6
"""Posts and trees."""
FRONT_M = 9.8
"""Fronts of the houses."""
BACK_M = 34.0
"""The houses behind them."""
DEPTH_M = 12.0
"""Depth of the houses in front."""
BANDS = (
    Band(KERB_M, Texture.ASPHALT, 5.0, albedo=0.27, contrast=0.8, is_road=True),
    Band(FRONT_M + 1.0, Texture.PAVING, 3.2, albedo=0.38, contrast=0.8),
    Band(np.inf, Texture.CONCRETE, 4.0, albedo=0.33, contrast=0.8),
)


def city(config: SceneConfig) -> Place:
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
    houses = clear_of_road(_houses(route, rng), route, FRONT_M - 0.5)
    objects = [
        *_kerbs(route),
        *_parked(route, stops_m, rng),
        *_pavement(route, rng),
        *_lights(route, stops_m),
    ]
    standing = [*houses, *clear_of_road(objects, route, LANE_OFFSET_M + HALF_LANE_M)]
    return compose(
        config,
        route,
        plan,
        bands=BANDS,
        standing=standing,
        marks=_marks(route, stops_m, rng),
        foliage_m=POSTS_M + 0.4,
    )


def _houses(route: Route, rng: np.random.Generator) -> list[Solids]:
    """Build the houses: fronts on both sides with occasional gaps, and houses behind them.

    A row of houses stands across each end of the street. In the gaps grow trees.
    """
    houses: list[Solids] = []
    end_m = route.length_m + AHEAD_M
    for side in (-1.0, 1.0):
        lateral_m = side * (FRONT_M + 0.5 * DEPTH_M)
        was_gap = True
        for s in stations(route, lateral_m, -BEHIND_M, end_m=end_m, spacing_m=15.0):
            # No two gaps follow each other.
            is_gap = not was_gap and rng.random() < 0.15
            if is_gap:
                trees = [(furniture.tree(rng, rng.uniform(6, 9)), along) for along in (-4.0, 3.5)]
                houses.extend(
                    tree.at(route.place(s + along, side * (FRONT_M + 4.0))) for tree, along in trees
                )
            else:
                house = furniture.block(rng, 15.4, DEPTH_M)
                houses.append(house.at(route.place(s, lateral_m + rng.uniform(-0.3, 0.3))))
            was_gap = is_gap
        behind = stations(route, side * BACK_M, -BEHIND_M, end_m=end_m, spacing_m=20.0)
        houses.extend(_tower(rng).at(route.place(s, side * BACK_M)) for s in behind)

    # A row of houses across each end.
    for s in (-BEHIND_M - 14.0, end_m + 14.0):
        houses.extend(
            furniture.block(rng, 15.4, DEPTH_M).at(crosswise(route, s, y))
            for y in (-31, -15.5, 0, 15.5, 31)
        )
    return houses


def _tower(rng: np.random.Generator) -> Solids:
    """Build a tall house of which one sees only the upper floors."""
    height = rng.integers(6, 10) * 3.0
    front = Texture(rng.choice([Texture.FACADE_FLATS, Texture.FACADE_OFFICE]))
    albedo = rng.uniform(0.35, 0.55)
    return solid(
        BOX,
        (18.0, 12.0, height),
        (0, 0, 0.5 * height),
        texture=front,
        tile_m=12.0,
        albedo=albedo,
        shift_m=(0, 3 * albedo // 0.1),
    )


def _kerbs(route: Route) -> list[Solids]:
    """Build the kerbs on both sides."""
    return [
        furniture.kerb(4.1).at(route.place(s, side * (KERB_M + 0.1)))
        for side in (-1.0, 1.0)
        for s in stations(
            route, side * KERB_M, -BEHIND_M, end_m=route.length_m + AHEAD_M, spacing_m=4.0
        )
    ]


def _parked(route: Route, stops_m: tuple[float, ...], rng: np.random.Generator) -> list[Solids]:
    """Build the cars along both kerbs, heading with the traffic; none in bends or at crosswalks."""
    cars = []
    for side in (-1.0, 1.0):
        for s in stations(
            route, side * PARKED_M, -BEHIND_M, end_m=route.length_m + AHEAD_M, spacing_m=6.4
        ):
            vehicle = furniture.van(rng) if rng.random() < 0.12 else furniture.car(rng)
            across = float(rng.uniform(-0.05, 0.05))
            is_in_way = abs(route.curvature(s)) > 0.02 or any(
                -6.0 < s - stop < 16.0 for stop in stops_m
            )
            if rng.random() < 0.65 and not is_in_way:
                pose = route.place(s, side * PARKED_M + across)
                cars.append(vehicle.at(pose @ HALF_TURN if side > 0.0 else pose))
    return cars


def _pavement(route: Route, rng: np.random.Generator) -> list[Solids]:
    """Build lamp posts, trees and signs near the kerb; boxes, bins and benches near the fronts."""
    objects = []
    end_m = route.length_m + AHEAD_M
    for side in (-1.0, 1.0):
        to_road = np.eye(4) if side < 0.0 else HALF_TURN
        for s in stations(
            route, side * POSTS_M, -BEHIND_M + 6.0 * side, end_m=end_m, spacing_m=24.0
        ):
            objects.append(furniture.lamp_post().at(route.place(s, side * POSTS_M) @ to_road))
            for along in (7.0, 16.0):
                tree = furniture.tree(rng, rng.uniform(5.0, 7.5))
                if rng.random() < 0.55:
                    objects.append(tree.at(route.place(s + along, side * POSTS_M)))

        # One object every 9 m, of a kind drawn at random, or none.
        for s in stations(route, side * FRONT_M, -BEHIND_M, end_m=end_m, spacing_m=9.0):
            kind = rng.random()
            along = float(rng.uniform(-3.0, 3.0))
            near_front = side * (FRONT_M - 0.8)
            near_kerb = side * (KERB_M + 0.6)
            if kind < 0.25:
                objects.append(
                    furniture.road_sign(rng).at(route.place(s + along, near_kerb) @ to_road)
                )
            elif kind < 0.4:
                objects.append(furniture.box(rng).at(route.place(s + along, near_front)))
            elif kind < 0.6:
                objects.extend(
                    furniture.litter_bin(rng).at(route.place(s + along + x, near_front))
                    for x in (0.0, 0.8)
                )
            elif kind < 0.7:
                objects.append(
                    furniture.bench().at(route.place(s + along, near_front) @ to_road @ HALF_TURN)
                )
            elif kind < 0.8:
                objects.append(furniture.bush(rng).at(route.place(s + along, near_front)))
    return objects


def _lights(route: Route, stops_m: tuple[float, ...]) -> list[Solids]:
    """Build a pair of traffic lights at each halt, one for either direction."""
    return [
        light
        for stop in stops_m
        for light in (
            furniture.traffic_light().at(route.place(stop + 9.5, -KERB_M - 0.5)),
            furniture.traffic_light().at(route.place(stop + 4.5, KERB_M + 0.5) @ HALF_TURN),
        )
    ]


def _marks(route: Route, stops_m: tuple[float, ...], rng: np.random.Generator) -> list[Solids]:
    """Build the marks: dashes in the middle, crosswalks, halt lines, arrows, lids and patches."""
    end_m = route.length_m + AHEAD_M
    dashes = stations(route, 0.0, -BEHIND_M, end_m=end_m, spacing_m=7.5)
    marks = [furniture.lane_dash().at(route.place(s, 0.0)) for s in dashes]
    for stop in stops_m:
        marks.append(furniture.crosswalk(2.0 * KERB_M).at(route.place(stop + 7.0, 0.0)))
        marks.append(
            furniture.lane_dash(0.5, KERB_M - 0.3).at(route.place(stop + 3.5, -0.5 * KERB_M))
        )
        marks.append(furniture.arrow().at(route.place(stop - 4.0, -LANE_OFFSET_M)))
    marks.append(furniture.crosswalk(2.0 * KERB_M).at(route.place(24.0, 0.0)))
    for s in stations(route, 0.0, -BEHIND_M, end_m=end_m, spacing_m=11.0):
        marks.append(
            furniture.patch(rng).at(route.place(s + rng.uniform(-4, 4), rng.uniform(-3.5, 3.5)))
        )
        if rng.random() < 0.5:
            marks.append(
                furniture.manhole().at(route.place(s + rng.uniform(-4, 4), rng.uniform(-2.5, 2.5)))
            )
    return marks
