"""``probevo train``: recordings → a noise model."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.text import columns, table
from probevo.errors import InputError
from probevo.training.settings import TrainSettings

if TYPE_CHECKING:
    from probevo.noise.nearest_neighbors import NearestNeighbors


@dataclass(frozen=True)
class TrainArguments:
    """Learn from recordings how far to trust each feature (PROBE).

    Writes one file, the model; `probevo run … --noise MODEL` uses it, `probevo inspect` shows it. Stopped at any moment
    and called again with the same words, it goes on where it was; what is done so far lies in MODEL.work.
    """

    sequences: Annotated[
        tyro.conf.Positional[tuple[Path, ...]], tyro.conf.arg(metavar="SEQUENCE…", help_behavior_hint="")
    ]
    """Recordings to learn from, all of one camera: folders, or tracks files (.npz)."""
    out: Annotated[Path, tyro.conf.arg(metavar="MODEL")]
    """The model file, *.safetensors; an earlier one is replaced."""
    settings: Annotated[TrainSettings, tyro.conf.arg(name="")] = field(default_factory=TrainSettings)


def main(words: list[str]) -> None:
    """Parse and train."""
    arguments = parse(TrainArguments, words, "train")
    settings = checked(arguments.settings)
    if arguments.out.suffix != ".safetensors":
        raise InputError(
            "--out", f"is {str(arguments.out)!r}.", "Give the model file a name that ends in .safetensors."
        )
    model = train_with_progress(arguments.sequences, settings, arguments.out)
    print("\n".join(summary(model, arguments.out)))


def train_with_progress(recordings: tuple[Path, ...], settings: TrainSettings, out: Path) -> NearestNeighbors:
    """Open the recordings, learn from them, and show how far it is on stderr."""
    import cv2

    from probevo.cli.progress import progress_bar
    from probevo.noise.model_io import load_model
    from probevo.sequences import open_sequence
    from probevo.training.api import train_model

    cv2.setNumThreads(1)
    sequences = [open_sequence(path) for path in recordings]
    try:
        with progress_bar(f"training {out.name}", "starting (the first time of all compiles for 20 s)") as show:
            return load_model(train_model(sequences, settings, out, show))
    except KeyboardInterrupt as stop:
        stop.add_note(
            f"Recordings and iterations that are through are kept in {out}.work; the same command goes on from there."
        )
        raise


def summary(model: NearestNeighbors, out: Path) -> list[str]:
    """A few lines on what was learned, and how K and γ came about."""
    recordings = model.training["recordings"]
    frames = sum(recording["frames"] for recording in recordings)
    rows = [
        ("samples", f"{len(model.index_.values):,} from {frames:,} frames of {len(recordings)} recordings"),
        ("predictors", ", ".join(model.columns)),
        ("K", f"{model.neighbors}"),
        ("γ", f"{model.exponent:g}"),
    ]
    lines = [columns(rows)]
    titles = {
        "neighbors": ("K", "squared error of left-out samples", 1.0),
        "exponent": ("γ", "mean error on the training drives, mm", 1e3),
    }
    for name, search in model.training["searches"].items():
        title, meaning, factor = titles[name]
        errors = [f"{factor * error:.4g}" for error in search["errors"]]
        lines += ["", table((title, *(f"{c:g}" for c in search["candidates"])), [(meaning, *errors)])]
    if model.exponent == 0.0:
        lines += ["", "γ is 0: nothing shows that any feature is better than another; the model is the static one."]
        if model.training["settings"]["supervision"] in ("gt", "sparse"):
            lines += ["A truth that jumps from frame to frame hides it: try --supervision none."]
    return [*lines, "", f"model: {out}"]
