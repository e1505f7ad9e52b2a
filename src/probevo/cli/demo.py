"""``probevo demo``: render two simulated drives and compare the noise models on both."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import parse
from probevo.cli.text import columns
from probevo.config.training import TrainSettings
from probevo.output.run_files import REPORT
from probevo.run_config import RunConfig
from probevo_sim.scene.config import Effects, SceneConfig

if TYPE_CHECKING:
    from probevo.noise.registry import NoiseKind
    from probevo.output.comparison.comparison import Entry

EFFECTS = Effects(traffic=0.5, shadows=0.5, noise=0.3)
"""Moderate difficulties, so that the noise of a feature varies. Blur takes too long to render."""
TRAINING = SceneConfig(preset="city", seed=1, distance_m=120, effects=EFFECTS)
"""The training drive. It has the same effects as the test drive: a model can only learn the noise
of what it has seen."""
TEST = SceneConfig(preset="city", seed=2, distance_m=120, effects=EFFECTS)
"""The test drive: a place of the same kind, as in PROBE and PROBE-GK, but with other streets."""
SCENES = {"training": TRAINING, "test": TEST}
CAUTION = (
    "This is one short drive, and other streets rank the models differently: docs/probe-gk.md has"
    " the means over several."
)


@dataclass(frozen=True)
class DemoArguments:
    """Renders two drives through a simulated city, learns a noise model of each kind from the first
    drive, and compares them with the classical ones on the second, whose streets they have not
    seen: a fitted Student-t, PROBE (knn) and PROBE-GK (gk).

    Writes report.html with the comparison, a model file of each kind, runs/ with the files of each
    run, and scenes/ with the images. A second demo into the same folder reuses the images.
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
        scenes: the settings of each scene, by name; learned models run on all but the first.
        out: folder for the images, the models, the runs and the page.

    Raises:
        InputError: ``out`` is not writable, or holds other scenes.
    """
    from probevo import __version__
    from probevo.cli.train import train_with_progress
    from probevo.noise.registry import noise_kinds, untrained_names
    from probevo.output.comparison.comparison import (
        Comparison,
        column_notes,
        comparison_table,
        verdicts,
    )
    from probevo.output.comparison.comparison_page import write_comparison
    from probevo.output.comparison.learning_gain import learning_gains
    from probevo_sim.command import render_with_progress
    from probevo_sim.scene.writer import scene_folder

    if not (out / "scenes").exists():
        print(
            "The first time takes three to five minutes: the code is compiled, the scenes are"
            " rendered, and three models are learned.",
            flush=True,
        )
    folders = {
        name: render_with_progress(config, out / "scenes" / scene_folder(name, config))
        for name, config in scenes.items()
    }
    training = next(iter(folders))
    learned = {}
    for kind in noise_kinds().values():
        if kind.trainer:
            label = learned_label(kind)
            learned[label] = str(out / f"{file_name(label)}.safetensors")
            settings = TrainSettings(kind=kind.name)
            train_with_progress((folders[training],), settings, Path(learned[label]))
    classical = {name: name for name in untrained_names()}
    entries = []
    for name, folder in folders.items():
        # The learned models run only on what they have not seen.
        models = classical if name == training else classical | learned
        for label, noise in models.items():
            entries.append(run(name, folder, label, noise=noise, out=out))
    comparison = Comparison(tuple(entries))
    gains = learning_gains(comparison, RunConfig.model_fields["noise"].default, tuple(learned))
    facts = {name.capitalize(): scene_text(config) for name, config in scenes.items()}
    kinds = noise_summaries(training)
    write_comparison(
        out / "report.html",
        comparison,
        "Noise models side by side",
        facts=facts | kinds | {"probevo": __version__},
        remarks=(*gains, CAUTION),
    )
    print(comparison_table(comparison).as_text())
    print(f"\n{columns(kinds.items())}\n")
    for line in (*verdicts(comparison), *gains, CAUTION):
        print(line)
    print("Drift and rotation: over segments of 10 to 50 m.")
    for note in column_notes(comparison):
        print(note)
    print(f"report: {out / 'report.html'}")


def learned_label(kind: NoiseKind) -> str:
    """Name a learned model by its kind; one whose kind works untrained, too, is "fitted"."""
    return kind.name if kind.untrained is None else f"fitted {kind.name}"


def noise_summaries(training: str) -> dict[str, str]:
    """Describe each noise model of the demo in a line, by the name that it has in the table."""
    from probevo.noise.registry import noise_kinds

    kinds = noise_kinds().values()
    classical = {kind.name: kind.summary for kind in kinds if kind.untrained is not None}
    learned = {
        learned_label(kind): f"{kind.summary}; learned from {training}"
        for kind in kinds
        if kind.trainer
    }
    return classical | learned


def file_name(label: str) -> str:
    """Turn the name of a noise model into one that needs no quotes in a shell."""
    return label.replace(" ", "-")


def run(name: str, folder: Path, label: str, noise: str, out: Path) -> Entry:
    """Run one noise model over one scene."""
    from probevo.cli.run import run_with_progress
    from probevo.output.comparison.comparison import Entry
    from probevo.sequences import open_sequence

    folder_of_run = out / "runs" / f"{name}-{file_name(label)}"
    config = RunConfig(sequence=folder, noise=noise)
    done = run_with_progress(open_sequence(folder), config, folder_of_run, threads=1)
    return Entry(
        name,
        label,
        done.result,
        truth=done.truth,
        metrics=done.metrics,
        pictures=done.pictures,
        report=folder_of_run / REPORT,
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
