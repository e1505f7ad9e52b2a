"""Learn noise without truth, and compare it with the untrained in the window: docs/window.md.

    python benchmarks/window_learning.py [--of rendered real] [--models out/window_learning]

The static Student-t and generalized kernels are learned from a rendered city, clean and with
effects, and tested on the streets of ``window.py``, which are other places; and from real
recordings, and tested on those that were left out. Prints the table of ``window.py`` for the
untrained and for both learned models, with both estimators. Models that are there already are not
learned again.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
from plain_odometry import RECORDINGS
from window import EFFECTS, head, show, show_scenes

import probevo as pv
from probevo.training.settings import KernelSettings, TrainSettings
from probevo_sim.scene.config import SceneConfig
from probevo_sim.scene.writer import write_scene

UNTRAINED = "student-t"
TRAININGS = {
    "fitted Student-t": TrainSettings(kind="student-t", supervision="none"),
    "gk": TrainSettings(kind="gk", supervision="none", gk=KernelSettings(iterations=3)),
}
"""What is learned, by the name in the table."""
TRAINING_STREETS = (
    SceneConfig(preset="city", seed=1, distance_m=100.0),
    SceneConfig(preset="city", seed=2, distance_m=100.0, effects=EFFECTS),
)
RAW_0005 = RECORDINGS["raw 0005"][0]
KITTI_0039 = RECORDINGS["kitti_0039"][0]
REAL_TRAINING = {
    "odometry 06 from frame 12": [RAW_0005, KITTI_0039],
    "raw 0005": [KITTI_0039],
    "kitti_0039": [RAW_0005],
}
"""What is learned from, by the recording of ``window.py`` that it is tested on. Odometry 06 is of
another day, with another calibration."""


def noises(folder: Path, world: str, recordings: Callable[[], list[Path]]) -> dict[str, str]:
    """Return the noise models by their names, and learn those that the folder does not have.

    Args:
        folder: that of the learned models.
        world: what they are learned from, for the names of their files.
        recordings: gives what to learn from; called only if a model is missing.
    """
    files = {name: folder / f"{world} {name}.safetensors".replace(" ", "-") for name in TRAININGS}
    missing = [name for name, file in files.items() if not file.is_file()]
    if missing:
        learn_from = recordings()
        for name in missing:
            pv.train_model(learn_from, TRAININGS[name], files[name])
    return {UNTRAINED: UNTRAINED} | {name: str(file) for name, file in files.items()}


def learned_from_streets(models: Path) -> dict[str, str]:
    """Return the noise models that are learned from rendered streets, by their names."""
    with tempfile.TemporaryDirectory() as folder:

        def streets() -> list[Path]:
            """Render the streets to learn from."""
            for number, config in enumerate(TRAINING_STREETS):
                write_scene(config, Path(folder) / str(number), jobs=2)
            return [Path(folder) / str(number) for number in range(len(TRAINING_STREETS))]

        return noises(models, "rendered", streets)


def compare_rendered(models: Path) -> None:
    """Learn from rendered streets, and print the table of others."""
    for name, noise in learned_from_streets(models).items():
        print(head(name), flush=True)
        show_scenes(noise)


def compare_real(models: Path) -> None:
    """Learn from real recordings, and print the rows of those that were left out."""
    for test, recordings in REAL_TRAINING.items():
        path, first = RECORDINGS[test]
        for name, noise in noises(models, test, partial(list, recordings)).items():
            print(head(name), flush=True)
            show(test, pv.open_sequence(path), first, noise)


COMPARISONS = {"rendered": compare_rendered, "real": compare_real}


def main() -> None:
    """Learn where needed, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--of", nargs="+", choices=COMPARISONS, default=list(COMPARISONS))
    parser.add_argument("--models", type=Path, default=Path("out/window_learning"))
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    arguments.models.mkdir(parents=True, exist_ok=True)
    for world in arguments.of:
        COMPARISONS[world](arguments.models)


if __name__ == "__main__":
    main()
