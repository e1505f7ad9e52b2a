"""PROBE-GK against the static Student-t, shipped and fitted, on rendered streets and real images (docs/probe-gk.md).

python benchmarks/kernel_streets.py [city|residential|road|kitti …, all of these by default]

Trials as in ``probe.py``: trained on one drive, judged on another of another place; raw 0005 on its second half, and on
odometry 06.
"""

from __future__ import annotations

import sys
from pathlib import Path

import cv2
from probe import OUT, Trial, estimate, trials
from recordings import RECORDINGS, by_velocities

import probevo as pv
from probevo.evaluation.metrics import evaluate
from probevo.training.settings import KernelSettings, TrainSettings

NAMES = ("city", "residential", "road", "kitti")
TURNS = 3


def models(trial: Trial) -> dict[str, pv.noise.NoiseModel]:
    kernel = KernelSettings(turns=TURNS)
    settings = {
        "fitted Student-t": TrainSettings(kind="student-t", supervision="none", gk=KernelSettings(lasting=False)),
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
    head = ("", "noise", "what lasts", "ARMSE, m", "step, mm", "drift, %", "°/m", "ANEES", "drift by INS velocities, %")
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for trial in trials(sys.argv[1:] or list(NAMES)):
        for name, model in models(trial).items():
            for test in trial.tests:
                result, rest = estimate(test, model, pv.OdometryConfig()), slice(trial.half or 0, None)
                steps, motions = (result.T_curr_prev[rest], result.cov[rest]), result.T_world_cam[rest]
                found = evaluate(motions, pv.open_sequence(test).truth.T_world_cam[rest], *steps)
                figures = f"{found.armse_m:.3f} | {1e3 * found.rpe_t_m:.2f} | {found.short_t_percent:.3f}"
                figures += f" | {found.short_r_deg_per_m:.4f} | {found.anees:.1f}"
                if test == RECORDINGS["raw 0005"]:
                    figures += f" | {evaluate(motions, by_velocities(test)[rest]).short_t_percent:.3f}"
                print(f"| {trial.name}: {test.name} | {name} | {model.lasting:.1f} | {figures} |", flush=True)


if __name__ == "__main__":
    main()
