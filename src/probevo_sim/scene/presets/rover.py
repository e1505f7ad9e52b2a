"""The preset ``rover``: a field like another planet's, of dirt and rocks of all sizes.

A few crates and markers stand beside the track, and hills and buildings around the field.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from probevo.arrays import FloatArray
from probevo.geometry import se3
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.drive import DrivePlan
from probevo_sim.scene.presets import furniture
from probevo_sim.scene.presets.place import Band, Place, clear_of_road, compose, place_rng
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture

LOOP_M = 250.0
SPEED_M_S = 2.0
_TRACK_M = 1.4
"""Half the width of the track that is free of rocks."""
_BANDS = (Band(np.inf, Texture.DIRT, 3.0, albedo=0.29, contrast=0.9, is_road=True),)


def rover(config: SceneConfig) -> Place:
    """Build a closed loop, 250 m by default, and a drive at 2 m/s that ends exactly where it began.

    The drive begins and ends at rest. The camera is 0.9 m above the ground and looks down by 8°.
    Another ``config.drive`` deviates sideways differently.
    """
    # The loop, and the drive once around it.
    rng = place_rng(config)
    length_m = config.distance_m or LOOP_M
    route = Route.loop(length_m)
    plan = DrivePlan(
        start_m=0.0,
        distance_m=length_m,
        speed_m_s=SPEED_M_S,
        height_m=0.9,
        pitch_down_rad=np.deg2rad(8.0),
        from_rest=True,
        to_rest=True,
    )

    # Only the pebbles, over which the rover drives, may lie on the track.
    near = [*_stones(route, rng), *_markers(route, rng), *_camp(route, rng)]
    standing = [*clear_of_road(near, route, _TRACK_M), *_pebbles(route, rng), *_horizon(route, rng)]
    return compose(config, route, plan, bands=_BANDS, standing=standing, foliage_m=3.5)


def _stones(route: Route, rng: np.random.Generator) -> list[Solids]:
    """Build rocks all over the field: many small ones, few large ones, most near the track."""
    # From the track outwards: mean distance along it from rock to rock, reach, range of sizes.
    objects = []
    for pitch_m, reach_m, sizes_m in (
        (0.4, 6.0, (0.12, 0.5)),
        (0.8, 14.0, (0.3, 1.0)),
        (3.0, 30.0, (0.8, 2.6)),
    ):
        count = int(route.length_m / pitch_m)
        size_m = sizes_m[0] * (sizes_m[1] / sizes_m[0]) ** (rng.random(count) ** 1.5)
        lateral_m = rng.uniform(-reach_m, reach_m, count)
        s_m = rng.uniform(0.0, route.length_m, count)
        for s, lateral, size in zip(s_m, lateral_m, size_m, strict=True):
            stone = _slab(size, rng) if rng.random() < 0.3 else furniture.rock(rng, size)
            objects.append(stone.at(_beside_track(route, s, lateral, rng=rng)))
    return objects


def _pebbles(route: Route, rng: np.random.Generator) -> list[Solids]:
    """Build stones that the rover drives over: 1 to 2 cm high, three on each metre of the track."""
    return [
        solid(
            ELLIPSOID,
            rng.uniform([0.04, 0.04, 0.02], [0.26, 0.18, 0.036]),
            (0.0, 0.0, 0.0),
            texture=Texture.ROCK,
            tile_m=0.5,
            albedo=rng.uniform(0.2, 0.5),
            shift_m=rng.uniform(0.0, 1.0, 2),
        ).at(_beside_track(route, s, lateral_m, rng=rng))
        for s, lateral_m in rng.uniform(
            [0.0, -2.0], [route.length_m, 2.0], (int(3 * route.length_m), 2)
        )
    ]


def _markers(route: Route, rng: np.random.Generator) -> list[Solids]:
    """Build crates, poles, signs and boards with a pattern beside the track."""
    makers: tuple[Callable[[np.random.Generator], Solids], ...] = (
        _crate,
        _crate,
        _pole,
        furniture.road_sign,
        _target,
    )
    markers = []
    for s in np.arange(4.0, route.length_m, 9.0):
        marker = makers[rng.integers(len(makers))](rng)
        along_m = s + rng.uniform(-3.0, 3.0)
        lateral_m = rng.choice([-1.0, 1.0]) * rng.uniform(2.6, 9.0)
        markers.append(marker.at(_beside_track(route, along_m, lateral_m, rng=rng)))
    return markers


def _camp(route: Route, rng: np.random.Generator) -> list[Solids]:
    """Build a camp in the middle of the loop: containers, a mast, and crates around them."""
    middle = route.position(np.linspace(0.0, route.length_m, 100)).mean(axis=0)
    objects = []

    # Containers, crates around them, and the mast in the centre.
    for _ in range(4):
        size_m = (6.0, 2.4, 2.5)
        box = solid(
            BOX,
            size_m,
            (0, 0, 1.25),
            texture=Texture.METAL,
            tile_m=2.5,
            albedo=rng.uniform(0.3, 0.6),
            contrast=0.9,
        )
        door = solid(
            BOX, (6.02, 1.6, 1.9), (0, 0, 1.0), texture=Texture.SIGN, tile_m=1.6, albedo=0.45
        )
        objects.append(join([box, door]).at(_standing(middle + rng.uniform(-12.0, 12.0, 2), rng)))
    objects += [
        _crate(rng).at(_standing(middle + rng.uniform(-15.0, 15.0, 2), rng)) for _ in range(12)
    ]
    return [*objects, furniture.lamp_post(9.0).at(_standing(middle, rng))]


def _horizon(route: Route, rng: np.random.Generator) -> list[Solids]:
    """Build a ring of hills, and before them trees and a few buildings."""
    line = route.position(np.linspace(0.0, route.length_m, 200))
    middle = line.mean(axis=0)
    radius_m = float(np.linalg.norm(line - middle, axis=1).max())
    objects = []

    def around(count: int, low_m: float, high_m: float) -> list[FloatArray]:
        """Return places in all directions, from ``low_m`` to ``high_m`` outside of the loop."""
        bearing = 2.0 * np.pi * (np.arange(count) + rng.random(count)) / count
        away_m = radius_m + rng.uniform(low_m, high_m, count)
        return list(middle + away_m[:, None] * np.stack([np.cos(bearing), np.sin(bearing)], axis=1))

    # Hills behind, trees and buildings in front.
    for place in around(40, 110.0, 240.0):
        size_m = rng.uniform([50.0, 40.0, 14.0], [120.0, 90.0, 44.0])
        texture = Texture(rng.choice([Texture.ROCK, Texture.DIRT, Texture.FOLIAGE]))
        hill = solid(
            ELLIPSOID,
            size_m,
            (0, 0, 0),
            texture=texture,
            tile_m=24.0,
            albedo=rng.uniform(0.25, 0.4),
            contrast=0.9,
        )
        objects.append(hill.at(_standing(place, rng)))
    objects += [furniture.tree(rng).at(_standing(place, rng)) for place in around(45, 28.0, 80.0)]
    objects += [
        furniture.block(rng, floors=2).at(_standing(place, rng)) for place in around(5, 50.0, 80.0)
    ]
    return objects


def _slab(size: float, rng: np.random.Generator) -> Solids:
    """Build a broken piece of rock, tilted."""
    size_m = size * rng.uniform([0.8, 0.5, 0.4], [1.2, 0.9, 0.8])
    # Tilted about x and y, and raised so that about a quarter of it is in the ground.
    T = se3.exp(np.r_[0.0, 0.0, 0.0, rng.uniform(-0.35, 0.35, 2), 0.0])
    T[2, 3] = 0.25 * size_m[2]
    shift_m = rng.uniform(0.0, 2.0, 2)
    return solid(
        BOX,
        size_m,
        (0, 0, 0),
        texture=Texture.ROCK,
        tile_m=1.2,
        albedo=rng.uniform(0.3, 0.48),
        shift_m=shift_m,
    ).at(T)


def _crate(rng: np.random.Generator) -> Solids:
    """Build a crate of wood or metal, with a sign on it."""
    size_m = rng.uniform([0.6, 0.5, 0.4], [1.2, 0.9, 1.0])
    texture = Texture(rng.choice([Texture.FENCE, Texture.METAL, Texture.PLASTER]))
    box = solid(
        BOX,
        size_m,
        (0, 0, 0.5 * size_m[2]),
        texture=texture,
        tile_m=0.9,
        albedo=rng.uniform(0.3, 0.6),
    )
    label_m = (size_m[0] + 0.01, 0.6 * size_m[1], 0.5 * size_m[2])
    tile_m = [[label_m[1], label_m[2]], [1.0, 1.0], [1.0, 1.0]]
    return join(
        [box, solid(BOX, label_m, (0, 0, 0.5 * size_m[2]), texture=Texture.SIGN, tile_m=tile_m)]
    )


def _pole(rng: np.random.Generator) -> Solids:
    """Build a pole in black and white, 2 m high."""
    return solid(
        BOX,
        (0.08, 0.08, rng.uniform(1.6, 2.4)),
        (0, 0, 1.0),
        texture=Texture.CHECKERBOARD,
        tile_m=1.6,
        albedo=0.4,
    )


def _target(rng: np.random.Generator) -> Solids:
    """Build a chequered board on a foot."""
    board = solid(
        BOX,
        (0.04, 0.8, 0.8),
        (0, 0, 1.0),
        texture=Texture.CHECKERBOARD,
        tile_m=rng.choice([0.8, 1.6]),
        albedo=0.42,
    )
    return join(
        [
            board,
            solid(
                BOX,
                (0.06, 0.06, 1.0),
                (0.05, 0, 0.5),
                texture=Texture.METAL,
                tile_m=1.0,
                albedo=0.3,
            ),
        ]
    )


def _beside_track(
    route: Route, s_m: float, lateral_m: float, rng: np.random.Generator
) -> FloatArray:
    """Return T_world_object, [4, 4], m, of a place beside the track, facing anywhere."""
    return _standing(route.place(s_m, lateral_m)[:2, 3], rng)


def _standing(place_m: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Return T_world_object, [4, 4], m, of a place on the ground, [2], m, facing anywhere."""
    T_world_object = se3.exp(np.r_[np.zeros(5), rng.uniform(-np.pi, np.pi)])
    T_world_object[:2, 3] = place_m
    return T_world_object
