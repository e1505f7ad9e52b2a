"""What learned noise gains on many drives through streets: docs/window.md.

    python benchmarks/learning_streets.py [--drives 4] [--models DIR] [--streets DIR] [--own-truth]

A single drive says little of what learning gains: its drift is mostly the error of one scale. Here
the static Student-t and generalized kernels, learned without truth from a rendered city, are tested
on four other cities and four residential streets, clean and with effects, with two frames and with
the window, by images alone. Prints the drift, %, and the rotation, °/m, over pieces of 10 to 50 m
of each drive, and the NEES of its steps over their 6 dimensions; and then, over the drives of a
kind, the geometric mean of the untrained model, the ratio of each learned one to it with the
standard error of that ratio, and on how many drives it is less. With ``--streets``, the rendered
drives are kept there, and those that exist are not rendered again. With ``--own-truth``, each drive
is tested with the models that are learned from itself, with its true poses: no learning of the
noise of single observations can gain more.
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
from window_learning import TRAININGS, UNTRAINED, learned_noises

import probevo as pv
from probevo.arrays import FloatArray
from probevo.evaluation.metrics import evaluate
from probevo_sim.scene.config import Effects, SceneConfig
from probevo_sim.scene.writer import write_scene

TRAINING_STREETS = (
    SceneConfig(preset="city", seed=1, distance_m=100.0),
    SceneConfig(preset="city", seed=2, distance_m=100.0, effects=EFFECTS),
)
STREETS = {
    f"{preset}, {condition}": (preset, effects)
    for preset in ("city", "residential")
    for condition, effects in (("clean", Effects()), ("effects", EFFECTS))
}
FIRST_SEED = 3100
"""No model was learned from, and no setting chosen on, this and the following ones. A place has the
same seed clean and with effects."""
DISTANCE_M = 60.0
ESTIMATORS = ("two-frame", "window")
QUANTITIES = ("drift", "rotation", "NEES")


def learned_from_streets(models: Path) -> dict[str, str]:
    """Return the noise models that are learned from rendered streets, by their names."""
    with tempfile.TemporaryDirectory() as folder:

        def streets() -> list[Path]:
            """Render the streets to learn from."""
            for number, config in enumerate(TRAINING_STREETS):
                write_scene(config, Path(folder) / str(number), jobs=2)
            return [Path(folder) / str(number) for number in range(len(TRAINING_STREETS))]

        return learned_noises(models, "rendered", streets)


def learned_from_itself(models: Path, street: Path) -> dict[str, str]:
    """Return the noise models that are learned from a street and its true poses, by their names."""
    files = {UNTRAINED: UNTRAINED}
    for name, settings in TRAININGS.items():
        file = models / f"{street.name} {name}.safetensors".replace(" ", "-")
        if not file.is_file():
            with_truth = settings.model_copy(update={"supervision": "gt"})
            pv.train_model([street], with_truth, file)
        files[name] = str(file)
    return files


def errors(
    street: SceneConfig, folder: Path, noises: list[str], *, own_models: Path | None
) -> FloatArray:
    """Return the ``QUANTITIES`` of each estimator with each noise model, [E, M, 3].

    Args:
        street: what is rendered.
        folder: where.
        noises: the noise models.
        own_models: folder of models that are learned from this street, and tested instead; None to
            test the given ones.
    """
    cv2.setNumThreads(1)
    sequence = pv.open_sequence(write_scene(street, folder))
    if own_models is not None:
        noises = list(learned_from_itself(own_models, folder).values())
    truth = sequence.truth.T_world_cam
    found = np.empty((len(ESTIMATORS), len(noises), len(QUANTITIES)))
    for e, estimator in enumerate(ESTIMATORS):
        for m, noise in enumerate(noises):
            odometry = pv.StereoOdometry(sequence.camera, noise, config={"estimator": estimator})
            steps = [odometry.step(replace(frame, imu=None)) for frame in sequence]
            metrics = evaluate(
                np.array([step.T_world_cam for step in steps]),
                truth,
                np.array([step.T_curr_prev for step in steps[1:]]),
                np.array([step.cov for step in steps[1:]]),
            )
            found[e, m] = metrics.short_t_percent, metrics.short_r_deg_per_m, metrics.anees / 6.0
    return found


def summary(found: FloatArray, names: list[str]) -> str:
    """Return the geometric mean of the untrained model, and the ratio of each learned one to it.

    Args:
        found: a quantity of each drive with each model, [N, M]; the untrained is the first.
        names: those of the models, [M].
    """
    logs = np.log(found)
    cells = [f"{names[0]} {np.exp(logs[:, 0].mean()):.4f}"]
    for m, name in enumerate(names[1:], start=1):
        ratios = logs[:, m] - logs[:, 0]
        error = ratios.std(ddof=1) / np.sqrt(len(ratios))
        less = int((ratios < 0).sum())
        cells.append(
            f"{name} × {np.exp(ratios.mean()):.3f} ± {error:.3f}, less on {less}/{len(ratios)}"
        )
    return "; ".join(cells)


def main() -> None:
    """Learn where needed, and print a line for each drive and each kind of street."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--drives", type=int, default=4, help="of each kind of street")
    parser.add_argument("--models", type=Path, default=Path("out/window_learning"))
    parser.add_argument("--streets", type=Path)
    parser.add_argument("--own-truth", action="store_true", help="learn from the drive itself")
    arguments = parser.parse_args()
    arguments.models.mkdir(parents=True, exist_ok=True)
    own_models = arguments.models if arguments.own_truth else None
    names = [UNTRAINED, *TRAININGS]
    noises = [] if own_models else list(learned_from_streets(arguments.models).values())
    print("untrained, fitted Student-t, gk: drift, % / rotation, °/m / NEES of a step", flush=True)
    with (
        tempfile.TemporaryDirectory() as temporary,
        ProcessPoolExecutor(max_workers=2, mp_context=get_context("spawn")) as pool,
    ):
        folder = arguments.streets or Path(temporary)
        for kind, (preset, effects) in STREETS.items():
            running = []
            for seed in range(FIRST_SEED, FIRST_SEED + arguments.drives):
                street = SceneConfig(
                    preset=preset, seed=seed, distance_m=DISTANCE_M, effects=effects
                )
                name = f"{kind}_{seed}".replace(", ", "_")
                running.append(
                    pool.submit(errors, street, folder / name, noises, own_models=own_models)
                )
            table = np.array([drive.result() for drive in running])
            show(kind, table, names)


def show(kind: str, table: FloatArray, names: list[str]) -> None:
    """Print the lines of a kind of street.

    Args:
        kind: its name.
        table: the ``QUANTITIES`` of each drive, estimator and model, [N, E, M, 3].
        names: those of the models, [M].
    """
    for seed, of_drive in enumerate(table, start=FIRST_SEED):
        for estimator, of_models in zip(ESTIMATORS, of_drive, strict=True):
            cells = "  ".join(f"{t:.3f} / {r:.4f} / {nees:.2f}" for t, r, nees in of_models)
            print(f"{kind} {seed} {estimator:9} {cells}")
    for e, estimator in enumerate(ESTIMATORS):
        for q, quantity in enumerate(QUANTITIES):
            print(f"{kind} {estimator:9} {quantity:8} {summary(table[:, e, :, q], names)}")


if __name__ == "__main__":
    main()
