"""Objects that stand in a street or lie on it.

Each function builds one object as ``Solids`` in the object's own frame: x forward, y left, z up,
with the origin on the ground below its middle. All lengths are in m, also those without a suffix.
"""

from probevo_sim.scene.presets.furniture.buildings import block, house
from probevo_sim.scene.presets.furniture.cars import car, van
from probevo_sim.scene.presets.furniture.marks import arrow, crosswalk, lane_dash, manhole, patch
from probevo_sim.scene.presets.furniture.plants import bush, distant_tree, hedge, rock, tree
from probevo_sim.scene.presets.furniture.street import (
    bench,
    box,
    fence,
    guard_rail,
    kerb,
    lamp_post,
    litter_bin,
    person,
    road_sign,
    traffic_light,
)

__all__ = [
    "arrow",
    "bench",
    "block",
    "box",
    "bush",
    "car",
    "crosswalk",
    "distant_tree",
    "fence",
    "guard_rail",
    "hedge",
    "house",
    "kerb",
    "lamp_post",
    "lane_dash",
    "litter_bin",
    "manhole",
    "patch",
    "person",
    "road_sign",
    "rock",
    "traffic_light",
    "tree",
    "van",
]
