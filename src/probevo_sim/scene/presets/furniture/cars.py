"""Cars and vans, which stand or drive in a street."""

from __future__ import annotations

import numpy as np

from probevo_sim.scene.presets.furniture.parts import sloping
from probevo_sim.scene.solids import BOX, ELLIPSOID, Solids, join, solid
from probevo_sim.scene.textures import Texture

GLASS = 0.1
"""Albedo of windows."""


def car(rng: np.random.Generator) -> Solids:
    """Build a passenger car, about 4.3 × 1.75 × 1.45."""
    # The drawn views span the whole car, so each part shows its share of them.
    length, width, height = rng.uniform([3.9, 1.7, 1.4], [4.7, 1.82, 1.55])
    tile = np.array([[width, height], [length, height], [length, width]])
    views = (Texture.CAR_FRONT, Texture.CAR_SIDE, Texture.CAR_TOP)
    paint = float(rng.choice([0.1, 0.16, 0.24, 0.34, 0.46]))

    # The body below the windows, and the cabin; the drawn windows end where the roof does.
    waist = 0.64 * height
    foot = 0.15 * height
    rear = 0.13 * length
    front = 0.57 * length
    body = solid(
        BOX,
        (length, width, waist - foot),
        (0, 0, 0.5 * (foot + waist)),
        texture=views,
        tile_m=tile,
        albedo=paint,
        shift_m=(0, foot),
    )
    cabin = solid(
        BOX,
        (front - rear, 0.9 * width, height - waist),
        (0.5 * (front + rear - length), 0, 0.5 * (height + waist)),
        texture=(Texture.PLAIN, Texture.CAR_SIDE, Texture.PLAIN),
        tile_m=tile,
        albedo=paint,
        shift_m=(rear, waist),
    )

    # Windscreen and rear window slope from the roof down to the body.
    screens = []
    for roof, bonnet in ((front, 0.77 * length), (rear, 0.05 * length)):
        run = bonnet - roof
        drop = height - 0.01 - waist
        screens.append(
            sloping(
                (np.hypot(run, drop), 0.88 * width, 0.5 * height),
                (0.5 * (roof + bonnet - length), 0.0, waist + 0.5 * drop),
                Texture.CLOUDS,
                pitch=float(np.arctan2(drop, run) if run > 0 else -np.arctan2(drop, -run)),
                albedo=GLASS,
            )
        )
    wheels = [
        _wheel(x * length, y, 0.43 * height)
        for x in (-0.314, 0.302)
        for y in (-0.5 * width + 0.08, 0.5 * width - 0.08)
    ]
    return join([body, cabin, *screens, *wheels])


def van(rng: np.random.Generator) -> Solids:
    """Build a delivery van, about 5.6 × 2 × 2.5: a windowless box behind a short cab."""
    length, width, height = rng.uniform([5.2, 1.95, 2.3], [6.0, 2.1, 2.7])
    nose = 0.75 * height
    paint = rng.uniform(0.25, 0.45)
    cargo_length = 0.72 * length
    cargo = solid(
        BOX,
        (cargo_length, width, height - 0.35),
        (0.5 * (cargo_length - length), 0.0, 0.35 + 0.5 * (height - 0.35)),
        texture=(Texture.CAR_FRONT, Texture.CLOUDS, Texture.PLAIN),
        tile_m=[[width, height], [3.0, 3.0], [3.0, 3.0]],
        albedo=paint,
        contrast=0.6,
    )
    letters = solid(
        BOX,
        (0.5 * cargo_length, width + 0.02, 0.3 * height),
        (0.5 * (cargo_length - length), 0.0, 0.65 * height),
        texture=(Texture.PLAIN, Texture.SIGN, Texture.PLAIN),
        tile_m=[[1.0, 1.0], [0.25 * cargo_length, 0.3 * height], [1.0, 1.0]],
        albedo=0.4,
    )
    cab = solid(
        BOX,
        (length - cargo_length, width, 0.5 * nose),
        (0.5 * cargo_length, 0.0, 0.35 + 0.25 * nose),
        texture=(Texture.CAR_FRONT, Texture.METAL, Texture.PLAIN),
        tile_m=[[width, nose], [4.0, 4.0], [1.0, 1.0]],
        albedo=paint,
        contrast=0.5,
    )

    # The windows slope from the roof down to the nose.
    waist = 0.35 + 0.5 * nose
    run = 0.6 * (length - cargo_length)
    drop = height - 0.1 - waist
    windows = sloping(
        (np.hypot(run, drop), 0.94 * width, 0.9),
        (0.5 * (length - run) - 0.1, 0.0, waist + 0.5 * drop),
        Texture.CLOUDS,
        pitch=float(np.arctan2(drop, run)),
        albedo=GLASS,
    )
    wheels = [
        _wheel(x, y, 0.7)
        for x in (0.33 * length, -0.33 * length)
        for y in (-0.46 * width, 0.46 * width)
    ]
    return join([cargo, letters, cab, windows, *wheels])


def _wheel(x: float, y: float, diameter: float) -> Solids:
    """Build a wheel: a flat ellipsoid that shows the drawn wheel on its sides."""
    # Dimensions of the car in whose side view the wheel has this size.
    length = diameter / 0.145
    height = diameter / 0.43
    return solid(
        ELLIPSOID,
        (diameter, 0.24, diameter),
        (x, y, 0.5 * diameter),
        texture=(Texture.PLAIN, Texture.CAR_SIDE, Texture.PLAIN),
        tile_m=[[1.0, 1.0], [length, height], [1.0, 1.0]],
        albedo=0.2,
        contrast=0.9,
        shift_m=(0.802 * length - 0.5 * diameter, 0.0),
    )
