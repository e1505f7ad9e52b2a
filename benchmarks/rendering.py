"""How fast scenes are rendered on two cores, and how much memory that takes as they grow longer.

python benchmarks/rendering.py
"""

from __future__ import annotations

import os
import resource
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import get_args

from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.recording import open_scene
from probevo_sim.scene.writer import write_scene

CORES = 2


def measure(config: SceneConfig) -> tuple[int, float, float]:
    """Frames, frames written a second (PNG files included, set-up not), and the most memory that
    took, MiB."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, list(os.sched_getaffinity(0))[:CORES])
    with tempfile.TemporaryDirectory() as folder:
        write_scene(
            SceneConfig(preset="road", distance_m=3.0), Path(folder) / "compiled", jobs=CORES
        )
        stamps: list[float] = []
        write_scene(
            config,
            Path(folder) / "scene",
            jobs=CORES,
            on_frame=lambda done, total: stamps.append(time.time()),
        )
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return len(open_scene(config)), (len(stamps) - 1) / (stamps[-1] - stamps[0]), peak_mib


def main() -> None:
    scenes = {f"{p}, 100 m": SceneConfig(preset=p, distance_m=100.0) for p in get_args(PresetName)}
    scenes |= {
        f"city, {name}, 40 m": SceneConfig(
            preset="city", distance_m=40.0, effects=Effects(**{name: 1.0})
        )
        for name in ("shadows", "traffic", "blur")
    }
    scenes |= {f"road, {m} m": SceneConfig(preset="road", distance_m=m) for m in (400, 2000)}
    for name, config in scenes.items():
        # A process each, lest the memory of one be taken for that of the next.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            frames, rate, peak_mib = pool.submit(measure, config).result()
        print(
            f"{name:20} {frames:5} pairs of 621×188: {rate:5.1f} a second, {peak_mib:4.0f} MiB at"
            " most",
            flush=True,
        )


if __name__ == "__main__":
    main()
