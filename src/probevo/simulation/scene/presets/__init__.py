"""The places that can be driven through."""

from __future__ import annotations

from collections.abc import Callable

from probevo.simulation.scene.config import PresetName, SceneConfig
from probevo.simulation.scene.presets.city import city
from probevo.simulation.scene.presets.place import Place
from probevo.simulation.scene.presets.residential import residential
from probevo.simulation.scene.presets.road import road
from probevo.simulation.scene.presets.rover import rover

PRESETS: dict[PresetName, Callable[[SceneConfig], Place]] = {
    "city": city,
    "residential": residential,
    "road": road,
    "rover": rover,
}
