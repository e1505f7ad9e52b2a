"""The places that can be driven through."""

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
