"""The preset ``road``: a motorway through open country, wide and poor in texture.

Rails, posts and signs stand along it, and hills in the distance.
"""

from __future__ import annotations

import numpy as np

from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.drive import DrivePlan
from probevo_sim.scene.presets import furniture
from probevo_sim.scene.presets.place import Band, Place, clear_of_road, compose, place_rng
from probevo_sim.scene.presets.traffic import LANE_M
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture

DISTANCE_M = 400.0
SPEED_M_S = 21.0
_LEAD_M = 320.0
"""Length of straight road beyond both ends."""
_MEDIAN_M = 1.0
"""Half the width of the strip between the carriageways."""
_LINE_M = 1.4
"""Distance of the inner edge line from the centre line; so the next five."""
_OUTER_LINE_M = _LINE_M + 2.0 * LANE_M + 0.2
_PAVED_M = _OUTER_LINE_M + 2.0
"""Edge of the pavement."""
_RAIL_M = _PAVED_M + 0.6
_REFLECTOR_M = _PAVED_M + 0.3
_SIGN_M = _PAVED_M + 1.6
_BANDS = (
    Band(_MEDIAN_M, Texture.GRASS, 2.0, albedo=0.28, contrast=0.8),
    Band(_PAVED_M, Texture.ASPHALT, 5.0, albedo=0.27, contrast=0.9, is_road=True),
    Band(_PAVED_M + 1.2, Texture.DIRT, 2.5, albedo=0.38, contrast=0.9),
    Band(np.inf, Texture.GRASS, 3.5, albedo=0.3, contrast=0.9),
)


def road(config: SceneConfig) -> Place:
    """Build two lanes each way in gentle curves, and a drive of 400 m by default at 21 m/s.

    The drive keeps to the right one of its two lanes.
    """
    rng = place_rng(config)
    distance_m = config.distance_m or DISTANCE_M
    route = _route(distance_m, rng)
    plan = DrivePlan(
        start_m=0.0, distance_m=distance_m, speed_m_s=SPEED_M_S, lateral_m=-(_LINE_M + 1.5 * LANE_M)
    )

    # What stands beside the road is lined up far beyond its end, as one sees far.
    end_m = distance_m + 200.0
    standing = [*_furniture(route, end_m, rng), *_structures(route, distance_m, rng)]
    standing += clear_of_road(_country(route, end_m, rng), route, _PAVED_M + 2.0)
    marks = _marks(route, plan, end_m, rng=rng)
    return compose(
        config, route, plan, bands=_BANDS, standing=standing, marks=marks, foliage_m=_PAVED_M + 3.5
    )


def _route(distance_m: float, rng: np.random.Generator) -> Route:
    """Alternate bends of about 250 m radius to either side with straight stretches."""
    pieces = [(60.0, 0.0)]
    side = float(rng.choice([-1.0, 1.0]))
    while sum(length for length, _ in pieces) < distance_m + 60.0:
        length = rng.uniform(90.0, 150.0)
        pieces += [
            (length, side * length / rng.uniform(450.0, 700.0)),
            (rng.uniform(20.0, 70.0), 0.0),
        ]
        side = -side
    return Route.from_turns(pieces, lead_m=_LEAD_M)


def _along(route: Route, item: Solids, s_m: float, lateral_m: float) -> Solids:
    """Return an object placed along the road, so far to the left of the centre line."""
    return item.at(route.place(s_m, lateral_m))


