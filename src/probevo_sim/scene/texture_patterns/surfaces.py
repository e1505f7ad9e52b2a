"""Textures of surfaces: walls, roofs, fences, metal, cloth, signs, and abstract patterns."""

from __future__ import annotations

import numpy as np

from probevo_sim.scene.texture_patterns.canvas import (
    FINE,
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
)


def plain(rng: np.random.Generator) -> Tile:
    """Draw one grey, which no tracker can follow."""
    return np.zeros((SIDE, SIDE))


def checkerboard(rng: np.random.Generator) -> Tile:
    """Draw 8×8 squares of full contrast."""
    rows, columns = np.indices((SIDE, SIDE)) // (SIDE // 8)
    return ((rows + columns) % 2).astype(np.float64)


def clouds(rng: np.random.Generator) -> Tile:
    """Draw clouds, soft at every scale."""
    return noise(rng, 2.0)


def blotches(rng: np.random.Generator) -> Tile:
    """Draw weathering: large blotches without detail."""
    return noise(rng, 1.2, 1, high=10)


def brick(rng: np.random.Generator) -> Tile:
    """Draw 32 courses of bricks in running bond with bright mortar."""
    canvas = blank(1.3)
    for course in range(32):
        for column in range(8):
            left = 64 * column + 32 * (course % 2)
            bottom = 16 * course
            shade = rng.normal(-0.4, 0.75)
            rectangle(canvas, left + 1, bottom + 1, right=left + 63, top=bottom + 15, value=shade)
            rectangle(
                canvas, left + 1, bottom + 1, right=left + 63, top=bottom + 2, value=shade - 0.7
            )
    return downsampled(canvas) + 0.35 * noise(rng, 0.4, 8) + 0.4 * noise(rng, 1.5, 1, high=30)


def plaster(rng: np.random.Generator) -> Tile:
    """Draw plaster: stains, traces of rain and a few cracks on a fine grain."""
    canvas = blank(0.0)
    for _ in range(5):
        stroke(canvas, random_walk(rng, 40, step=4.0, bend_rad=0.35), 0.5, value=-2.5)
    runs = np.minimum(noise(rng, 1.2, 4, high=90, stretch=(1.0, 8.0)), 0.5)
    return (
        downsampled(canvas)
        + 0.7 * runs
        + 0.8 * noise(rng, 1.7, 1, high=30)
        + 0.4 * noise(rng, 0.1, 20)
    )


def roof(rng: np.random.Generator) -> Tile:
    """Draw 16 rows of round tiles, each of which casts a shadow on the row below."""
    canvas = blank(0.0)
    across = np.sin(np.pi * np.linspace(0, 1, FINE * 32))
    up = np.linspace(-0.3, 0.4, FINE * 32)[:, None]
    for row in range(16):
        for column in range(16):
            left = 32 * column + 16 * (row % 2)
            bottom = 32 * row
            rectangle(
                canvas,
                left,
                bottom,
                right=left + 32,
                top=bottom + 32,
                value=1.3 * across + up + rng.normal(-1.0, 0.45),
            )
            rectangle(canvas, left, bottom + 28, right=left + 32, top=bottom + 32, value=-2.2)
    return downsampled(canvas) + 0.3 * noise(rng, 0.5, 8) + 0.4 * noise(rng, 1.5, 1, high=30)


def fence(rng: np.random.Generator) -> Tile:
    """Draw 16 upright slats with gaps, rails behind them, and nails."""
    canvas = blank(-2.6)
    rails = (100, 356)
    for height in rails:
        rectangle(canvas, 0, height, right=SIDE, top=height + 36, value=-1.4)
    for slat in range(16):
        left = 32 * slat + 3
        shade = rng.normal(scale=0.7)
        rectangle(canvas, left, 0, right=left + 26, top=SIDE, value=shade)
        rectangle(canvas, left + 23, 0, right=left + 26, top=SIDE, value=shade - 0.8)
        for height in rails:
            for x in (left + 7, left + 18):
                polygon(
                    canvas,
                    ellipse(x, height + 18 + rng.uniform(-4, 4), 1.6, radius_y=1.6, corners=10),
                    -2.0,
                )
        for _ in range(rng.integers(0, 4)):
            polygon(
                canvas,
                ellipse(left + rng.uniform(6, 20), rng.uniform(0, SIDE), 2.5, radius_y=5),
                shade - 1.2,
            )
    wood = noise(rng, 0.8, 8, high=500, stretch=(1.0, 12.0))
    return downsampled(canvas) + 0.4 * wood + 0.3 * noise(rng, 1.4, 1, high=30)


