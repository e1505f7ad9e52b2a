"""House fronts; row 0 is the foot of the wall. Windows differ, so that no facade repeats itself within a tile."""

from __future__ import annotations

import numpy as np

from probevo.simulation.scene.texture_patterns.canvas import (
    FINE,
    SIDE,
    Tile,
    blank,
    box,
    noise,
    oval,
    polygon,
    reduced,
    stroke,
)
from probevo.simulation.scene.texture_patterns.windows import any_pane, blinded, curtained, glass, window


def facade_office(rng: np.random.Generator) -> Tile:
    """Four floors of four wide windows that mirror the surroundings, between bands of cladding."""
    canvas = blank(0.62)
    for floor in range(4):
        foot = 128 * floor
        for column in range(4):
            left = 128 * column
            box(canvas, left, foot, left + 64, foot + 30, 0.66 + rng.normal(scale=0.05))
            box(canvas, left + 64, foot, left + 128, foot + 30, 0.66 + rng.normal(scale=0.05))
            box(canvas, left + 63.5, foot, left + 64.5, foot + 30, 0.4)
            pane = blinded if rng.random() < 0.35 else glass
            window(canvas, rng, left + 7, foot + 36, left + 121, foot + 122, pane=pane, frame=0.22, transom=0.75)
        box(canvas, 0, foot + 30, SIDE, foot + 34, 0.95)
        box(canvas, 0, foot + 26, SIDE, foot + 30, 0.3)
    for column in range(4):
        left = 128 * column
        box(canvas, left - 5, 0, left + 4, SIDE, 0.82)
        box(canvas, left + 4, 0, left + 6, SIDE, 0.35)
    return reduced(canvas) + 0.025 * noise(rng, 1.0)


def facade_flats(rng: np.random.Generator) -> Tile:
    """Four floors; balconies with what people keep on them alternate with curtained windows."""
    canvas = blank(0.68)
    for floor in range(4):
        foot = 128 * floor
        box(canvas, 0, foot - 1, SIDE, foot + 1, 0.5)
        for column in range(4):
            left = 128 * column
            if column % 2:
                window(canvas, rng, left + 26, foot + 42, left + 102, foot + 108, pane=curtained, transom=None)
                box(canvas, left + 22, foot + 37, left + 106, foot + 42, 0.9)
                box(canvas, left + 24, foot + 33, left + 106, foot + 37, 0.4)
            else:
                _balcony(canvas, rng, left, foot)
    runs = np.minimum(noise(rng, 1.2, 4, 90, stretch=(1.0, 6.0)), 0.5)
    return reduced(canvas) + 0.035 * runs + 0.025 * noise(rng, 0.6)


def _balcony(canvas: Tile, rng: np.random.Generator, left: float, foot: float) -> None:
    """A recess in shade with a door and a window, behind a railing on a slab."""
    box(canvas, left + 6, foot + 6, left + 122, foot + 120, 0.36)
    window(canvas, rng, left + 14, foot + 8, left + 50, foot + 106, pane=curtained, columns=1, transom=None)
    window(canvas, rng, left + 58, foot + 42, left + 112, foot + 106, pane=any_pane, transom=None)
    for _ in range(rng.integers(1, 5)):  # plants, chairs, washing
        x, size = left + rng.uniform(16, 104), rng.uniform(5, 14)
        box(canvas, x - 0.6 * size, foot + 8, x + 0.6 * size, foot + 22 + 2 * size, rng.choice([0.12, 0.5, 0.85]))
    if rng.random() < 0.4:
        box(canvas, left + 6, foot + 8, left + 122, foot + 46, rng.uniform(0.5, 0.9))
    else:
        for x in np.arange(left + 8, left + 121, 6):
            box(canvas, x, foot + 8, x + 1.5, foot + 46, 0.12)
    box(canvas, left + 2, foot + 46, left + 126, foot + 50, 0.15)
    box(canvas, left + 2, foot, left + 126, foot + 9, 0.9)
    box(canvas, left + 2, foot - 5, left + 126, foot, 0.3)


def facade_old(rng: np.random.Generator) -> Tile:
    """Three floors of coursed stone: arched windows in moulded frames, ledges between the floors."""
    canvas = blank(0.0)
    for course in range(32):
        for block in range(8):
            left, bottom = 64 * block + 32 * (course % 2), 16 * course
            box(canvas, left, bottom, left + 64, bottom + 16, 0.45)
            box(canvas, left + 0.5, bottom + 0.5, left + 63.5, bottom + 15.5, 0.6 + rng.normal(scale=0.05))
    for floor in range(3):
        foot = SIDE * floor / 3
        for column in range(4):
            _arched_window(canvas, rng, 128 * column + 64, foot + 38, floor)
        box(canvas, 0, foot + 4, SIDE, foot + 16, 0.8)
        box(canvas, 0, foot + 12, SIDE, foot + 16, 0.98)
        box(canvas, 0, foot - 3, SIDE, foot + 4, 0.3)
        for x in range(0, SIDE, 16):
            box(canvas, x, foot - 3, x + 8, foot + 4, 0.62)
    grime = np.minimum(noise(rng, 1.3, 3, 90, stretch=(1.0, 4.0)), 0.5)
    return reduced(canvas) + 0.05 * grime + 0.04 * noise(rng, 0.6)