def _furniture(route: Route, end_m: float, rng: np.random.Generator) -> list[Solids]:
    """Build rails, reflector posts, signs and a noise barrier."""
    # A rail in the median; rails at the edges that begin and end at random.
    objects = []
    for s in np.arange(-24.0, end_m, 12.0):
        objects.append(_along(route, furniture.guard_rail(12.0), s, lateral_m=0.0))
    for side in (-1.0, 1.0):
        has_rail = False
        for s in np.arange(-24.0, end_m, 12.0):
            has_rail = has_rail != (rng.random() < 0.12)
            if has_rail:
                objects.append(
                    _along(route, furniture.guard_rail(12.0), s, lateral_m=side * _RAIL_M)
                )

        # Posts at equal distances, signs at about equal ones.
        objects += [
            _along(route, _reflector_post(), s, lateral_m=side * _REFLECTOR_M)
            for s in np.arange(-20.0, end_m, 25.0)
        ]
        for s in np.arange(rng.uniform(20.0, 80.0), end_m, 90.0):
            sign = _board(rng) if rng.random() < 0.4 else furniture.road_sign(rng)
            objects.append(
                _along(route, sign, s + rng.uniform(-20.0, 20.0), lateral_m=side * _SIGN_M)
            )

    # One stretch of noise barrier on one side.
    side = rng.choice([-1.0, 1.0])
    start_m = rng.uniform(0.2, 0.5) * end_m
    objects += [
        _along(route, _barrier(rng), s, lateral_m=side * (_SIGN_M + 1.4))
        for s in np.arange(start_m, start_m + 90.0, 6.0)
    ]
    return objects


def _structures(route: Route, distance_m: float, rng: np.random.Generator) -> list[Solids]:
    """Build gantries with signs and bridges over the road, alternately."""
    objects = []
    first_m = rng.uniform(80.0, 140.0)
    spacing_m = rng.uniform(140.0, 200.0)
    for k, s in enumerate(np.arange(first_m, distance_m + 120.0, spacing_m)):
        structure = _bridge(rng) if k % 2 else _gantry(rng)
        objects.append(_along(route, structure, s, lateral_m=0.0))
    return objects


def _country(route: Route, end_m: float, rng: np.random.Generator) -> list[Solids]:
    """Build the country: bushes, trees, farms and pylons in the fields, wooded hills behind."""
    # On the verge.
    objects = []
    for s, side in _scatter(end_m, 7.0, rng):
        bush = furniture.bush(rng) if rng.random() < 0.7 else furniture.rock(rng)
        objects.append(_along(route, bush, s, lateral_m=side * rng.uniform(_PAVED_M + 3.5, 24.0)))
    for s, side in _scatter(end_m, 2.5, rng):
        tuft = _tuft(rng)
        lateral_m = side * rng.uniform(_PAVED_M + 2.2, _PAVED_M + 6.0)
        objects.append(_along(route, tuft, s, lateral_m=lateral_m))

    # Objects in the fields.
    for s, side in _scatter(end_m + 100.0, 22.0, rng):
        lateral_m = side * rng.choice([rng.uniform(18.0, 35.0), rng.uniform(35.0, 90.0)])
        for _ in range(rng.integers(1, 4)):
            tree = furniture.tree(rng, rng.uniform(6.0, 13.0))
            along_m = s + rng.uniform(-8.0, 8.0)
            away_m = lateral_m + rng.uniform(-5.0, 5.0)
            objects.append(_along(route, tree, along_m, lateral_m=away_m))
    for s, side in _scatter(end_m + 100.0, 190.0, rng):
        objects += _wood(route, s, side, rng=rng)
    for s, side in _scatter(end_m + 200.0, 110.0, rng):
        objects.append(
            _along(route, furniture.house(rng), s, lateral_m=side * rng.uniform(45.0, 110.0))
        )
    for s, side in _scatter(end_m + 200.0, 70.0, rng):
        objects.append(
            _along(
                route,
                furniture.lamp_post(rng.uniform(9.0, 14.0)),
                s,
                lateral_m=side * rng.uniform(25.0, 60.0),
            )
        )
    for s, side in _scatter(end_m + 800.0, 45.0, rng):
        lateral_m = side * rng.uniform(220.0, 520.0)
        objects.append(_along(route, _hill(rng), s, lateral_m=lateral_m))
    middle = route.position(0.5 * end_m)
    for bearing in np.arange(0.0, 2.0 * np.pi, 0.16):
        away_m = 0.5 * end_m + rng.uniform(450.0, 900.0)
        T = np.eye(4)
        T[:2, 3] = middle + away_m * np.array([np.cos(bearing), np.sin(bearing)])
        objects.append(_hill(rng, 1.8).at(T))
    return objects


