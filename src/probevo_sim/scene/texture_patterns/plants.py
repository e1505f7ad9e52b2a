"""Textures of plants: grass, foliage, a hedge that repeats itself, bark, and dappled light."""

from __future__ import annotations

import numpy as np

from probevo.arrays import FloatArray
from probevo_sim.scene.texture_patterns.canvas import (
    SIDE,
    Tile,
    blank,
    downsampled,
    noise,
    polygon,
    stroke,
    upsampled,
)

HEDGE_PERIOD = 32
"""Texels after which the hedge repeats itself."""


def grass(rng: np.random.Generator) -> Tile:
    """Draw blades in tufts, the bright ones on top."""
    tufts = noise(rng, 0.8, 6, high=40)
    canvas = upsampled(0.4 * noise(rng, 0.6, 8) - 1.2)
    count = 5000
    foot = rng.uniform(0, SIDE, (count, 2))
    lean = rng.normal(np.pi / 2, 0.8, count)
    tip = foot + rng.uniform(7, 22, (count, 1)) * np.stack([np.cos(lean), np.sin(lean)], axis=1)
    grey = (
        np.linspace(-1.4, 1.2, count) + 0.5 * _at(tufts, foot) + rng.normal(scale=0.5, size=count)
    )
    width = rng.choice([1.0, 1.5, 2.0], count)
    for a, b, thick, value in zip(foot, tip, width, grey, strict=True):
        stroke(canvas, (a, b), thick, value=float(value))
    return downsampled(canvas) + 0.35 * noise(rng, 1.2, 2, high=20)


def foliage(rng: np.random.Generator) -> Tile:
    """Draw leaves of many sizes in clumps, those in front brighter, with dark holes between."""
    clumps = noise(rng, 1.1, 4, high=30)
    canvas = upsampled(0.4 * noise(rng, 0.5, 10) - 2.4)
    count = 4200
    center = rng.uniform(0, SIDE, (count, 2))
    clump = _at(clumps, center)
    depth = np.linspace(-1.8, 1.2, count)
    # Leaves at the back survive only where a clump is dense.
    kept = clump > 0.5 * depth + rng.normal(-0.9, 0.5, count)
    grey = depth + 0.5 * clump + rng.normal(scale=0.45, size=count)
    length = 7 + 5 * rng.pareto(3.0, count).clip(max=3)
    for at, size, value in zip(center[kept], length[kept], grey[kept], strict=True):
        _leaf(
            canvas,
            at,
            size,
            angle_rad=rng.uniform(0, 2 * np.pi),
            slim=rng.uniform(0.35, 0.65),
            value=float(value),
        )
    return downsampled(canvas) + 0.2 * noise(rng, 0.3, 20)


def _at(tile: Tile, points: FloatArray) -> FloatArray:
    """Return the values of a tile at points (x, y), [N, 2]: [N]."""
    columns, rows = points.astype(np.int64).T
    values: FloatArray = tile[rows, columns]
    return values


def hedge_repeated(rng: np.random.Generator) -> Tile:
    """Draw one motif of leaves, repeated exactly 16×16 times, so that matches are ambiguous."""
    motif = blank(-1.5, HEDGE_PERIOD)
    for value in np.linspace(-1.0, 2.0, 26):
        angle = rng.uniform(0, 2 * np.pi)
        slim = rng.uniform(0.4, 0.6)
        _leaf(
            motif,
            rng.uniform(0, HEDGE_PERIOD, 2),
            rng.uniform(4.5, 7),
            angle_rad=angle,
            slim=slim,
            value=float(value),
        )
    repeats = SIDE // HEDGE_PERIOD
    return np.tile(downsampled(motif), (repeats, repeats))


def _leaf(
    canvas: Tile, center: FloatArray, length: float, *, angle_rad: float, slim: float, value: float
) -> None:
    """Draw a pointed leaf, twice ``length`` long, one half in the light."""
    along = length * np.array([np.cos(angle_rad), np.sin(angle_rad)])
    across = slim * np.array([-along[1], along[0]])
    upper = [along, 0.35 * along + 0.8 * across, -0.35 * along + 0.8 * across, -along]
    lower = [-along, -0.35 * along - 0.8 * across, 0.35 * along - 0.8 * across, along]
    polygon(canvas, center + np.array(upper + lower), value)
    if length > 4:
        polygon(canvas, center + np.array(upper), value + 0.45)


def bark(rng: np.random.Generator) -> Tile:
    """Draw ridges up the trunk between dark furrows."""
    plates = noise(rng, 1.2, 7, high=60, stretch=(1.0, 4.5))
    furrows = np.exp(-((plates / 0.3) ** 2))
    fibres = noise(rng, 0.6, 20, high=500, stretch=(1.0, 4.0))
    return -2.2 * furrows + 0.35 * fibres + 0.5 * np.abs(plates) + 0.35 * noise(rng, 0.8, 4)


def dapple(rng: np.random.Generator) -> Tile:
    """Draw the light under a tree: mostly full light or full shade, with soft edges."""
    canopy = noise(rng, 0.9, 5, high=45) + 0.5 * noise(rng, 1.0, 2, high=12)
    return np.tanh(3 * (canopy - np.median(canopy)))
