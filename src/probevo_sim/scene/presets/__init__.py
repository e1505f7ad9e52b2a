"""The presets: places that can be driven through, each built from a seed.

``city``, ``residential``, ``road`` and ``rover`` each lay out a route, bands of ground, solids that
stand beside it and marks on the road. ``place.compose`` makes a ``Place`` of these parts and adds
the effects, ``foliage`` and ``traffic`` among them. ``furniture`` and ``vehicles`` build single
objects.
"""

from __future__ import annotations

from collections.abc import Callable

from probevo_sim.scene.config import PresetName, SceneConfig
from probevo_sim.scene.presets.city import city
from probevo_sim.scene.presets.place import Place
from probevo_sim.scene.presets.residential import residential
from probevo_sim.scene.presets.road import road
from probevo_sim.scene.presets.rover import rover

PRESETS: dict[PresetName, Callable[[SceneConfig], Place]] = {
    "city": city,
    "residential": residential,
    "road": road,
    "rover": rover,
}