def _tuft(rng: np.random.Generator) -> Solids:
    """Build high grass or weeds, or a stone, 0.2 to 0.7 m high."""
    size_m = rng.uniform([0.4, 0.4, 0.4], [1.1, 0.9, 1.3])
    texture = Texture(rng.choice([Texture.FOLIAGE, Texture.GRASS, Texture.GRASS, Texture.ROCK]))
    yaw = rng.uniform(-np.pi, np.pi)
    shift_m = rng.uniform(0.0, 2.0, 2)
    return solid(
        ELLIPSOID,
        size_m,
        (0, 0, 0),
        texture=texture,
        tile_m=1.2,
        yaw_rad=yaw,
        albedo=rng.uniform(0.22, 0.45),
        shift_m=shift_m,
    )


def _wood(route: Route, start_m: float, side: float, rng: np.random.Generator) -> list[Solids]:
    """Build the edge of a wood along the road: trees in two rows."""
    nearest_m = rng.uniform(22.0, 45.0)
    length_m = rng.uniform(50.0, 110.0)
    return [
        _along(
            route,
            furniture.tree(rng, rng.uniform(8.0, 13.0)),
            start_m + along,
            lateral_m=side * (nearest_m + across),
        )
        for across in (0.0, 7.0)
        for along in np.arange(0.0, length_m, 7.0) + rng.uniform(-1.5, 1.5)
    ]


def _scatter(end_m: float, pitch_m: float, rng: np.random.Generator) -> list[tuple[float, float]]:
    """Return random (s, side) along both sides of the road, ``pitch_m`` apart on average."""
    count = int((end_m + 60.0) / pitch_m)
    return [(s, side) for side in (-1.0, 1.0) for s in rng.uniform(-60.0, end_m, count)]


def _hill(rng: np.random.Generator, scale: float = 1.0) -> Solids:
    """Build a hill, wooded or under grass, whose lower half is below the ground."""
    size_m = scale * rng.uniform([120.0, 80.0, 30.0], [280.0, 160.0, 75.0])
    is_wooded = rng.random() < 0.6
    return solid(
        ELLIPSOID,
        size_m,
        (0.0, 0.0, 0.0),
        texture=Texture.FOLIAGE if is_wooded else Texture.GRASS,
        tile_m=rng.uniform(30.0, 60.0) * scale,
        yaw_rad=rng.uniform(-0.6, 0.6),
        albedo=rng.uniform(0.2, 0.3),
        contrast=0.9,
        shift_m=rng.uniform(0.0, 200.0, 2),
    )


def _reflector_post() -> Solids:
    """Build a white post with a black band, 1 m high."""
    post = solid(
        BOX,
        (0.12, 0.12, 1.0),
        (0, 0, 0.5),
        texture=Texture.METAL,
        tile_m=1.0,
        albedo=0.65,
        contrast=0.4,
    )
    return join(
        [
            post,
            solid(
                BOX,
                (0.13, 0.13, 0.22),
                (0, 0, 0.78),
                texture=Texture.PLAIN,
                tile_m=1.0,
                albedo=0.06,
            ),
        ]
    )


def _board(rng: np.random.Generator) -> Solids:
    """Build a direction board on two poles, 3.5 m wide."""
    poles = [
        solid(BOX, (0.12, 0.12, 3.4), (0, y, 1.7), texture=Texture.METAL, tile_m=1.0, albedo=0.35)
        for y in (-1.2, 1.2)
    ]
    shift_m = rng.uniform(0.0, 2.0, 2)
    plate = solid(
        BOX,
        (0.1, 3.5, 2.0),
        (-0.1, 0, 2.6),
        texture=Texture.SIGN,
        tile_m=[[3.5, 2.0], [1.0, 1.0], [1.0, 1.0]],
        shift_m=shift_m,
    )
    return join([*poles, plate])


