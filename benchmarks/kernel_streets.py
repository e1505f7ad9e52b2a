"""PROBE-GK against the static Student-t, shipped and fitted, on rendered streets and real images
(docs/probe-gk.md).

python benchmarks/kernel_streets.py [city|residential|road|kitti …, all of these by default]

Trials as in ``probe.py``: trained on one drive, judged on four of other places, whose mean comes
last; raw 0005 on its second half, and on odometry 06.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
import numpy as np
from probe import OUT, Trial, estimate, trials
from recordings import RECORDINGS, by_velocities

import probevo as pv
from probevo.evaluation.metrics import evaluate
from probevo.training.settings import KernelSettings, TrainSettings

NAMES = ("city", "residential", "road", "kitti")
PLACES = 4
TURNS = 3


def models(trial: Trial) -> dict[str, pv.noise.NoiseModel]:
    kernel = KernelSettings(iterations=TURNS)
    settings = {
        "fitted Student-t": TrainSettings(
            kind="student-t", supervision="none", gk=KernelSettings(time_correlation=False)
        ),
        "it, lasting": TrainSettings(kind="student-t", supervision="none"),
        "GK-EM": TrainSettings(kind="gk", supervision="none", gk=kernel),
        "GK-GT": TrainSettings(kind="gk", supervision="gt", gk=kernel),
    }
    found: dict[str, pv.noise.NoiseModel] = {"student-t": pv.noise.StudentT()}
    for name, chosen in settings.items():
        path: Path = OUT / "models" / f"{trial.name}-{name}.safetensors".replace(" ", "-")
        chosen = chosen.model_copy(update={"max_frames": trial.half})
        found[name] = pv.load_model(pv.train_model([pv.open_sequence(trial.train)], chosen, path))
    return found


def main() -> None:
    cv2.setNumThreads(1)
    head = (
        "",
        "noise",
        "what lasts",
        "ARMSE, m",
        "step, mm",
        "drift, %",
        "°/m",
        "ANEES",
        "drift by INS velocities, %",
    )
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for trial in trials(sys.argv[1:] or list(NAMES), PLACES):
        for name, model in models(trial).items():
            start = f"| {name} | {model.time_correlation:.1f} |"
            found = list[tuple[float, ...]]()
            for test in trial.tests:
                result = estimate(test, model, pv.OdometryConfig())
                rest = slice(trial.half or 0, None)
                steps = (result.T_curr_prev[rest], result.cov[rest])
                motions = result.T_world_cam[rest]
                m = evaluate(motions, pv.open_sequence(test).truth.T_world_cam[rest], *steps)
                found.append(
                    (m.armse_m, 1e3 * m.rpe_t_m, m.short_t_percent, m.short_r_deg_per_m, m.anees)
                )
                line = f"| {trial.name}: {test.name} {start} {figures(found[-1])} |"
                if test == RECORDINGS["raw 0005"]:
                    line += f" {evaluate(motions, by_velocities(test)[rest]).short_t_percent:.3f} |"
                print(line, flush=True)
            if len(found) > 1:
                print(
                    f"| {trial.name}: mean {start} {figures(tuple(np.mean(found, axis=0)))} |",
                    flush=True,
                )


def figures(found: tuple[float, ...]) -> str:
    return " | ".join(
        f"{value:{form}}"
        for value, form in zip(found, (".3f", ".2f", ".3f", ".4f", ".1f"), strict=True)
    )


if __name__ == "__main__":
    main()
