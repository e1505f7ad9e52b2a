"""The effect ``foliage``: hedges and trees along the road whose leaves repeat, so that every match
has look-alikes."""

from __future__ import annotations

import numpy as np

from probevo_sim.scene.presets.furniture import hedge, tree
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import Solids
from probevo_sim.scene.textures import Texture

HEDGE_TILE_M = 4.0
"""Sixteen times the distance after which the leaves repeat."""
STEP_M = 4.0
BEHIND_M = 20.0
AHEAD_M = 90.0
PER_TREE = 3


def foliage(
    route: Route, strength: float, lateral_m: float, rng: np.random.Generator
) -> list[Solids]:
    """Hedges in lengths of 4 m on both sides of a road, and trees behind every third.

    Args:
        route: the road.
        strength: share of the road that is lined, 0 … 1.
        lateral_m: distance of the hedges from the centre line.
        rng: decides which lengths are left out, the heights, and the trees.
    """
    things = []
    for side in (-1.0, 1.0):
        start_m = -min(BEHIND_M, route.length_m)
        end_m = route.length_m if route.closed else route.length_m + AHEAD_M
        s_m = np.arange(0.0 if route.closed else start_m, end_m, STEP_M)
        heights_m = np.clip(2.2 + np.cumsum(rng.normal(0.0, 0.2, len(s_m))), 1.5, 3.0)
        grows = rng.random(len(s_m)) < strength
        turns = rng.uniform(-0.05, 0.05, len(s_m))
        for k, s in enumerate(s_m):
            trunk = tree(rng, rng.uniform(5.0, 7.0), Texture.HEDGE_REPEATED)
            if not grows[k]:
                continue
            stretch = max(1.0 - float(route.curvature(s)) * side * lateral_m, 0.2)
            piece = hedge(
                STEP_M * stretch + 0.6, heights_m[k], Texture.HEDGE_REPEATED, tile=HEDGE_TILE_M
            )
            things.append(piece.at(route.place(s, side * (lateral_m + turns[k]))))
            if k % PER_TREE == 0:
                things.append(trunk.at(route.place(s, side * (lateral_m + 1.2))))
    return things