def _barrier(rng: np.random.Generator) -> Solids:
    """Build 6 m of a noise barrier: panels between posts."""
    texture = Texture(rng.choice([Texture.CONCRETE, Texture.FENCE]))
    shift_m = rng.uniform(0.0, 6.0, 2)
    panel = solid(
        BOX, (6.0, 0.2, 3.0), (0, 0, 1.5), texture=texture, tile_m=3.0, albedo=0.4, shift_m=shift_m
    )
    return join(
        [
            panel,
            solid(
                BOX, (0.25, 0.3, 3.2), (3.0, 0, 1.6), texture=Texture.METAL, tile_m=1.0, albedo=0.25
            ),
        ]
    )


def _gantry(rng: np.random.Generator) -> Solids:
    """Build a gantry: signs on a beam across both carriageways."""
    side_m = _PAVED_M + 0.9
    posts = [
        solid(BOX, (0.4, 0.4, 6.8), (0, y, 3.4), texture=Texture.METAL, tile_m=1.5, albedo=0.35)
        for y in (-side_m, 0.0, side_m)
    ]
    beam = solid(
        BOX, (0.5, 2.0 * side_m, 0.6), (0, 0, 6.5), texture=Texture.FENCE, tile_m=1.0, albedo=0.35
    )
    tile_m = [[3.0, 2.2], [1.0, 1.0], [1.0, 1.0]]
    signs = [
        solid(
            BOX,
            (0.15, 3.0, 2.2),
            (-0.4, y, 6.4),
            texture=Texture.SIGN,
            tile_m=tile_m,
            shift_m=rng.uniform(0.0, 3.0, 2),
        )
        for y in (-6.8, -3.2, 3.2, 6.8)
    ]
    return join([*posts, beam, *signs])


def _bridge(rng: np.random.Generator) -> Solids:
    """Build a bridge across the road, on walls beside it and piers between the carriageways."""
    length_m = 2.0 * _PAVED_M + 12.0
    yaw = rng.uniform(-0.25, 0.25)
    deck = solid(
        BOX,
        (7.0, length_m + 20.0, 0.9),
        (0, 0, 6.0),
        texture=Texture.CONCRETE,
        tile_m=4.0,
        yaw_rad=yaw,
        albedo=0.42,
    )
    rails = solid(
        BOX,
        (7.2, length_m + 20.0, 0.9),
        (0, 0, 6.9),
        texture=Texture.FENCE,
        tile_m=1.2,
        yaw_rad=yaw,
        albedo=0.3,
    )
    walls = [
        solid(
            BOX,
            (9.0, 12.0, 5.6),
            (0, side * (_PAVED_M + 9.0), 2.8),
            texture=Texture.BRICK,
            tile_m=4.0,
            albedo=0.4,
        )
        for side in (-1.0, 1.0)
    ]
    piers = [
        solid(BOX, (0.9, 0.9, 5.6), (x, 0, 2.8), texture=Texture.CONCRETE, tile_m=3.0, albedo=0.42)
        for x in (-2.5, 2.5)
    ]
    return join([deck, rails, *walls, *piers])


def _marks(route: Route, plan: DrivePlan, end_m: float, rng: np.random.Generator) -> list[Solids]:
    """Build the marks: edge lines, lane dashes and patches."""
    edges = [_LINE_M, _OUTER_LINE_M, -_LINE_M, -_OUTER_LINE_M]
    marks = [
        _along(route, furniture.lane_dash(12.02, 0.18), s, lateral_m=lateral)
        for s in np.arange(-24.0, end_m, 12.0)
        for lateral in edges
    ]
    middle_m = _LINE_M + LANE_M
    marks += [
        _along(route, furniture.lane_dash(6.0, 0.16), s, lateral_m=side * middle_m)
        for s in np.arange(-24.0, end_m, 18.0)
        for side in (-1.0, 1.0)
    ]
    for s in np.arange(-10.0, plan.distance_m + 60.0, 9.0):
        lateral_m = rng.uniform(-_PAVED_M + 1.0, -_LINE_M - 1.0)
        marks.append(
            _along(route, furniture.patch(rng), s + rng.uniform(-4.0, 4.0), lateral_m=lateral_m)
        )
    return marks
