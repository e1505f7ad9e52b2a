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
from probevo.simulation.scene.config import Effects, PresetName, SceneConfig
from probevo.simulation.scene.recording import open_scene

PRESET, DISTANCE_M = "city", 200.0


def run(config: SceneConfig) -> tuple[Metrics, float]:
    """Metrics of a run with the shipped defaults, and the share of its steps that are OK."""
    cv2.setNumThreads(1)
    recording, recorder = open_scene(config), RunRecorder()
    odometry = pv.StereoOdometry(recording.camera, imu=recording.imu)
    for frame in recording:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    result = recorder.result()
    metrics = evaluate(result.T_world_cam, recording.truth.T_world_cam, result.T_curr_prev, result.cov)
    return metrics, float(np.mean(result.status == pv.Status.OK))


def scenes(places: int) -> Iterator[tuple[str, SceneConfig]]:
    """Each with the row of the tables that it belongs to."""
    for seed in range(places):
        for preset in get_args(PresetName):
            yield (
                f"{preset}, clean",
                SceneConfig(preset=preset, seed=seed, distance_m=None if preset == "rover" else 200.0),
            )
    for name in Effects.model_fields:
        for seed in range(places):
            effects = Effects(**{name: 1.0})
            yield f"{PRESET}, {name}", SceneConfig(preset=PRESET, seed=seed, distance_m=DISTANCE_M, effects=effects)


def main() -> None:
    places = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    named = list(scenes(places))
    with ProcessPoolExecutor(2) as pool:
        results = list(pool.map(run, [config for _, config in named]))
    print("| scene | drift, % | °/m | error of a step, mm | ° | end error, m | ANEES | steps OK |")
    print("|---|---|---|---|---|---|---|---|")
    for name in dict.fromkeys(name for name, _ in named):
        rows = [
            [m.short_t_percent, m.short_r_deg_per_m, 1e3 * m.rpe_t_m, m.rpe_r_deg, m.final_error_m, m.anees, 100 * ok]
            for (label, _), (m, ok) in zip(named, results, strict=True)
            if label == name
        ]
        means, spread = np.mean(rows, axis=0), np.std(rows, axis=0)
        cells = [f"{means[0]:.2f} ± {spread[0]:.2f}", f"{means[1]:.4f}", f"{means[2]:.1f}", f"{means[3]:.4f}"]
        cells += [f"{means[4]:.2f}", f"{means[5]:.0f}", f"{means[6]:.1f} %"]
        print(f"| {name} | " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
