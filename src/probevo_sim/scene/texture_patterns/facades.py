"""Facades; row 0 is the foot of the wall.

All windows differ, so that no facade repeats itself within a tile.
"""

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
    rectangle,
    stroke,
)
from probevo_sim.scene.texture_patterns.windows import (
    WindowStyle,
    any_pane,
    blinded,
    curtained,
    glass,
    window,
)


def facade_office(rng: np.random.Generator) -> Tile:
    """Draw four floors of four wide windows with reflections, between bands of cladding."""
    canvas = blank(0.62)
    for floor in range(4):
        foot = 128 * floor
        for column in range(4):
            # Two panels of cladding with a joint, and a window above.
            left = 128 * column
            rectangle(
                canvas,
                left,
                foot,
                right=left + 64,
                top=foot + 30,
                value=0.66 + rng.normal(scale=0.05),
            )
            rectangle(
                canvas,
                left + 64,
                foot,
                right=left + 128,
                top=foot + 30,
                value=0.66 + rng.normal(scale=0.05),
            )
            rectangle(canvas, left + 63.5, foot, right=left + 64.5, top=foot + 30, value=0.4)
            pane = blinded if rng.random() < 0.35 else glass
            window(
                canvas,
                rng,
                left + 7,
                bottom=foot + 36,
                right=left + 121,
                top=foot + 122,
                style=WindowStyle(pane=pane, frame=0.22, transom=0.75),
            )
        # The ledge above the cladding, and its shadow.
        rectangle(canvas, 0, foot + 30, right=SIDE, top=foot + 34, value=0.95)
        rectangle(canvas, 0, foot + 26, right=SIDE, top=foot + 30, value=0.3)

    # Pilasters between the windows, with shadows at their right.
    for column in range(4):
        left = 128 * column
        rectangle(canvas, left - 5, 0, right=left + 4, top=SIDE, value=0.82)
        rectangle(canvas, left + 4, 0, right=left + 6, top=SIDE, value=0.35)
    return downsampled(canvas) + 0.025 * noise(rng, 1.0)


def facade_flats(rng: np.random.Generator) -> Tile:
    """Draw four floors on which balconies alternate with curtained windows."""
    canvas = blank(0.68)
    for floor in range(4):
        foot = 128 * floor
        rectangle(canvas, 0, foot - 1, right=SIDE, top=foot + 1, value=0.5)
        for column in range(4):
            left = 128 * column
            if column % 2:
                window(
                    canvas,
                    rng,
                    left + 26,
                    bottom=foot + 42,
                    right=left + 102,
                    top=foot + 108,
                    style=WindowStyle(pane=curtained, transom=None),
                )
                # The sill, and its shadow.
                rectangle(canvas, left + 22, foot + 37, right=left + 106, top=foot + 42, value=0.9)
                rectangle(canvas, left + 24, foot + 33, right=left + 106, top=foot + 37, value=0.4)
            else:
                _balcony(canvas, rng, left, foot=foot)

    # Traces of rain run down the wall.
    runs = np.minimum(noise(rng, 1.2, 4, high=90, stretch=(1.0, 6.0)), 0.5)
    return downsampled(canvas) + 0.035 * runs + 0.025 * noise(rng, 0.6)


def _balcony(canvas: Tile, rng: np.random.Generator, left: float, foot: float) -> None:
    """Draw a shaded recess with a door and a window, behind a railing on a slab."""
    rectangle(canvas, left + 6, foot + 6, right=left + 122, top=foot + 120, value=0.36)
    window(
        canvas,
        rng,
        left + 14,
        bottom=foot + 8,
        right=left + 50,
        top=foot + 106,
        style=WindowStyle(pane=curtained, columns=1, transom=None),
    )
    window(
        canvas,
        rng,
        left + 58,
        bottom=foot + 42,
        right=left + 112,
        top=foot + 106,
        style=WindowStyle(pane=any_pane, transom=None),
    )
    # Plants, chairs and washing.
    for _ in range(rng.integers(1, 5)):
        x = left + rng.uniform(16, 104)
        size = rng.uniform(5, 14)
        rectangle(
            canvas,
            x - 0.6 * size,
            foot + 8,
            right=x + 0.6 * size,
            top=foot + 22 + 2 * size,
            value=rng.choice([0.12, 0.5, 0.85]),
        )
    # A solid parapet or a railing of bars.
    if rng.random() < 0.4:
        rectangle(
            canvas, left + 6, foot + 8, right=left + 122, top=foot + 46, value=rng.uniform(0.5, 0.9)
        )
    else:
        for x in np.arange(left + 8, left + 121, 6):
            rectangle(canvas, x, foot + 8, right=x + 1.5, top=foot + 46, value=0.12)
    # The handrail, the slab, and its shadow.
    rectangle(canvas, left + 2, foot + 46, right=left + 126, top=foot + 50, value=0.15)
    rectangle(canvas, left + 2, foot, right=left + 126, top=foot + 9, value=0.9)
    rectangle(canvas, left + 2, foot - 5, right=left + 126, top=foot, value=0.3)


