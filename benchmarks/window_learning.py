"""Learn noise without truth, and compare it with the untrained in the window: docs/window.md.

    python benchmarks/window_learning.py [--of rendered real] [--models out/window_learning]

The static Student-t and generalized kernels are learned from a rendered city, clean and with
effects, and tested on the streets of ``window.py``, which are other places; and from raw 0005 and
``kitti_0039``, tested on odometry 06. Prints the table of ``window.py`` for the untrained and for
both learned models, with both estimators.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import cv2
from recordings import ROOT
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
REAL_TRAINING = (
    ROOT / "kitti_raw" / "2011_09_26" / "2011_09_26_drive_0005_sync",
    ROOT / "kitti_0039" / "sequences" / "39",
)
REAL_TEST = ROOT / "kitti_odometry" / "sequences" / "06"
FIRST_TRUE_FRAME = 12
"""The truth of odometry 06 is filled in before it."""


def noises(folder: Path, world: str, recordings: list[Path]) -> dict[str, str]:
    """Return the noise models by their names, and learn those that the folder does not have."""
    found = {UNTRAINED: UNTRAINED}
    for name, settings in TRAININGS.items():
        file = folder / f"{world} {name}.safetensors".replace(" ", "-")
        if not file.is_file():
            pv.train_model(recordings, settings, file)
        found[name] = str(file)
    return found


def rendered_streets(folder: Path) -> list[Path]:
    """Render the streets to learn from."""
    for number, config in enumerate(TRAINING_STREETS):
        write_scene(config, folder / str(number), jobs=2)
    return [folder / str(number) for number in range(len(TRAINING_STREETS))]


def main() -> None:
    """Learn where needed, and print the tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument(
        "--of", nargs="+", choices=("rendered", "real"), default=["rendered", "real"]
    )
    parser.add_argument("--models", type=Path, default=Path("out/window_learning"))
    arguments = parser.parse_args()
    cv2.setNumThreads(1)
    arguments.models.mkdir(parents=True, exist_ok=True)
    for world in arguments.of:
        with tempfile.TemporaryDirectory() as folder:
            if world == "rendered":
                recordings = rendered_streets(Path(folder))
            else:
                recordings = list(REAL_TRAINING)
            models = noises(arguments.models, world, recordings)
        for name, noise in models.items():
            print(head(name), flush=True)
            if world == "rendered":
                show_scenes(noise)
            else:
                show(
                    "odometry 06 from frame 12",
                    pv.open_sequence(REAL_TEST),
                    FIRST_TRUE_FRAME,
                    noise,
                )


if __name__ == "__main__":
    main()
