"""Measure how fast scenes are rendered on two cores, and how much memory long ones take.

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
from typing import NamedTuple, get_args

from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.recording import open_scene
from probevo_sim.scene.writer import write_scene

CORES = 2


class Rendering(NamedTuple):
    """What a scene took."""

    frames: int
    rate_hz: float
    """Frames written a second, PNG files included, set-up excluded."""
    peak_mib: float
    """Peak of the memory."""


def measure(config: SceneConfig) -> Rendering:
    """Render a scene in this process, and measure that."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, list(os.sched_getaffinity(0))[:CORES])
    with tempfile.TemporaryDirectory() as folder:
        # A short scene first, so that the loops are compiled.
        short = SceneConfig(preset="road", distance_m=3.0)
        write_scene(short, Path(folder) / "compiled", jobs=CORES)
        stamps: list[float] = []
        write_scene(
            config,
            Path(folder) / "scene",
            jobs=CORES,
            on_frame=lambda done, total: stamps.append(time.time()),
        )
    peak_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    rate_hz = (len(stamps) - 1) / (stamps[-1] - stamps[0])
    return Rendering(len(open_scene(config)), rate_hz, peak_mib)


def main() -> None:
    """Measure and print all scenes: presets, expensive effects, and long roads."""
    scenes = {f"{p}, 100 m": SceneConfig(preset=p, distance_m=100.0) for p in get_args(PresetName)}
    scenes |= {
        f"city, {name}, 40 m": SceneConfig(
            preset="city", distance_m=40.0, effects=Effects(**{name: 1.0})
        )
        for name in ("shadows", "traffic", "blur")
    }
    scenes |= {f"road, {m} m": SceneConfig(preset="road", distance_m=m) for m in (400, 2000)}
    for name, config in scenes.items():
        # One process for each, because the peak of the memory is that of a process.
        with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
            result = pool.submit(measure, config).result()
        print(
            f"{name:20} {result.frames:5} pairs of 621×188: {result.rate_hz:5.1f} a second,"
            f" {result.peak_mib:4.0f} MiB at most",
            flush=True,
        )


if __name__ == "__main__":
    main()