def facade_old(rng: np.random.Generator) -> Tile:
    """Draw three floors of coursed stone with arched windows, and ledges between the floors."""
    canvas = blank(0.0)
    # Courses of stones with joints.
    for course in range(32):
        for block in range(8):
            left = 64 * block + 32 * (course % 2)
            bottom = 16 * course
            rectangle(canvas, left, bottom, right=left + 64, top=bottom + 16, value=0.45)
            rectangle(
                canvas,
                left + 0.5,
                bottom + 0.5,
                right=left + 63.5,
                top=bottom + 15.5,
                value=0.6 + rng.normal(scale=0.05),
            )

    # Windows, and a ledge with dentils below each floor.
    for floor in range(3):
        foot = SIDE * floor / 3
        for column in range(4):
            _arched_window(canvas, rng, 128 * column + 64, sill=foot + 38, floor=floor)
        rectangle(canvas, 0, foot + 4, right=SIDE, top=foot + 16, value=0.8)
        rectangle(canvas, 0, foot + 12, right=SIDE, top=foot + 16, value=0.98)
        rectangle(canvas, 0, foot - 3, right=SIDE, top=foot + 4, value=0.3)
        for x in range(0, SIDE, 16):
            rectangle(canvas, x, foot - 3, right=x + 8, top=foot + 4, value=0.62)
    grime = np.minimum(noise(rng, 1.3, 3, high=90, stretch=(1.0, 4.0)), 0.5)
    return downsampled(canvas) + 0.05 * grime + 0.04 * noise(rng, 0.6)


def _arched_window(
    canvas: Tile, rng: np.random.Generator, middle: float, sill: float, floor: int
) -> None:
    """Draw a tall window under an arch or, on the middle floor, under a pediment."""
    half = 28.0
    spring = sill + 76
    # The sill, and its shadow.
    rectangle(canvas, middle - half - 9, sill - 8, right=middle + half + 9, top=sill, value=0.92)
    rectangle(
        canvas, middle - half - 9, sill - 13, right=middle + half + 9, top=sill - 8, value=0.3
    )

    # Under a pediment.
    if floor == 1:
        top = spring + 22
        rectangle(canvas, middle - half - 6, sill, right=middle + half + 6, top=top + 6, value=0.85)
        window(
            canvas,
            rng,
            middle - half,
            bottom=sill,
            right=middle + half,
            top=top,
            style=WindowStyle(pane=any_pane, frame=0.75),
        )
        gable = [(middle - half - 10, top + 6), (middle + half + 10, top + 6), (middle, top + 24)]
        polygon(canvas, gable, 0.88)
        stroke(canvas, gable, 1.5, value=0.35, closed=True)
        return

    # Under an arch.
    polygon(canvas, ellipse(middle, spring, half + 6, radius_y=half + 6, corners=48), 0.85)
    rectangle(canvas, middle - half - 6, sill, right=middle + half + 6, top=spring, value=0.85)
    top = spring + half
    rows = slice(round(FINE * spring), round(FINE * top))
    columns = slice(round(FINE * (middle - half)), round(FINE * (middle + half)))
    # A rectangular window, outside of whose arch the wall is put back.
    wall = canvas[rows, columns].copy()
    window(
        canvas,
        rng,
        middle - half,
        bottom=sill,
        right=middle + half,
        top=top,
        style=WindowStyle(pane=any_pane, frame=0.75, transom=0.72),
    )
    up = np.linspace(0, 1, wall.shape[0])[:, None]
    across = np.linspace(-1, 1, wall.shape[1])
    canvas[rows, columns] = np.where(up**2 + across**2 > 1, wall, canvas[rows, columns])
    stroke(canvas, ellipse(middle, spring, half, radius_y=half, corners=48)[:25], 2, value=0.3)
    keystone = [
        (middle - 5, top - 2),
        (middle + 5, top - 2),
        (middle + 8, top + 12),
        (middle - 8, top + 12),
    ]
    polygon(canvas, keystone, 0.95)


