"""``probevo demo``: two simulated drives, each noise model on both, and one page that shows them
side by side."""

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
"""A bad day, but no disaster: enough that it matters how far each feature is trusted. Blur takes
too long to render."""
TRAINING = SceneConfig(preset="city", seed=1, distance_m=120, effects=EFFECTS)
"""What a noise model learns from. It sees the same troubles as the test: one cannot learn from what
does not happen."""
TEST = SceneConfig(preset="city", seed=2, distance_m=120, effects=EFFECTS)
"""What all are judged by: the same kind of place, as in PROBE and PROBE-GK, but none of the same
streets."""
SCENES = {"training": TRAINING, "test": TEST}


@dataclass(frozen=True)
class DemoArguments:
    """Renders two drives through a simulated city, learns a noise model from the first, and
    compares it with the classical ones on the second, whose streets it has not seen.

    Writes report.html, which shows them side by side, probe.safetensors, the model, runs/ with the
    files of each run, and scenes/ with the images; a second demo into the same folder finds these
    and need not render again.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("out/demo")
    """Folder for the scenes and the results."""


def main(words: list[str]) -> None:
    """Parse and show."""
    arguments = parse(DemoArguments, words, "demo")
    demo(SCENES, arguments.out)


def demo(scenes: Mapping[str, SceneConfig], out: Path) -> None:
    """Render the scenes, by name, into ``out``, learn from the first, run over all, print the
    table, write the page.

    Raises:
        InputError: ``out`` cannot be written to, or holds other scenes.
    """
    from probevo import __version__
    from probevo.cli.train import train_with_progress
    from probevo.files import check_folder
    from probevo.noise.registry import untrained_names
    from probevo.output.comparison import Comparison, comparison_rows
    from probevo.output.comparison_page import write_comparison
    from probevo_sim.command import render_with_progress

    check_folder(out, "--out")
    if not (out / "scenes").exists():
        print(
            "The first time of all, this takes a minute: it compiles, and renders the scenes.",
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
        estimators = classical | (
            {"probe": str(model)} if number else {}
        )  # on what it has not seen
        entries += [
            run(name, folder, label, noise=noise, out=out) for label, noise in estimators.items()
        ]
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
    print(f"\nDrift and rotation: over pieces of 10 to 50 m.\nreport: {out / 'report.html'}")


def scene_folder(name: str, config: SceneConfig) -> str:
    """Name of a scene's folder: other settings, or another renderer, go to another folder."""
    from probevo_sim.scene.writer import settings_text

    return f"{name}-{hashlib.sha256(settings_text(config).encode()).hexdigest()[:8]}"


def run(name: str, folder: Path, label: str, noise: str, out: Path) -> Entry:
    """One noise model's run over one scene."""
    from probevo.cli.run import run_with_progress
    from probevo.output.comparison import Entry
    from probevo.sequences import open_sequence

    into = out / "runs" / f"{name}-{label}"
    done = run_with_progress(
        open_sequence(folder), RunConfig(sequence=folder, noise=noise), into, threads=1
    )
    return Entry(
        name,
        label,
        done.result,
        truth=done.truth,
        metrics=done.metrics,
        pictures=done.pictures,
        report=into / "report.html",
    )


def scene_text(config: SceneConfig) -> str:
    """A scene in a few words: "city 2, 200 m, blur 0.3"."""
    length = [] if config.distance_m is None else [f"{config.distance_m:g} m"]
    effects = [
        f"{name} {strength:g}"
        for name, strength in config.effects.model_dump().items()
        if strength > 0
    ]
    return ", ".join([f"{config.preset} {config.seed}", *length, *effects])
