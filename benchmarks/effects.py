"""Measure what each effect of a scene costs the odometry: the table of docs/simulation.md.

python benchmarks/effects.py [number of places, 3 by default]
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import astuple, dataclass, fields
from typing import get_args

import cv2
import numpy as np

import probevo as pv
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.output.run_result import RunRecorder
from probevo_sim.scene.config import Effects, PresetName, SceneConfig
from probevo_sim.scene.recording import open_scene

DISTANCE_M = 200.0
DEGRADED: dict[PresetName, tuple[str, ...]] = {
    "city": tuple(Effects.model_fields),
    "road": ("traffic", "textureless", "foliage"),
}
"""Effects that are tried one at a time; on the road, those that hardly matter in a city."""


def run(config: SceneConfig) -> tuple[Metrics, float]:
    """Run the shipped defaults; return the metrics, and the share of steps that are OK."""
    cv2.setNumThreads(1)
    recording = open_scene(config)
    recorder = RunRecorder()
    odometry = pv.StereoOdometry(
        recording.camera, imu=recording.imu, config={"estimator": "two-frame"}
    )
    for frame in recording:
        recorder.add(frame.stamp_ns, odometry.step(frame))
    result = recorder.result()
    metrics = evaluate(
        result.T_world_cam, recording.truth.T_world_cam, result.T_curr_prev, cov=result.cov
    )
    return metrics, float(np.mean(result.status == pv.Status.OK))


def scenes(places: int) -> Iterator[tuple[str, int, SceneConfig]]:
    """Yield each scene with its row of the table and the number of its place."""
    for seed in range(places):
        for preset in get_args(PresetName):
            length_m = 100.0 if preset == "rover" else DISTANCE_M
            config = SceneConfig(preset=preset, seed=seed, distance_m=length_m)
            yield f"{preset}, clean", seed, config
        for preset, names in DEGRADED.items():
            for name in names:
                config = SceneConfig(
                    preset=preset,
                    seed=seed,
                    distance_m=DISTANCE_M,
                    effects=Effects(**{name: 1.0}),
                )
                yield f"{preset}, {name}", seed, config


@dataclass(frozen=True)
class Figures:
    """The figures of one run, or their means over several."""

    drift_percent: float
    end_percent: float
    rotation_deg_per_m: float
    step_mm: float
    step_deg: float
    anees: float
    ok_percent: float

    @staticmethod
    def of(metrics: Metrics, ok: float) -> Figures:
        """Return the figures of a run, from its metrics and the share of steps that are OK."""
        return Figures(
            drift_percent=metrics.short_t_percent,
            end_percent=100.0 * metrics.final_error_m / metrics.path_length_m,
            rotation_deg_per_m=metrics.short_r_deg_per_m,
            step_mm=1e3 * metrics.rpe_t_m,
            step_deg=metrics.rpe_r_deg,
            anees=metrics.anees,
            ok_percent=100.0 * ok,
        )

    @staticmethod
    def mean(runs: Iterable[Figures]) -> Figures:
        """Return the means over some runs."""
        means = np.mean([astuple(run) for run in runs], axis=0).tolist()
        names = [field.name for field in fields(Figures)]
        return Figures(**dict(zip(names, means, strict=True)))


def main() -> None:
    """Run all scenes in two processes, and print the table."""
    places = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    named = list(scenes(places))
    with ProcessPoolExecutor(2) as pool:
        results = pool.map(run, [config for *_, config in named])
        rows: dict[str, dict[int, Figures]] = {}
        for (name, seed, _), (metrics, ok) in zip(named, results, strict=True):
            figures = Figures.of(metrics, ok)
            rows.setdefault(name, {})[seed] = figures
            progress = f"{name}, place {seed}: drift {figures.drift_percent:.3f} %"
            print(progress, file=sys.stderr, flush=True)
    print(
        "| scene | drift, % | end, % | °/m | step, mm | step, ° | against clean, mm | ANEES |"
        " OK, % |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    for name, runs in rows.items():
        # The error of a step against that in the same place without effects.
        preset, effect = name.split(", ")
        clean = rows[f"{preset}, clean"]
        ratios = [run.step_mm / clean[seed].step_mm for seed, run in runs.items()]
        against = f"× {min(ratios):.2f} … {max(ratios):.2f}" if effect != "clean" else ""
        mean = Figures.mean(runs.values())
        cells = [
            name,
            f"{mean.drift_percent:.2f}",
            f"{mean.end_percent:.2f}",
            f"{mean.rotation_deg_per_m:.4f}",
            f"{mean.step_mm:.1f}",
            f"{mean.step_deg:.4f}",
            against,
            f"{mean.anees:.0f}",
            f"{mean.ok_percent:.1f}",
        ]
        print("| " + " | ".join(cells) + " |")


if __name__ == "__main__":
    main()
