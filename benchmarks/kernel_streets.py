"""Compare PROBE-GK and PROBE with the static Student-t on rendered streets and on real images.

    python benchmarks/kernel_streets.py [city|residential|road|kitti …, all of these by default]

Each model is tested with two frames and with the window. Trials are those of ``probe.py``: trained
on one street and tested on four of other places, whose mean comes last; trained on the first half
of raw 0005 and tested on its second; trained on raw 0005 and tested on odometry 06.
"""

from __future__ import annotations

import sys
from itertools import product

import cv2
import numpy as np
from probe import OUT, Trial, estimate, trials
from recordings import RECORDINGS, by_velocities

import probevo as pv
from probevo.arrays import FloatArray
from probevo.config.training import KernelSettings, TrainSettings
from probevo.evaluation.metrics import Metrics, evaluate
from probevo.output.run_result import RunResult

NAMES = ("city", "residential", "road", "kitti")
PLACES = 4
ESTIMATORS = ("two-frame", "window")
KERNEL = KernelSettings(iterations=3)
TRAININGS = {
    "fitted Student-t": TrainSettings(
        kind="student-t", supervision="none", gk=KernelSettings(time_correlation=False)
    ),
    "it, time-correlated": TrainSettings(kind="student-t", supervision="none"),
    "PROBE": TrainSettings(kind="knn", supervision="none"),
    "GK-EM": TrainSettings(kind="gk", supervision="none", gk=KERNEL),
    "GK-GT": TrainSettings(kind="gk", supervision="gt", gk=KERNEL),
}
HEAD = (
    "",
    "noise",
    "estimator",
    "κ",
    "ARMSE, m",
    "step, mm",
    "drift, %",
    "°/m",
    "ANEES",
    "drift by INS velocities, %",
)


def models(trial: Trial) -> dict[str, pv.noise.NoiseModel]:
    """Return the shipped Student-t and each learned noise model, by name."""
    found: dict[str, pv.noise.NoiseModel] = {"student-t": pv.noise.StudentT()}
    for name, settings in TRAININGS.items():
        path = OUT / "models" / f"{trial.name}-{name}.safetensors".replace(" ", "-")
        settings = settings.model_copy(update={"max_frames": trial.half})
        found[name] = pv.load_model(pv.train_model([pv.open_sequence(trial.train)], settings, path))
    return found


def metrics_from(result: RunResult, truth: FloatArray, first: int) -> Metrics:
    """Return the metrics over the frames from ``first`` on."""
    return evaluate(
        result.T_world_cam[first:],
        truth[first:],
        result.T_curr_prev[first:],
        cov=result.cov[first:],
    )


def figures(metrics: Metrics) -> list[float]:
    """Return the figures of a row."""
    return [
        metrics.armse_m,
        1e3 * metrics.rpe_t_m,
        metrics.short_t_percent,
        metrics.short_r_deg_per_m,
        metrics.anees,
    ]


def cells(values: list[float]) -> str:
    """Return the figures of a row as text."""
    formats = (".3f", ".2f", ".3f", ".4f", ".1f")
    return " | ".join(f"{value:{form}}" for value, form in zip(values, formats, strict=True))


def print_trial(trial: Trial) -> None:
    """Print a row for each noise model, estimator and test drive, and the mean over the drives if
    there are several."""
    first = trial.half or 0
    for (name, model), estimator in product(models(trial).items(), ESTIMATORS):
        ratio = getattr(model, "time_correlation_ratio_", 0.0)
        start = f"| {name} | {estimator} | {ratio:.1f} |"
        rows = []
        for test in trial.tests:
            result = estimate(
                test, model, pv.OdometryConfig.model_validate({"estimator": estimator})
            )
            truth = pv.open_sequence(test).truth.T_world_cam
            rows.append(figures(metrics_from(result, truth, first)))
            line = f"| {trial.name}: {test.name} {start} {cells(rows[-1])} |"
            if test == RECORDINGS["raw 0005"]:
                # The positions of this drive's truth are too short; see docs/accuracy.md.
                velocity_truth = by_velocities(test)
                metrics = evaluate(result.T_world_cam[first:], velocity_truth[first:])
                line += f" {metrics.short_t_percent:.3f} |"
            print(line, flush=True)
        if len(rows) > 1:
            mean = np.mean(rows, axis=0).tolist()
            print(f"| {trial.name}: mean {start} {cells(mean)} |", flush=True)


def main() -> None:
    """Print the tables of docs/probe-gk.md."""
    cv2.setNumThreads(1)
    print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
    for trial in trials(sys.argv[1:] or list(NAMES), PLACES):
        print_trial(trial)


if __name__ == "__main__":
    main()
