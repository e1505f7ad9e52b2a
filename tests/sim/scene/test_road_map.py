"""The map of distances from the road: exact where bands of the ground reach, far off elsewhere."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from probevo_sim.scene.config import PresetName, SceneConfig
from probevo_sim.scene.recording import open_scene
from probevo_sim.scene.scene_arrays import BLOCK_M, MAP_CELL_M, _road_map


@pytest.mark.parametrize("preset", get_args(PresetName))
def test_distances_are_exact_where_it_matters(preset: PresetName) -> None:
    """At every node of a cell with a node that a band reaches, also beyond both ends of the drive;
    the others are farther off, on the same side."""
    ground = open_scene(SceneConfig(preset=preset, distance_m=25.0)).renderer.world.ground
    corner_m, blocks, found_m = _road_map(ground)
    i, j = np.nonzero(blocks >= 0)
    steps_m = MAP_CELL_M * np.arange(found_m.shape[-1])
    nodes_m = np.stack(np.meshgrid(steps_m, steps_m), axis=-1)
    places_m = (corner_m + BLOCK_M * np.stack([j, i], axis=1))[:, None, None] + nodes_m
    expected_m = ground.route.nearest(places_m)[1].astype(np.float32)
    found_m = found_m[blocks[i, j]]
    reach_m = float(ground.edge_m[:-1].max(initial=0.0))
    is_reached = np.abs(expected_m) <= reach_m + np.hypot(MAP_CELL_M, MAP_CELL_M)
    assert is_reached.any()
    np.testing.assert_array_equal(found_m[is_reached], expected_m[is_reached])
    assert (np.abs(found_m[~is_reached]) > reach_m).all()
    np.testing.assert_array_equal(np.sign(found_m), np.sign(expected_m))