def _arched_window(canvas: Tile, rng: np.random.Generator, middle: float, sill: float, floor: int) -> None:
    """A tall window under an arch or, on the middle floor, a pediment."""
    half, spring = 28.0, sill + 76
    box(canvas, middle - half - 9, sill - 8, middle + half + 9, sill, 0.92)
    box(canvas, middle - half - 9, sill - 13, middle + half + 9, sill - 8, 0.3)
    if floor == 1:
        top = spring + 22
        box(canvas, middle - half - 6, sill, middle + half + 6, top + 6, 0.85)
        window(canvas, rng, middle - half, sill, middle + half, top, pane=any_pane, frame=0.75)
        gable = [(middle - half - 10, top + 6), (middle + half + 10, top + 6), (middle, top + 24)]
        polygon(canvas, gable, 0.88)
        stroke(canvas, gable, 1.5, 0.35, closed=True)
        return
    polygon(canvas, oval(middle, spring, half + 6, half + 6, corners=48), 0.85)
    box(canvas, middle - half - 6, sill, middle + half + 6, spring, 0.85)
    top = spring + half
    rows = slice(round(FINE * spring), round(FINE * top))
    columns = slice(round(FINE * (middle - half)), round(FINE * (middle + half)))
    wall = canvas[rows, columns].copy()
    window(canvas, rng, middle - half, sill, middle + half, top, pane=any_pane, frame=0.75, transom=0.72)
    up, across = np.linspace(0, 1, wall.shape[0])[:, None], np.linspace(-1, 1, wall.shape[1])
    canvas[rows, columns] = np.where(up**2 + across**2 > 1, wall, canvas[rows, columns])
    stroke(canvas, oval(middle, spring, half, half, corners=48)[:25], 2, 0.3)
    keystone = [(middle - 5, top - 2), (middle + 5, top - 2), (middle + 8, top + 12), (middle - 8, top + 12)]
    polygon(canvas, keystone, 0.95)


def facade_house(rng: np.random.Generator) -> Tile:
    """A house front of two floors: shuttered windows, a door with steps, a plinth, eaves."""
    canvas = blank(0.72)
    box(canvas, 0, 0, SIDE, 44, 0.42)
    box(canvas, 0, 44, SIDE, 48, 0.88)
    box(canvas, 0, 498, SIDE, SIDE, 0.42)
    box(canvas, 0, 490, SIDE, 498, 0.92)
    box(canvas, 0, 268, SIDE, 274, 0.86)
    box(canvas, 0, 264, SIDE, 268, 0.45)
    for middle in (86, 256, 426):
        _shuttered_window(canvas, rng, middle, 330, shut=rng.random() < 0.2)
        if middle != 256:
            _shuttered_window(canvas, rng, middle, 96, shut=rng.random() < 0.2)
    box(canvas, 200, 0, 312, 14, 0.8)
    box(canvas, 208, 14, 304, 28, 0.7)
    box(canvas, 212, 28, 300, 232, 0.92)
    box(canvas, 222, 28, 290, 222, 0.22)
    for bottom in (40, 108):
        box(canvas, 230, bottom, 252, bottom + 56, 0.32)
        box(canvas, 260, bottom, 282, bottom + 56, 0.32)
    window(canvas, rng, 228, 176, 284, 216, pane=glass, frame=0.35, transom=None)
    polygon(canvas, oval(283, 118, 3, 3), 0.95)
    box(canvas, 204, 232, 308, 240, 0.5)
    box(canvas, 486, 0, 496, SIDE, 0.35)  # the downpipe
    box(canvas, 488, 0, 491, SIDE, 0.75)
    runs = np.minimum(noise(rng, 1.2, 4, 90, stretch=(1.0, 6.0)), 0.4)
    return reduced(canvas) + 0.05 * runs + 0.035 * noise(rng, 0.5) + 0.03 * noise(rng, 1.5)


def _shuttered_window(canvas: Tile, rng: np.random.Generator, middle: float, sill: float, *, shut: bool) -> None:
    """A window with a sill and two louvred shutters, open beside it or shut before it."""
    box(canvas, middle - 34, sill - 4, middle + 34, sill + 124, 0.9)
    window(canvas, rng, middle - 30, sill, middle + 30, sill + 120, pane=curtained)
    grey = rng.uniform(0.25, 0.45)
    louvres = grey - 0.14 * (np.arange(FINE * 112) % 12 < 4)[:, None]
    for side in (-1, 1):
        left = middle + side * (15 if shut else 50) - 15
        box(canvas, left, sill, left + 30, sill + 120, grey + 0.06)
        box(canvas, left + 4, sill + 4, left + 26, sill + 116, louvres)
    box(canvas, middle - 40, sill - 8, middle + 40, sill, 0.95)
    box(canvas, middle - 38, sill - 13, middle + 40, sill - 8, 0.4)
