"""Windows: glass with reflections, curtains and blinds behind it, the frame around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from probevo_sim.scene.texture_patterns.canvas import FINE, Tile, rectangle

FRAME_WIDTH = 3.0
"""Width of a window's frame, texels; its bars are two thirds of that."""

Pane = Callable[[np.random.Generator, int, int], Tile]
"""A function that draws a pane of [height, width] canvas pixels."""


def glass(rng: np.random.Generator, height: int, width: int) -> Tile:
    """Draw the glass before a dark room, which reflects the sky above a random skyline."""
    up = np.linspace(0, 1, height)[:, None]
    across = np.linspace(0, 1, width)
    skyline = rng.uniform(-0.1, 0.9) + rng.uniform(-0.5, 0.5) * across
    skyline += rng.uniform(-0.4, 0.4) * (across > rng.uniform(0.2, 0.8))
    room = rng.uniform(0.05, 0.22)
    sky = rng.uniform(0.3, 0.75)
    reflection = np.clip(12 * (up - skyline), 0, 1)
    pane = room + (sky - room) * reflection * (0.75 + 0.25 * up) + 0.08 * across
    return pane


def curtained(rng: np.random.Generator, height: int, width: int) -> Tile:
    """Draw glass before two curtains in folds, each drawn to a random width."""
    pane = glass(rng, height, width)
    across = np.linspace(0, 1, width)
    cloth = rng.uniform(0.45, 0.9) + 0.1 * np.sin(across * rng.uniform(40, 70) + rng.uniform(0, 6))
    left = rng.uniform(0.0, 0.5)
    right = rng.uniform(0.5, 1.0)
    is_covered = (across < left) | (across > right)
    pane[:, is_covered] = 0.25 * pane[:, is_covered] + 0.75 * cloth[is_covered]
    return pane


def blinded(rng: np.random.Generator, height: int, width: int) -> Tile:
    """Draw glass before a slatted blind, lowered to a random height."""
    pane = glass(rng, height, width)
    slats = rng.uniform(0.5, 0.8) - 0.2 * (np.arange(height) % 10 < 3)
    down = np.arange(height) > rng.uniform(0.0, 0.9) * height
    pane[down] = slats[down, None]
    return pane


def any_pane(rng: np.random.Generator, height: int, width: int) -> Tile:
    """Draw a pane that is bare, curtained or blinded."""
    kinds: list[Pane] = [glass, curtained, blinded]
    return kinds[rng.choice(3, p=[0.35, 0.4, 0.25])](rng, height, width)


@dataclass(frozen=True)
class WindowStyle:
    """The parts that windows differ in."""

    pane: Pane = any_pane
    """Draws the glass and what is behind it."""
    frame: float = 0.9
    """Grey of the frame and its bars."""
    columns: int = 2
    """Casements side by side."""
    transom: float | None = 0.7
    """Place of a cross bar, as a share of the height; None for none."""


def window(
    canvas: Tile,
    rng: np.random.Generator,
    left: float,
    *,
    bottom: float,
    right: float,
    top: float,
    style: WindowStyle,
) -> None:
    """Draw a window into a rectangle.

    Args:
        canvas: where to draw.
        rng: source of what differs from window to window.
        left: edge of the frame, texels; so the next three.
        bottom: edge of the frame.
        right: edge of the frame.
        top: edge of the frame.
        style: how the window looks.
    """
    # The frame, and the glass within it.
    rectangle(canvas, left, bottom, right=right, top=top, value=style.frame)
    left = left + FRAME_WIDTH
    bottom = bottom + FRAME_WIDTH
    right = right - FRAME_WIDTH
    top = top - FRAME_WIDTH
    height = round(FINE * top) - round(FINE * bottom)
    width = round(FINE * right) - round(FINE * left)
    pane = style.pane(rng, height, width)
    rectangle(canvas, left, bottom, right=right, top=top, value=pane)

    # The shadow of the lintel, and the bars.
    rectangle(canvas, left, top - 3, right=right, top=top, value=0.08)
    bar = FRAME_WIDTH / 3
    for column in range(1, style.columns):
        x = left + (right - left) * column / style.columns
        rectangle(canvas, x - bar, bottom, right=x + bar, top=top, value=style.frame)
    if style.transom is not None:
        y = bottom + (top - bottom) * style.transom
        rectangle(canvas, left, y - bar, right=right, top=y + bar, value=style.frame)
