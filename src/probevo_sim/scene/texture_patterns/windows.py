"""Windows: what glass mirrors, what hangs behind it, the frame around it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from probevo_sim.scene.texture_patterns.canvas import FINE, Tile, box

Pane = Callable[[np.random.Generator, int, int], Tile]


def glass(rng: np.random.Generator, height: int, width: int) -> Tile:
    """A dark room that mirrors the sky above a skyline of its own: [height, width] canvas pixels."""
    up = np.linspace(0, 1, height)[:, None]
    across = np.linspace(0, 1, width)
    skyline = rng.uniform(-0.1, 0.9) + rng.uniform(-0.5, 0.5) * across
    skyline += rng.uniform(-0.4, 0.4) * (across > rng.uniform(0.2, 0.8))
    room = rng.uniform(0.05, 0.22)
    sky = rng.uniform(0.3, 0.75)
    mirrored = np.clip(12 * (up - skyline), 0, 1)
    pane = room + (sky - room) * mirrored * (0.75 + 0.25 * up) + 0.08 * across
    return pane


def curtained(rng: np.random.Generator, height: int, width: int) -> Tile:
    """Glass before two curtains in folds, drawn together by chance."""
    pane = glass(rng, height, width)
    across = np.linspace(0, 1, width)
    cloth = rng.uniform(0.45, 0.9) + 0.1 * np.sin(across * rng.uniform(40, 70) + rng.uniform(0, 6))
    left = rng.uniform(0.0, 0.5)
    right = rng.uniform(0.5, 1.0)
    drawn = (across < left) | (across > right)
    pane[:, drawn] = 0.25 * pane[:, drawn] + 0.75 * cloth[drawn]
    return pane


def blinded(rng: np.random.Generator, height: int, width: int) -> Tile:
    """Glass behind a slatted blind that is let down by chance."""
    pane = glass(rng, height, width)
    slats = rng.uniform(0.5, 0.8) - 0.2 * (np.arange(height) % 10 < 3)
    down = np.arange(height) > rng.uniform(0.0, 0.9) * height
    pane[down] = slats[down, None]
    return pane


def any_pane(rng: np.random.Generator, height: int, width: int) -> Tile:
    """Bare, curtained or blinded."""
    kinds: list[Pane] = [glass, curtained, blinded]
    return kinds[rng.choice(3, p=[0.35, 0.4, 0.25])](rng, height, width)


def window(
    canvas: Tile,
    rng: np.random.Generator,
    left: float,
    bottom: float,
    right: float,
    top: float,
    *,
    pane: Pane = any_pane,
    frame: float = 0.9,
    frame_width: float = 3.0,
    columns: int = 2,
    transom: float | None = 0.7,
) -> None:
    """Draw a window into a rectangle, in texels.

    Args:
        canvas: where to draw.
        rng: source of what differs from window to window.
        left: edge of the frame.
        bottom: edge of the frame.
        right: edge of the frame.
        top: edge of the frame.
        pane: draws glass and what is behind it.
        frame: grey of frame and bars.
        frame_width: texels; bars are two thirds of that.
        columns: casements beside each other.
        transom: where a cross bar lies, as a part of the height; None for none.
    """
    box(canvas, left, bottom, right=right, top=top, value=frame)
    left = left + frame_width
    bottom = bottom + frame_width
    right = right - frame_width
    top = top - frame_width
    height = round(FINE * top) - round(FINE * bottom)
    width = round(FINE * right) - round(FINE * left)
    box(canvas, left, bottom, right=right, top=top, value=pane(rng, height, width))
    box(canvas, left, top - 3, right=right, top=top, value=0.08)  # the lintel's shadow
    bar = frame_width / 3
    for column in range(1, columns):
        x = left + (right - left) * column / columns
        box(canvas, x - bar, bottom, right=x + bar, top=top, value=frame)
    if transom is not None:
        y = bottom + (top - bottom) * transom
        box(canvas, left, y - bar, right=right, top=y + bar, value=frame)
