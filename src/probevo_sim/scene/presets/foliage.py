"""The effect ``foliage``: hedges and trees whose leaves repeat, so that matches are ambiguous."""

from __future__ import annotations

import numpy as np

from probevo_sim.scene.presets.furniture import hedge, tree
from probevo_sim.scene.route import Route
from probevo_sim.scene.solids import Solids
from probevo_sim.scene.textures import Texture

HEDGE_TILE_M = 4.0
"""Sixteen times the distance after which the leaves repeat."""
STEP_M = 4.0
"""Length of one piece of hedge."""
BEHIND_M = 20.0
"""Distance before the start of the road that is lined."""
AHEAD_M = 90.0
"""Distance after the end of the road that is lined."""
PIECES_PER_TREE = 3


def foliage(
    route: Route, strength: float, lateral_m: float, rng: np.random.Generator
) -> list[Solids]:
    """Line both sides of a road with pieces of hedge, 4 m long, and trees behind every third.

    Args:
        route: the road.
        strength: share of the road that is lined, 0 … 1.
        lateral_m: distance of the hedges from the centre line.
        rng: decides which pieces are left out, their heights, and the trees.
    """
    plants = []
    for side in (-1.0, 1.0):
        start_m = -min(BEHIND_M, route.length_m)
        end_m = route.length_m if route.closed else route.length_m + AHEAD_M
        s_m = np.arange(0.0 if route.closed else start_m, end_m, STEP_M)
        # The height of the hedge walks randomly from piece to piece.
        heights_m = np.clip(2.2 + np.cumsum(rng.normal(0.0, 0.2, len(s_m))), 1.5, 3.0)
        grows = rng.random(len(s_m)) < strength
        offsets_m = rng.uniform(-0.05, 0.05, len(s_m))
        for k, s in enumerate(s_m):
            # Draw the tree of each piece, whether or not the piece grows, so that a stronger effect
            # contains a weaker one.
            behind = tree(rng, rng.uniform(5.0, 7.0), Texture.HEDGE_REPEATED)
            if not grows[k]:
                continue
            # In a bend the pieces need another length to join.
            stretch = max(1.0 - float(route.curvature(s)) * side * lateral_m, 0.2)
            piece = hedge(
                STEP_M * stretch + 0.6, heights_m[k], Texture.HEDGE_REPEATED, tile=HEDGE_TILE_M
            )
            plants.append(piece.at(route.place(s, side * (lateral_m + offsets_m[k]))))
            if k % PIECES_PER_TREE == 0:
                plants.append(behind.at(route.place(s, side * (lateral_m + 1.2))))
    return plants
