"""Learn noise from real recordings without truth, and compare it with none: docs/window.md.

    python benchmarks/window_learning.py [--models out/window_learning]

The static Student-t and generalized kernels are learned from real recordings, and tested on those
that were left out. Prints the table of ``window.py`` for the untrained and for both learned models,
with both estimators. Models that are there already are not learned again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from pathlib import Path

import cv2
from plain_odometry import RECORDINGS
from window import head, show

import probevo as pv
from probevo.config.training import KernelSettings, TrainSettings

UNTRAINED = "student-t"
TRAININGS = {
    "fitted Student-t": TrainSettings(kind="student-t", supervision="none"),
    "gk": TrainSettings(kind="gk", supervision="none", gk=KernelSettings(iterations=3)),
}
"""What is learned, by the name in the table."""
RAW_0005 = RECORDINGS["raw 0005"][0]
KITTI_0039 = RECORDINGS["kitti_0039"][0]
REAL_TRAINING = {
    "odometry 06 from frame 12": [RAW_0005, KITTI_0039],
    "raw 0005": [KITTI_0039],
    "kitti_0039": [RAW_0005],
}
"""What is learned from, by the recording of ``window.py`` that it is tested on. Odometry 06 is of
another day, with another calibration."""


def learned_noises(
    folder: Path, world: str, recordings: Callable[[], list[Path]]
) -> dict[str, str]:
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


def main() -> None:
    """Learn where needed, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--models", type=Path, default=Path("out/window_learning"))
    models = parser.parse_args().models
    cv2.setNumThreads(1)
    models.mkdir(parents=True, exist_ok=True)
    for test, recordings in REAL_TRAINING.items():
        path, first = RECORDINGS[test]
        for name, noise in learned_noises(models, test, partial(list, recordings)).items():
            print(head(name), flush=True)
            show(test, pv.open_sequence(path), first, noise)


if __name__ == "__main__":
    main()
