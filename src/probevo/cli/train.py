"""``probevo train``: recordings → a noise model."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.train_summary import summary
from probevo.errors import InputError
from probevo.training.settings import TrainSettings

if TYPE_CHECKING:
    from probevo.noise.model_io import Learned


@dataclass(frozen=True)
class TrainArguments:
    """Learn from recordings how far to trust each feature (PROBE, PROBE-GK).

    Writes one file, the model; `probevo run … --noise MODEL` uses it, `probevo inspect` shows it.
    Stopped at any moment and called again with the same words, it goes on after the last recording
    that was through, and after the last iteration; what is done so far
    lies in MODEL.work.

    What kind of model it is, --kind says. The options from --base to --exponent are for knn alone,
    those of the section gk for the other two; a kind refuses what it has no use for.
    """

    sequences: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="SEQUENCE…", help_behavior_hint=""),
    ]
    """Recordings to learn from, all of one camera: folders, or tracks files (.npz)."""
    out: Annotated[Path, tyro.conf.arg(metavar="MODEL")]
    """The model file, *.safetensors; an earlier one is replaced."""
    jobs: int = 1
    """Processes that go through the recordings, one each; 0 takes all cores. The model is the same.
    """
    cluster: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = ""
    """Leave that to the workers of a Dask cluster, by the address of its scheduler, such as
    tcp://10.0.0.1:8786. They must see recordings and MODEL.work under the same paths."""
    settings: Annotated[TrainSettings, tyro.conf.arg(name="")] = field(
        default_factory=TrainSettings
    )


def main(words: list[str]) -> None:
    """Parse and train."""
    arguments = parse(TrainArguments, words, "train")
    settings = checked(arguments.settings)
    if arguments.out.suffix != ".safetensors":
        raise InputError(
            "--out",
            f"is {str(arguments.out)!r}.",
            "Give the model file a name that ends in .safetensors.",
        )
    if arguments.jobs < 0:
        raise InputError(
            "--jobs", f"is {arguments.jobs}.", "Give the number of processes, or 0 for all cores."
        )
    if arguments.cluster and arguments.jobs != 1:
        raise InputError(
            "--jobs",
            "means nothing with --cluster, all of whose workers work.",
            "Leave one of them out.",
        )
    model = train_with_progress(
        arguments.sequences, settings, arguments.out, jobs=arguments.jobs, cluster=arguments.cluster
    )
    print("\n".join(summary(model, arguments.out)))


def train_with_progress(
    recordings: tuple[Path, ...],
    settings: TrainSettings,
    out: Path,
    jobs: int = 1,
    cluster: str = "",
) -> Learned:
    """Learn from recordings, and show how far it is on stderr."""
    import cv2

    from probevo.cli.first_use import getting_ready
    from probevo.cli.progress import progress_bar
    from probevo.noise.model_io import load_model
    from probevo.training.api import train_model
    from probevo.training.workers import Workers

    cv2.setNumThreads(1)
    workers = Workers(jobs, cluster)
    try:
        with progress_bar(f"training {out.name}", getting_ready()) as show:
            return load_model(
                train_model(recordings, settings, out, on_progress=show, workers=workers)
            )
    except KeyboardInterrupt as stop:
        stop.add_note(
            f"Recordings and iterations that are through are kept in {out}.work; the same command"
            " goes on from there."
        )
        raise
