"""``probevo demo``: render two simulated drives and compare the noise models on both."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import parse
from probevo.cli.text import table
from probevo.run_config import RunConfig
from probevo.training.settings import TrainSettings
from probevo_sim.scene.config import Effects, SceneConfig

if TYPE_CHECKING:
    from probevo.output.comparison import Entry

EFFECTS = Effects(traffic=0.5, shadows=0.5, noise=0.3)
"""Moderate difficulties, so that the noise of a feature varies. Blur takes too long to render."""
TRAINING = SceneConfig(preset="city", seed=1, distance_m=120, effects=EFFECTS)
"""The training drive. It has the same effects as the test drive: a model can only learn the noise
of what it has seen."""
TEST = SceneConfig(preset="city", seed=2, distance_m=120, effects=EFFECTS)
"""The test drive: a place of the same kind, as in PROBE and PROBE-GK, but with other streets."""
SCENES = {"training": TRAINING, "test": TEST}


@dataclass(frozen=True)
class DemoArguments:
    """Renders two drives through a simulated city, learns a noise model from the first drive, and
    compares it with the classical noise models on the second, whose streets it has not seen.

    Writes report.html with the comparison, probe.safetensors with the model, runs/ with the files
    of each run, and scenes/ with the images. A second demo into the same folder reuses the images.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("out/demo")
    """Folder for the scenes and the results."""


def main(words: list[str]) -> None:
    """Parse the arguments and run the demo."""
    arguments = parse(DemoArguments, words, "demo")
    from probevo.storage.lock import locked

    with locked(arguments.out):
        demo(SCENES, arguments.out)


def demo(scenes: Mapping[str, SceneConfig], out: Path) -> None:
    """Render the scenes, learn from the first, run all noise models, and write the comparison.

    Args:
        scenes: the settings of each scene, by name; the learned model runs on all but the first.
        out: folder for the images, the model, the runs and the page.

    Raises:
        InputError: ``out`` is not writable, or holds other scenes.
    """
    from probevo import __version__
    from probevo.cli.train import train_with_progress
    from probevo.noise.registry import untrained_names
    from probevo.output.comparison import Comparison, comparison_rows, verdicts
    from probevo.output.comparison_page import write_comparison
    from probevo_sim.command import render_with_progress

    if not (out / "scenes").exists():
        print(
            "The first time takes a minute: the code is compiled and the scenes are rendered.",
            flush=True,
        )
    folders = {
        name: render_with_progress(config, out / "scenes" / scene_folder(name, config))
        for name, config in scenes.items()
    }
    model = out / "probe.safetensors"
    train_with_progress(tuple(folders.values())[:1], TrainSettings(), model)
    classical = {name: name for name in untrained_names()}
    entries = []
    for number, (name, folder) in enumerate(folders.items()):
        # The learned model runs only on what it has not seen.
        learned = {"probe": str(model)} if number > 0 else {}
        for label, noise in (classical | learned).items():
            entries.append(run(name, folder, label, noise=noise, out=out))
    comparison = Comparison(tuple(entries))
    facts = {name.capitalize(): scene_text(config) for name, config in scenes.items()}
    write_comparison(
        out / "report.html",
        comparison,
        "Noise models side by side",
        facts=facts | {"probevo": __version__},
    )
    head, *rows = comparison_rows(comparison)
    print(table(head, rows))
    print()
    for sentence in verdicts(comparison):
        print(sentence)
    print(f"Drift and rotation: over pieces of 10 to 50 m.\nreport: {out / 'report.html'}")


def scene_folder(name: str, config: SceneConfig) -> str:
    """Return the folder name of a scene; it changes with the settings and with the renderer."""
    from probevo_sim.scene.writer import settings_text

    return f"{name}-{hashlib.sha256(settings_text(config).encode()).hexdigest()[:8]}"


def run(name: str, folder: Path, label: str, noise: str, out: Path) -> Entry:
    """Run one noise model over one scene."""
    from probevo.cli.run import run_with_progress
    from probevo.output.comparison import Entry
    from probevo.sequences import open_sequence

    folder_of_run = out / "runs" / f"{name}-{label}"
    config = RunConfig(sequence=folder, noise=noise)
    done = run_with_progress(open_sequence(folder), config, folder_of_run, threads=1)
    return Entry(
        name,
        label,
        done.result,
        truth=done.truth,
        metrics=done.metrics,
        pictures=done.pictures,
        report=folder_of_run / "report.html",
    )


def scene_text(config: SceneConfig) -> str:
    """Describe a scene in a few words, such as "city 2, 200 m, blur 0.3"."""
    length = [] if config.distance_m is None else [f"{config.distance_m:g} m"]
    effects = [
        f"{name} {strength:g}"
        for name, strength in config.effects.model_dump().items()
        if strength > 0
    ]
    return ", ".join([f"{config.preset} {config.seed}", *length, *effects])
