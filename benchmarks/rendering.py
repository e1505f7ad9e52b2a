"""How fast scenes are rendered on two cores, and how much memory that takes as they grow longer.

python benchmarks/rendering.py
"""

from __future__ import annotations

import resource
import tempfile
import time
from pathlib import Path
from typing import get_args

from probevo.simulation.scene.config import Effects, PresetName, SceneConfig
from probevo.simulation.scene.recording import open_scene
from probevo.simulation.scene.writer import write_scene

THREADS = 2


def memory_mib() -> float:
    """Highest resident memory so far."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def write(config: SceneConfig) -> tuple[int, float]:
    """Frames written and the seconds that took, set-up and PNG files included."""
    with tempfile.TemporaryDirectory() as folder:
        start = time.perf_counter()
        write_scene(config, Path(folder) / "scene", jobs=THREADS)
        return len(open_scene(config)), time.perf_counter() - start


def main() -> None:
    write(SceneConfig(preset="road", distance_m=5.0))  # compiles
    for preset in get_args(PresetName):
        frames, seconds = write(SceneConfig(preset=preset, distance_m=None if preset == "rover" else 100.0))
        print(f"{preset:12} {frames:5} pairs of 621×188, {frames / seconds:5.1f} a second")
    for name in ("shadows", "blur"):
        frames, seconds = write(SceneConfig(preset="city", distance_m=60.0, effects=Effects(**{name: 1.0})))
        print(f"city, {name:7} {frames:4} pairs of 621×188, {frames / seconds:5.1f} a second")
    for distance_m in (100.0, 400.0, 1600.0):
        frames, _ = write(SceneConfig(preset="road", distance_m=distance_m))
        print(f"road of {distance_m:6.0f} m, {frames:4} pairs: {memory_mib():.0f} MiB at most")


if __name__ == "__main__":
    main()