def metal(rng: np.random.Generator) -> Tile:
    """Draw metal as of a guard rail: two waves along x, with joints, bolts and rust."""
    height = np.linspace(0, 4 * np.pi, SIDE, endpoint=False)[:, None]
    waves = 1.1 * np.sin(height) + 0.5 * np.sin(2 * height + 1)
    canvas = blank(0.0)
    # Joints, each with two rows of bolts.
    for joint in (0, 256):
        rectangle(canvas, joint + 12, 0, right=joint + 14, top=SIDE, value=-1.8)
        rectangle(canvas, joint + 14, 0, right=joint + 16, top=SIDE, value=1.0)
        for y in (32, 96, 288, 352):
            for x in (joint + 2, joint + 26):
                polygon(canvas, ellipse(x, y, 6, radius_y=9), -1.8)
                polygon(canvas, ellipse(x - 1, y + 1.5, 4.5, radius_y=7), 1.2)

    # Traces of rust that run down, and stains.
    for _ in range(14):
        x, y = rng.uniform(0, SIDE, 2)
        length = rng.uniform(10, 60)
        polygon(canvas, [(x - 2, y), (x + 2, y), (x + 0.5, y - length)], -1.0)
    for _ in range(12):
        x, y = rng.uniform(0, SIDE, 2)
        radius_x, radius_y = rng.uniform(3, 14, 2)
        polygon(canvas, ellipse(x, y, radius_x, radius_y=radius_y), rng.uniform(-0.7, 0.5))
    brushed = noise(rng, 0.5, 4, high=400, stretch=(10.0, 1.0))
    return waves + downsampled(canvas) + 0.3 * brushed + 0.35 * noise(rng, 1.4, 1, high=40)


def cloth(rng: np.random.Generator) -> Tile:
    """Draw hanging folds of cloth, lit from one side, on a fine weave."""
    folds = relief(noise(rng, 2.6, 4, high=30, stretch=(1.0, 3.5)))
    thread = np.sin(2 * np.pi * 128 / SIDE * np.arange(SIDE) + 0.5)
    weave = np.outer(thread, thread)
    lit: Tile = np.tanh(0.8 * folds / float(folds.std()))
    return lit + 0.1 * weave + 0.1 * noise(rng, 0.0, 40)


def sign(rng: np.random.Generator) -> Tile:
    """Draw a sign with an arrow, a disc and four lines of random letters."""
    canvas = blank(1.0)
    stroke(canvas, [(14, 14), (498, 14), (498, 498), (14, 498)], 10, value=0.0, closed=True)
    rectangle(canvas, 28, 300, right=484, top=484, value=0.05)
    arrow = [(60, 372), (150, 372), (150, 340), (220, 392), (150, 444), (150, 412), (60, 412)]
    polygon(canvas, arrow, 1.0)
    polygon(canvas, ellipse(340, 392, 70, radius_y=70, corners=48), 1.0)
    polygon(canvas, ellipse(340, 392, 52, radius_y=52, corners=48), 0.25)
    rectangle(canvas, 300, 380, right=380, top=404, value=1.0)

    # Lines of letters of decreasing size.
    for line, size in enumerate((52, 40, 28, 28)):
        bottom = (228, 164, 112, 64)[line]
        for letter in range(int(430 // (0.8 * size))):
            if rng.random() < 0.85:
                _letter(canvas, rng, 44 + 0.8 * size * letter, bottom=bottom, size=size)
    return downsampled(canvas) + 0.03 * noise(rng, 1.2)


def _letter(
    canvas: Tile, rng: np.random.Generator, left: float, bottom: float, size: float
) -> None:
    """Draw random strokes between the six nodes of a letter's cell, ``size`` texels high."""
    nodes = np.array([(x, y) for y in (0.0, 0.5, 1.0) for x in (0.0, 1.0)]) * (0.5 * size, size) + (
        left,
        bottom,
    )
    sides = [(0, 2), (2, 4), (1, 3), (3, 5), (0, 1), (2, 3), (4, 5), (0, 3), (2, 5)]
    for k in rng.choice(len(sides), 5, replace=False):
        stroke(canvas, nodes[list(sides[k])], 0.14 * size, value=0.0)
