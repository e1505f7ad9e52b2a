"""What learned noise gains on many streets, each another place: docs/window.md.

    python benchmarks/learning_streets.py [--drives 8] [--models out/window_learning]

A single drive says little of what learning gains: its drift is mostly the error of one scale. Here
the models of ``window_learning.py``, learned without truth from a rendered city, are tested on
eight other cities and eight residential streets, clean and with effects. For the window and for two
frames, by images alone, it prints the drift, %, and the rotation, °/m, over pieces of 10 to 50 m of
each drive, and then, over the drives of a kind, the geometric means of the untrained model, the
ratio of each learned one to it with the standard error of that ratio, and on how many it is better.
"""

from __future__ import annotations

import argparse
import tempfile
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import cv2
import numpy as np
from window import EFFECTS
from window_learning import learned_from_streets

import probevo as pv
from probevo.arrays import FloatArray
from probevo.evaluation.metrics import evaluate
from probevo_sim.scene.config import Effects, SceneConfig
from probevo_sim.scene.writer import write_scene

STREETS = {
    f"{preset}, {condition}": (preset, effects)
    for preset in ("city", "residential")
    for condition, effects in (("clean", Effects()), ("effects", EFFECTS))
}
FIRST_SEED = 3100
"""No model was learned from, and no setting chosen on, this and the following ones."""
DISTANCE_M = 60.0
ESTIMATORS = ("two-frame", "window")


def drift(street: SceneConfig, noises_by_name: dict[str, str]) -> FloatArray:
    """Return drift, %, and rotation, °/m, of each estimator with each noise model, [E, M, 2]."""
    cv2.setNumThreads(1)
    found = np.empty((len(ESTIMATORS), len(noises_by_name), 2))
    with tempfile.TemporaryDirectory() as folder:
        sequence = pv.open_sequence(write_scene(street, Path(folder) / "street"))
        for e, estimator in enumerate(ESTIMATORS):
            for m, noise in enumerate(noises_by_name.values()):
                odometry = pv.StereoOdometry(
                    sequence.camera, noise, config={"estimator": estimator}
                )
                path = [odometry.step(replace(frame, imu=None)).T_world_cam for frame in sequence]
                metrics = evaluate(np.array(path), sequence.truth.T_world_cam)
                found[e, m] = metrics.short_t_percent, metrics.short_r_deg_per_m
    return found


def summary(found: FloatArray, names: list[str]) -> str:
    """Return the geometric mean of the untrained model, and the ratio of each learned one to it.

    Args:
        found: drift or rotation of each drive with each model, [N, M]; the untrained is the first.
        names: those of the models, [M].
    """
    logs = np.log(found)
    cells = [f"{names[0]} {np.exp(logs[:, 0].mean()):.4f}"]
    for m, name in enumerate(names[1:], start=1):
        ratios = logs[:, m] - logs[:, 0]
        error = ratios.std(ddof=1) / np.sqrt(len(ratios))
        better = int((ratios < 0).sum())
        cells.append(
            f"{name} × {np.exp(ratios.mean()):.3f} ± {error:.3f}, better on {better}/{len(ratios)}"
        )
    return "; ".join(cells)


def main() -> None:
    """Learn where needed, and print a line for each drive and each kind of street."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drives", type=int, default=8, help="of each kind of street")
    parser.add_argument("--models", type=Path, default=Path("out/window_learning"))
    arguments = parser.parse_args()
    arguments.models.mkdir(parents=True, exist_ok=True)
    by_name = learned_from_streets(arguments.models)
    names = list(by_name)
    with ProcessPoolExecutor(max_workers=2, mp_context=get_context("spawn")) as pool:
        for kind, (preset, effects) in STREETS.items():
            streets = [
                SceneConfig(preset=preset, seed=seed, distance_m=DISTANCE_M, effects=effects)
                for seed in range(FIRST_SEED, FIRST_SEED + arguments.drives)
            ]
            of_drives = []
            for street, found in zip(
                streets, pool.map(drift, streets, [by_name] * len(streets)), strict=True
            ):
                of_drives.append(found)
                for estimator, of_models in zip(ESTIMATORS, found, strict=True):
                    cells = " ".join(f"{t:.3f}/{r:.4f}" for t, r in of_models)
                    print(f"{kind} {street.seed} {estimator:9} {cells}", flush=True)
            table = np.array(of_drives)
            for e, estimator in enumerate(ESTIMATORS):
                for q, quantity in enumerate(("drift", "rotation")):
                    print(f"{kind} {estimator:9} {quantity:8} {summary(table[:, e, :, q], names)}")


if __name__ == "__main__":
    main()
