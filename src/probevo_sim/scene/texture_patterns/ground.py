"""Textures of the ground: asphalt, concrete, paving, dirt and rock."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo_sim.scene.texture_patterns.canvas import (
    SIDE,
    Tile,
    blank,
    downsampled,
    ellipse,
    noise,
    polygon,
    random_walk,
    rectangle,
    relief,
    stroke,
    upsampled,
)


def asphalt(rng: np.random.Generator) -> Tile:
    """Draw a grain of bright stones, with a repaired patch, a tar seam and cracks."""
    canvas = blank(0.0)
    rectangle(canvas, 300, 60, right=430, top=215, value=-0.55)
    stroke(canvas, [(300, 60), (430, 60), (430, 215), (300, 215)], 3, value=-2.0, closed=True)

    # The seam winds across the tile and meets itself at the edge.
    x = np.linspace(0, SIDE, 40)
    sway = 4 * np.sin(2 * np.pi * x / SIDE) + 3 * np.sin(6 * np.pi * x / SIDE + 1)
    stroke(canvas, np.stack([x, 330 + sway], axis=1), 5, value=-1.6)

    # Cracks with a branch each.
    for _ in range(7):
        course = random_walk(rng, 45, step=4.0, bend_rad=0.35)
        stroke(canvas, course, 1.0, value=-2.6)
        branch = random_walk(rng, 18, step=4.0, bend_rad=0.35)
        stroke(canvas, branch - branch[0] + course[rng.integers(10, 35)], 0.5, value=-2.0)

    # Grain, bright stones, and slow variations.
    grain = noise(rng, 0.0, 30)
    stones = np.maximum(noise(rng, 0.0, 60, high=200) - 1.3, 0)
    return downsampled(canvas) + 0.75 * grain + 1.2 * stones + 0.5 * noise(rng, 1.0, 2, high=60)


def concrete(rng: np.random.Generator) -> Tile:
    """Draw four cast slabs with joints, stains and pores."""
    canvas = blank(0.0)
    for i in range(2):
        for j in range(2):
            rectangle(
                canvas,
                256 * i,
                256 * j,
                right=256 * (i + 1),
                top=256 * (j + 1),
                value=rng.normal(scale=0.5),
            )

    # Joints, pores and cracks.
    for at in (0, 256):
        rectangle(canvas, 0, at - 2, right=SIDE, top=at + 2, value=-3.0)
        rectangle(canvas, at - 2, 0, right=at + 2, top=SIDE, value=-3.0)
    for _ in range(250):
        x, y = rng.uniform(0, SIDE, 2)
        radius_x, radius_y = rng.uniform(0.6, 2.2, 2)
        polygon(canvas, ellipse(x, y, radius_x, radius_y=radius_y), -rng.uniform(0.8, 2.5))
    for _ in range(3):
        stroke(canvas, random_walk(rng, 50, step=4.0, bend_rad=0.3), 1.0, value=-1.8)

    # Only the dark half of the noise stains.
    stains = np.minimum(noise(rng, 1.8, 2, high=40), 0.6)
    return downsampled(canvas) + 0.6 * stains + 0.35 * noise(rng, 0.3, 10) + 0.4 * noise(rng, 1.0)


def paving(rng: np.random.Generator) -> Tile:
    """Draw eight rows of slabs in running bond, each of its own grey, some cracked."""
    canvas = blank(-2.2)
    for row in range(8):
        for column in range(4):
            left = 128 * column + 64 * (row % 2)
            bottom = 64 * row
            shade = rng.normal(scale=0.8)
            rectangle(
                canvas,
                left + 1.5,
                bottom + 1.5,
                right=left + 126.5,
                top=bottom + 62.5,
                value=shade - 0.5,
            )
            rectangle(canvas, left + 3, bottom + 3, right=left + 125, top=bottom + 61, value=shade)
            if rng.random() < 0.2:
                kink = left + rng.uniform(30, 95, 3)
                crack = np.stack([kink, bottom + np.array([2.0, 30.0, 62.0])], axis=1)
                stroke(canvas, crack, 1.0, value=-2.0)
    for _ in range(60):
        x, y = rng.uniform(0, SIDE, 2)
        radius_x, radius_y = rng.uniform(1.5, 4, 2)
        polygon(canvas, ellipse(x, y, radius_x, radius_y=radius_y), rng.choice([-1.5, 1.2]))
    return downsampled(canvas) + 0.4 * noise(rng, 0.4, 8) + 0.45 * noise(rng, 1.3, 1, high=60)


def dirt(rng: np.random.Generator) -> Tile:
    """Draw soil at all scales, strewn with pebbles that are lit from the upper left."""
    soil = 0.6 * noise(rng, 1.1) + 0.5 * relief(noise(rng, 1.7, 2)) * 3 + 0.35 * noise(rng, 0.2, 40)
    canvas = upsampled(soil)
    radii = np.sort(1.2 * rng.pareto(1.8, 1000) + 1.0).clip(max=13)
    for radius in radii:
        x, y = rng.uniform(0, SIDE, 2)
        flat = rng.uniform(0.6, 1.0)
        angle = rng.uniform(0, np.pi)
        grey = rng.normal(0.3, 0.8)

        # Its shadow to the lower right, the pebble, and a highlight to the upper left.
        reach = 0.35 * radius
        polygon(
            canvas,
            ellipse(x + reach, y - reach, 1.1 * radius, radius_y=flat * radius, angle_rad=angle),
            -2.0,
        )
        polygon(canvas, _stone(rng, x, y, radius=radius, flat=flat, angle_rad=angle), grey)
        polygon(
            canvas,
            ellipse(
                x - reach,
                y + reach,
                0.5 * radius,
                radius_y=0.45 * flat * radius,
                angle_rad=angle,
                corners=12,
            ),
            grey + 1.0,
        )
    return downsampled(canvas) + 0.3 * noise(rng, 0.1, 30)


def _stone(
    rng: np.random.Generator, x: float, y: float, *, radius: float, flat: float, angle_rad: float
) -> FloatArray:
    """Return the outline of an angular pebble, [9, 2]."""
    outline = ellipse(x, y, radius, radius_y=flat * radius, angle_rad=angle_rad, corners=9) - (x, y)
    return (x, y) + outline * rng.uniform(0.8, 1.1, (9, 1))


def rock(rng: np.random.Generator) -> Tile:
    """Draw broken rock: facets and ledges lit from the upper left, with dark clefts between."""
    # Facets are the cells of random points (Worley noise), whose borders are warped.
    warp_x, warp_y = (np.rint(12 * noise(rng, 1.6, 3, high=80)).astype(np.int64) for _ in range(2))
    rows, columns = np.indices((SIDE, SIDE))
    facet = _nearest(rng.uniform(0, SIDE, (60, 2)))[
        (rows + warp_y) % SIDE, (columns + warp_x) % SIDE
    ]

    # Clefts along the borders, two texels wide.
    border: Tile = ((facet != np.roll(facet, 1, 0)) | (facet != np.roll(facet, 1, 1))).astype(
        np.float64
    )
    cleft: Tile = (
        border + np.roll(border, 1, 0) + np.roll(border, 1, 1) + np.roll(border, (1, 1), (0, 1))
    )
    shade: Tile = rng.normal(scale=0.8, size=60)[facet]
    return shade - 0.7 * cleft + 4 * relief(noise(rng, 1.7, 2)) + 0.4 * noise(rng, 1.0)


def _nearest(points: FloatArray) -> IntArray:
    """Return the index of the point, of [N, 2], nearest to each texel of the tile: [SIDE, SIDE]."""
    squares = ((np.arange(SIDE) - points[..., None] + SIDE / 2) % SIDE - SIDE / 2) ** 2
    nearest = np.zeros((SIDE, SIDE), dtype=np.int64)
    closest = np.full((SIDE, SIDE), np.inf)
    for index, (square_x, square_y) in enumerate(squares):
        square = square_x + square_y[:, None]
        nearest[square < closest] = index
        np.minimum(closest, square, out=closest)
    return nearest
