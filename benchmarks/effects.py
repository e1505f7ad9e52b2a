"""What each effect of a simulated scene costs the odometry: the tables of docs/simulation.md.

python benchmarks/effects.py [number of places, 3 by default]
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from typing import get_args

import cv2
import numpy as np

import probevo as pv
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.output.run_result import RunRecorder
from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.recording import open_scene

DISTANCE_M = 200.0
SPOILED: dict[PresetName, tuple[str, ...]] = {
    "city": tuple(Effects.model_fields),
    "road": ("traffic", "textureless", "foliage"),
}
"""Effects that are tried, each alone; on the road those that the city's many features make up for.
"""


def run(config: SceneConfig) -> tuple[Metrics, float]:
    """Metrics of a run with the shipped defaults, and the share of its steps that are OK."""
    cv2.setNumThreads(1)
    recording = open_scene(config)
    recorder = RunRecorder()
    odometry = pv.StereoOdometry(recording.camera, imu=recording.imu)
    for frame in recording:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    result = recorder.result()
    metrics = evaluate(
        result.T_world_cam, recording.truth.T_world_cam, result.T_curr_prev, cov=result.cov
    )
    return metrics, float(np.mean(result.status == pv.Status.OK))


def scenes(places: int) -> Iterator[tuple[str, int, SceneConfig]]:
    """Each with the row of the table that it belongs to, and the number of its place."""
    for seed in range(places):
        for preset in get_args(PresetName):
            length_m = 100.0 if preset == "rover" else DISTANCE_M
            yield (
                f"{preset}, clean",
                seed,
                SceneConfig(preset=preset, seed=seed, distance_m=length_m),
            )
        for preset, name in ((preset, name) for preset, names in SPOILED.items() for name in names):
            effects = Effects(**{name: 1.0})
            config = SceneConfig(preset=preset, seed=seed, distance_m=DISTANCE_M, effects=effects)
            yield f"{preset}, {name}", seed, config


def figures(metrics: Metrics, ok: float) -> list[float]:
    end_percent = 100.0 * metrics.final_error_m / metrics.path_length_m
    step = [1e3 * metrics.rpe_t_m, metrics.rpe_r_deg]
    return [
        metrics.short_t_percent,
        end_percent,
        metrics.short_r_deg_per_m,
        *step,
        metrics.anees,
        100.0 * ok,
    ]


def main() -> None:
    places = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    named = list(scenes(places))
    with ProcessPoolExecutor(2) as pool:
        results = pool.map(run, [config for *_, config in named])
        rows: dict[str, dict[int, list[float]]] = {}
        for (name, seed, _), result in zip(named, results, strict=True):
            rows.setdefault(name, {})[seed] = figures(*result)
            print(
                f"{name}, place {seed}: drift {rows[name][seed][0]:.3f} %",
                file=sys.stderr,
                flush=True,
            )
    print(
        "| scene | drift, % | end, % | °/m | step, mm | step, ° | against clean, mm | ANEES |"
        " OK, % |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, runs in rows.items():
        mean = np.mean(list(runs.values()), axis=0)
        preset, effect = name.split(", ")
        change = [run[3] / rows[f"{preset}, clean"][seed][3] for seed, run in runs.items()]
        least, most = (f"{ratio:.2f}" for ratio in (min(change), max(change)))
        against = f"× {least} … {most}" if effect != "clean" else ""
        cells = [
            f"{mean[0]:.2f}",
            f"{mean[1]:.2f}",
            f"{mean[2]:.4f}",
            f"{mean[3]:.1f}",
            f"{mean[4]:.4f}",
            against,
        ]
        print(f"| {name} | " + " | ".join([*cells, f"{mean[5]:.0f}", f"{mean[6]:.1f}"]) + " |")


if __name__ == "__main__":
    main()