def facade_house(rng: np.random.Generator) -> Tile:
    """Draw the front of a house of two floors, with shuttered windows and a door."""
    # Plinth, eaves and the ledge between the floors.
    canvas = blank(0.72)
    rectangle(canvas, 0, 0, right=SIDE, top=44, value=0.42)
    rectangle(canvas, 0, 44, right=SIDE, top=48, value=0.88)
    rectangle(canvas, 0, 498, right=SIDE, top=SIDE, value=0.42)
    rectangle(canvas, 0, 490, right=SIDE, top=498, value=0.92)
    rectangle(canvas, 0, 268, right=SIDE, top=274, value=0.86)
    rectangle(canvas, 0, 264, right=SIDE, top=268, value=0.45)

    # Windows, three above and two below.
    for middle in (86, 256, 426):
        _shuttered_window(canvas, rng, middle, sill=330, shut=rng.random() < 0.2)
        if middle != 256:
            _shuttered_window(canvas, rng, middle, sill=96, shut=rng.random() < 0.2)

    # The door: steps, frame, leaf with panels, a fanlight and a canopy.
    rectangle(canvas, 200, 0, right=312, top=14, value=0.8)
    rectangle(canvas, 208, 14, right=304, top=28, value=0.7)
    rectangle(canvas, 212, 28, right=300, top=232, value=0.92)
    rectangle(canvas, 222, 28, right=290, top=222, value=0.22)
    for bottom in (40, 108):
        rectangle(canvas, 230, bottom, right=252, top=bottom + 56, value=0.32)
        rectangle(canvas, 260, bottom, right=282, top=bottom + 56, value=0.32)
    window(
        canvas,
        rng,
        228,
        bottom=176,
        right=284,
        top=216,
        style=WindowStyle(pane=glass, frame=0.35, transom=None),
    )
    polygon(canvas, ellipse(283, 118, 3, radius_y=3), 0.95)
    rectangle(canvas, 204, 232, right=308, top=240, value=0.5)

    # The downpipe.
    rectangle(canvas, 486, 0, right=496, top=SIDE, value=0.35)
    rectangle(canvas, 488, 0, right=491, top=SIDE, value=0.75)

    # Traces of rain run down the wall.
    runs = np.minimum(noise(rng, 1.2, 4, high=90, stretch=(1.0, 6.0)), 0.4)
    return downsampled(canvas) + 0.05 * runs + 0.035 * noise(rng, 0.5) + 0.03 * noise(rng, 1.5)


def _shuttered_window(
    canvas: Tile, rng: np.random.Generator, middle: float, sill: float, *, shut: bool
) -> None:
    """Draw a window with a sill and two louvred shutters, open beside it or shut before it."""
    rectangle(canvas, middle - 34, sill - 4, right=middle + 34, top=sill + 124, value=0.9)
    window(
        canvas,
        rng,
        middle - 30,
        bottom=sill,
        right=middle + 30,
        top=sill + 120,
        style=WindowStyle(pane=curtained),
    )
    grey = rng.uniform(0.25, 0.45)
    louvres = grey - 0.14 * (np.arange(FINE * 112) % 12 < 4)[:, None]
    for side in (-1, 1):
        left = middle + side * (15 if shut else 50) - 15
        rectangle(canvas, left, sill, right=left + 30, top=sill + 120, value=grey + 0.06)
        rectangle(canvas, left + 4, sill + 4, right=left + 26, top=sill + 116, value=louvres)
    rectangle(canvas, middle - 40, sill - 8, right=middle + 40, top=sill, value=0.95)
    rectangle(canvas, middle - 38, sill - 13, right=middle + 40, top=sill - 8, value=0.4)
