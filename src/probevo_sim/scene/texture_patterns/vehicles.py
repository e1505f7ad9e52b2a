"""The views of a car, each of which fills a tile.

x points along the car, or to its left in the front view; y points up, or to the left from above.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from probevo.arrays import FloatArray
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

LENGTH_M = 4.3
"""Length of the car whose side fills a tile; so the width and the height."""
WIDTH_M = 1.75
HEIGHT_M = 1.45
RIM_GREY = 0.2
"""Grey along the edge of the tile."""

Points = Sequence[tuple[float, float]]


def car_side(rng: np.random.Generator) -> Tile:
    """Draw the side: wheels, doors, windows and lamps; the car's front is at the right."""
    canvas, at, wide, high = _body(LENGTH_M, HEIGHT_M)
    rectangle(canvas, 0, 0, right=SIDE, top=high * 0.2, value=0.08)
    rectangle(canvas, 0, high * 0.2, right=SIDE, top=high * 0.3, value=0.3)

    # Windows, their frame and pillars.
    cabin = [(0.35, 0.93), (0.62, 1.36), (2.45, 1.38), (3.3, 0.93)]
    polygon(canvas, at(cabin), 0.15)
    reflection = at([(0.95, 0.93), (1.3, 1.37), (1.75, 1.38), (1.4, 0.93)])
    polygon(canvas, reflection, 0.42)
    polygon(canvas, at([(2.2, 0.93), (2.2, 1.1), (2.75, 1.15), (3.0, 0.93)]), 0.3)
    stroke(canvas, at(cabin), 3, value=0.8, closed=True)
    for x, lean in ((0.95, 0.1), (1.95, 0.03)):
        stroke(canvas, at([(x, 0.93), (x + lean, 1.37)]), 6, value=0.5)

    # Gaps of the doors, handles, trim, mirror and lamps.
    for x in (0.98, 1.95, 3.0):
        stroke(canvas, at([(x, 0.3), (x, 0.93)]), 1.5, value=0.18)
    for x in (1.08, 2.05):
        rectangle(canvas, wide * x, high * 0.8, right=wide * (x + 0.2), top=high * 0.84, value=0.2)
    stroke(canvas, at([(0.1, 0.74), (4.2, 0.7)]), 1.5, value=0.3)
    polygon(canvas, at([(2.85, 0.95), (3.1, 0.95), (3.08, 1.07), (2.88, 1.07)]), 0.45)
    polygon(canvas, at([(4.25, 0.6), (3.9, 0.64), (4.0, 0.75), (4.25, 0.74)]), 0.98)
    polygon(canvas, at([(0.05, 0.62), (0.3, 0.66), (0.27, 0.88), (0.05, 0.88)]), 0.28)

    # Wheel arches, tyres and rims.
    for x in (0.8, 3.45):
        polygon(
            canvas,
            ellipse(wide * x, high * 0.36, wide * 0.37, radius_y=high * 0.34, corners=48),
            0.04,
        )
        polygon(
            canvas,
            ellipse(wide * x, high * 0.33, wide * 0.31, radius_y=high * 0.31, corners=48),
            0.16,
        )
        polygon(
            canvas,
            ellipse(wide * x, high * 0.33, wide * 0.21, radius_y=high * 0.21, corners=48),
            0.85,
        )
        for turn in np.arange(5) * 2 * np.pi / 5 + 0.3:
            hole = (x + 0.14 * np.cos(turn), 0.33 + 0.14 * np.sin(turn))
            polygon(
                canvas,
                ellipse(wide * hole[0], high * hole[1], wide * 0.045, radius_y=high * 0.045),
                0.15,
            )
    return _framed(canvas, rng)


