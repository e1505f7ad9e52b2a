"""``probevo paper``: the experiments of the papers, repeated in simulation."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.text import table
from probevo.experiments.blur_config import BlurConfig


@dataclass(frozen=True)
class BlurArguments:
    """What blur does to the errors of features, on a checkerboard: PROBE Fig. 5.

    Writes blur.html, a page with histograms, and blur.csv, one line for each observation of a corner.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run of the experiment left there is replaced."""
    settings: Annotated[BlurConfig, tyro.conf.arg(name="")] = field(default_factory=BlurConfig)


_Hidden = Annotated[None, tyro.conf.Suppress]
"""tyro makes no subcommands of a single type; once there is a second experiment, this can go."""


@dataclass(frozen=True)
class PaperArguments:
    """Repeat an experiment of the papers. `probevo paper EXPERIMENT --help` shows its options."""

    experiment: Annotated[
        Annotated[BlurArguments, tyro.conf.subcommand("blur")] | _Hidden,
        tyro.conf.arg(name=""),
    ]


def main(words: list[str]) -> None:
    """Parse, repeat the experiment, say what it found."""
    arguments = parse(PaperArguments, words, "paper").experiment
    if isinstance(arguments, BlurArguments):
        print("\n".join(_blur(arguments)))


def _blur(arguments: BlurArguments) -> list[str]:
    from probevo.output.files import check_folder

    check_folder(arguments.out, "--out")
    settings = checked(arguments.settings)
    import numpy as np

    from probevo.cli.progress import progress_bar
    from probevo.experiments.blur import BlurObservations, blur_views
    from probevo.experiments.blur_page import TABLE_HEAD, counts_text, table_rows, write_blur_page, write_csv
    from probevo.experiments.blur_statistics import findings, verdicts

    views = []
    with progress_bar("looking at the board", "starting (the first time of all compiles for 15 s)") as show:
        for view in blur_views(settings.instants, settings.seed):
            views.append(view)
            show(len(views), settings.instants)
    observations = BlurObservations.of(views)
    results = findings(observations, np.random.default_rng([settings.seed, 2]))
    write_csv(arguments.out / "blur.csv", observations)
    write_blur_page(arguments.out / "blur.html", views, observations, results, settings.seed)
    return [
        table(TABLE_HEAD, table_rows(results)),
        "",
        *verdicts(results),
        counts_text(views, observations),
        str(arguments.out / "blur.html"),
    ]