def car_front(rng: np.random.Generator) -> Tile:
    """Draw the front: lamps, grille, plate and windscreen."""
    canvas, at, wide, high = _body(WIDTH_M, HEIGHT_M)
    rectangle(canvas, 0, 0, right=SIDE, top=high * 0.18, value=0.07)
    rectangle(canvas, wide * 0.05, 0, right=wide * 0.25, top=high * 0.3, value=0.1)
    rectangle(canvas, wide * 1.5, 0, right=wide * 1.7, top=high * 0.3, value=0.1)
    rectangle(canvas, wide * 0.3, high * 0.22, right=wide * 1.45, top=high * 0.34, value=0.2)

    # Grille and lamps.
    polygon(canvas, at([(0.5, 0.52), (1.25, 0.52), (1.32, 0.68), (0.43, 0.68)]), 0.1)
    for y in (0.56, 0.6, 0.64):
        rectangle(
            canvas, wide * 0.5, high * y, right=wide * 1.25, top=high * (y + 0.012), value=0.6
        )
    polygon(canvas, ellipse(wide * 0.875, high * 0.62, wide * 0.06, radius_y=high * 0.06), 0.95)
    for middle, outer in ((0.22, 0.06), (1.53, 1.69)):
        inner = 2 * middle - outer
        polygon(canvas, at([(outer, 0.6), (inner, 0.56), (inner, 0.67), (outer, 0.74)]), 0.3)
        polygon(canvas, ellipse(wide * middle, high * 0.64, wide * 0.1, radius_y=high * 0.055), 1.0)
        polygon(canvas, ellipse(wide * middle, high * 0.4, wide * 0.05, radius_y=high * 0.04), 0.9)

    # The number plate.
    rectangle(canvas, wide * 0.6, high * 0.38, right=wide * 1.15, top=high * 0.5, value=0.1)
    rectangle(canvas, wide * 0.61, high * 0.39, right=wide * 1.14, top=high * 0.49, value=1.0)
    for k in range(7):
        if k != 3:
            x = wide * (0.64 + 0.07 * k)
            rectangle(
                canvas,
                x,
                high * 0.41,
                right=x + wide * 0.045,
                top=high * 0.47,
                value=rng.choice([0.05, 0.2]),
            )
            rectangle(
                canvas,
                x + wide * 0.015,
                high * 0.43,
                right=x + wide * 0.03,
                top=high * rng.uniform(0.44, 0.455),
                value=0.9,
            )

    # Windscreen, head rests and mirrors.
    screen = [(0.2, 0.93), (0.4, 1.36), (1.35, 1.36), (1.55, 0.93)]
    polygon(canvas, at(screen), 0.14)
    polygon(canvas, at([(0.85, 0.93), (1.05, 1.36), (1.35, 1.36), (1.3, 0.93)]), 0.38)
    for x in (0.62, 1.13):
        polygon(canvas, ellipse(wide * x, high * 1.12, wide * 0.1, radius_y=high * 0.1), 0.07)
    stroke(canvas, at(screen), 4, value=0.25, closed=True)
    for x in (0.1, 1.65):
        polygon(canvas, ellipse(wide * x, high * 0.98, wide * 0.08, radius_y=high * 0.06), 0.25)
    stroke(canvas, at([(0.3, 0.75), (0.35, 0.9)]), 2, value=0.35)
    stroke(canvas, at([(1.45, 0.75), (1.4, 0.9)]), 2, value=0.35)
    return _framed(canvas, rng)


def car_top(rng: np.random.Generator) -> Tile:
    """Draw the car from above: bonnet at the right, windscreen, roof with a hatch, rear window."""
    canvas, at, wide, high = _body(LENGTH_M, WIDTH_M, evenly=True)
    polygon(canvas, at([(2.45, 0.25), (3.2, 0.12), (3.3, 0.875), (3.2, 1.63), (2.45, 1.5)]), 0.13)
    reflection = at([(2.6, 0.9), (3.2, 0.8), (3.25, 1.2), (2.6, 1.3)])
    polygon(canvas, reflection, 0.4)
    polygon(canvas, at([(0.7, 0.28), (0.3, 0.2), (0.3, 1.55), (0.7, 1.47)]), 0.13)
    polygon(canvas, at([(0.68, 0.5), (0.34, 0.42), (0.34, 0.8), (0.68, 0.85)]), 0.35)

    # Rails and hatch of the roof.
    for rail in (0.14, 1.55):
        rectangle(
            canvas, wide * 0.8, high * rail, right=wide * 2.4, top=high * (rail + 0.06), value=0.2
        )
        rectangle(
            canvas,
            wide * 0.8,
            high * (rail + 0.02),
            right=wide * 2.4,
            top=high * (rail + 0.035),
            value=0.95,
        )
    rectangle(canvas, wide * 1.4, high * 0.5, right=wide * 2.1, top=high * 1.25, value=0.25)
    rectangle(canvas, wide * 1.42, high * 0.52, right=wide * 2.08, top=high * 1.23, value=0.42)

    # Edges of the bonnet.
    for y in (0.35, 1.4):
        stroke(canvas, at([(3.32, y), (4.1, 0.875 + 0.75 * (y - 0.875))]), 2, value=0.35)
    stroke(canvas, at([(4.12, 0.2), (4.2, 0.875), (4.12, 1.55)]), 4, value=0.2)
    stroke(canvas, at([(3.36, 0.3), (3.46, 0.875), (3.36, 1.45)]), 2, value=0.3)
    return _framed(canvas, rng)


def _body(
    width_m: float, height_m: float, *, evenly: bool = False
) -> tuple[Tile, Callable[[Points], FloatArray], float, float]:
    """Return a canvas of painted metal, and its scale.

    Args:
        width_m: width of the view that fills the canvas.
        height_m: height of that view.
        evenly: whether the metal is lit evenly; else it is darker below.

    Returns:
        the canvas, a function from points in m to points in texels, and the texels per m along x
        and y.
    """
    lit = [0.7, 0.78, 0.82, 0.78, 0.7] if evenly else [0.45, 0.62, 0.85, 0.72, 0.8]
    canvas = blank(0.0)
    canvas += np.interp(np.linspace(0, 1, FINE * SIDE), [0, 0.45, 0.6, 0.64, 1], lit)[:, None]
    scale = SIDE / np.array([width_m, height_m])
    return canvas, lambda points: np.asarray(points) * scale, float(scale[0]), float(scale[1])


def _framed(canvas: Tile, rng: np.random.Generator) -> Tile:
    """Return the tile with edges of one grey, so that it wraps around, and a little dirt."""
    stroke(canvas, [(0, 0), (0, SIDE), (SIDE, SIDE), (SIDE, 0)], 8, value=RIM_GREY, closed=True)
    return downsampled(canvas) + 0.03 * noise(rng, 1.0)
