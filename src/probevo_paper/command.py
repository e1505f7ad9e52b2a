"""``probevo paper``: the experiments of the papers, repeated in simulation or on the recordings
they used."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo_paper import command_gk
from probevo.cli.arguments import checked, parse
from probevo.cli.text import table
from probevo.errors import InputError
from probevo_paper.blur_config import BlurConfig
from probevo_paper.table_1_2_config import Table12Config
from probevo_paper.table_1_3_config import Table13Config
from probevo_paper.table_i_config import TableIConfig

if TYPE_CHECKING:
    from probevo.cli.compare import Job
    from probevo.output.comparison import Comparison
    from probevo.output.trial_table import TrialTable
    from probevo_paper.table_i import Drive, Plan


@dataclass(frozen=True)
class BlurArguments:
    """What blur does to the errors of features, on a checkerboard: PROBE Fig. 5.

    Writes blur.html, a page with histograms, and blur.csv, one line for each observation of a
    corner.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run of the experiment left there is replaced."""
    settings: Annotated[BlurConfig, tyro.conf.arg(name="")] = field(default_factory=BlurConfig)


@dataclass(frozen=True)
class TableIArguments:
    """Trained on one drive of KITTI, run on others, beside RANSAC: PROBE Table I.

    Of its ten trials, those are run that lie in the folder together with the drive to train on.
    Writes table_i with the published figures beside ours, as .html, .csv, .json, .tex and .txt, the
    trained models/, and runs/ with the files of each run.
    """

    kitti: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder of KITTI raw: it holds 2011_09_26/2011_09_26_drive_0005_sync and others."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run of the experiment left there is replaced."""
    settings: Annotated[TableIConfig, tyro.conf.arg(name="")] = field(default_factory=TableIConfig)


@dataclass(frozen=True)
class Table12Arguments:
    """PROBE-GK trained with truth and without, beside static noise, at four kinds of place: thesis
    Table 1.2.

    The places are simulated; with --train and --test a row of your recordings is added. Writes
    table_1_2 with the published figures beside ours, as .html, .csv, .json, .tex and .txt, the
    recordings/, which a second call does not render again, the trained models/, and runs/ with the
    files of each run. All of it takes an hour, mostly training.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run of the experiment left there is replaced."""
    train: Annotated[Path | None, tyro.conf.arg(metavar="SEQUENCE", help_behavior_hint="")] = None
    """A recording of yours to train on: a folder, or a tracks file (.npz)."""
    test: Annotated[Path | None, tyro.conf.arg(metavar="SEQUENCE", help_behavior_hint="")] = None
    """Another of the same camera to test on."""
    settings: Annotated[Table12Config, tyro.conf.arg(name="")] = field(
        default_factory=Table12Config
    )


@dataclass(frozen=True)
class Table13Arguments:
    """PROBE-GK trained by EM on a loop of which no pose is known, run on others: thesis Table 1.3
    and Fig. 1.20.

    Writes table_1_3 with the published figures beside ours, as .html, which also shows how
    likelihood and loop closure go from turn to turn of EM, .csv, .json, .tex and .txt, the
    recordings/, which a second call does not render again, the trained models/, and runs/ with the
    files of each run.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run of the experiment left there is replaced."""
    loops: Annotated[
        tuple[Path, ...], tyro.conf.arg(metavar="SEQUENCE…", help_behavior_hint="")
    ] = ()
    """Recordings of yours that end where they began, or whose truth says where, instead of rendered
    ones. The first is trained on."""
    settings: Annotated[Table13Config, tyro.conf.arg(name="")] = field(
        default_factory=Table13Config
    )


@dataclass(frozen=True)
class PaperArguments:
    """Repeat an experiment of the papers. `probevo paper EXPERIMENT --help` shows its options."""

    experiment: Annotated[
        Annotated[BlurArguments, tyro.conf.subcommand("blur")]
        | Annotated[TableIArguments, tyro.conf.subcommand("table-i")]
        | Annotated[Table12Arguments, tyro.conf.subcommand("table-1.2")]
        | Annotated[Table13Arguments, tyro.conf.subcommand("table-1.3")],
        tyro.conf.arg(name=""),
    ]


def main(words: list[str]) -> None:
    """Parse, repeat the experiment, say what it found."""
    arguments = parse(PaperArguments, words, "paper").experiment
    from probevo.files import check_folder

    check_folder(arguments.out, "--out")
    if isinstance(arguments, BlurArguments):
        lines = _blur(arguments)
    elif isinstance(arguments, TableIArguments):
        lines = _table_i(arguments)
    elif isinstance(arguments, Table12Arguments):
        lines = _table_1_2(arguments)
    else:
        lines = command_gk.table_1_3(checked(arguments.settings), arguments.loops, arguments.out)
    print("\n".join(lines))


def _table_1_2(arguments: Table12Arguments) -> list[str]:
    settings = checked(arguments.settings)
    own = None
    if arguments.train is not None and arguments.test is not None:
        own = arguments.train, arguments.test
    elif arguments.train is not None or arguments.test is not None:
        given, other = ("--train", "--test") if arguments.test is None else ("--test", "--train")
        raise InputError(given, f"is given without {other}.", "A row of your own needs both.")
    return command_gk.table_1_2(settings, own, arguments.out)


def _blur(arguments: BlurArguments) -> list[str]:
    settings = checked(arguments.settings)
    import numpy as np

    from probevo.cli.progress import progress_bar
    from probevo_paper.blur import BlurObservations, blur_views
    from probevo_paper.blur_page import (
        TABLE_HEAD,
        counts_text,
        table_rows,
        write_blur_page,
        write_csv,
    )
    from probevo_paper.blur_statistics import findings, verdicts

    views = []
    with progress_bar(
        "looking at the board", "starting (compiling, if this is the first time)"
    ) as show:
        for view in blur_views(settings.instants, settings.seed):
            views.append(view)
            show(len(views), settings.instants)
    observations = BlurObservations.of(views)
    results = findings(observations, np.random.default_rng([settings.seed, 2]))
    write_csv(arguments.out / "blur.csv", observations)
    write_blur_page(
        arguments.out / "blur.html", views, observations, results=results, seed=settings.seed
    )
    return [
        table(TABLE_HEAD, table_rows(results)),
        "",
        *verdicts(results),
        counts_text(views, observations),
        str(arguments.out / "blur.html"),
    ]


def _table_i(arguments: TableIArguments) -> list[str]:
    settings = checked(arguments.settings)
    arguments = replace(arguments, settings=settings)
    from probevo.cli.compare import run_all
    from probevo_paper.table_i import TRIALS, plan_table
    from probevo_paper.table_i_files import table_of, write_table

    plan = plan_table(arguments.kitti)
    _table_i_jobs(plan, {}, arguments)  # what can be checked before the training
    print(f"{len(plan.trials)} of {len(TRIALS)} trials can be run.", flush=True)
    jobs = _table_i_jobs(plan, _train(plan, arguments), arguments)

    def write(done: Comparison) -> None:
        trials = table_of(done, plan, settings.max_frames)
        write_table(arguments.out, done, trials, text=_trials_text(trials))

    comparison = run_all(jobs, 1, write, out=arguments.out)
    return [
        _trials_text(table_of(comparison, plan, settings.max_frames)),
        str(arguments.out / "table_i.html"),
    ]


def _train(plan: Plan, arguments: TableIArguments) -> dict[tuple[Drive, str], Path]:
    """The model file of each training drive, trained as published and as we would, with the
    settings of the runs.

    We do without the truth of KITTI, whose centimetres from frame to frame hide what single
    features do.
    """
    from probevo.cli.train import train_with_progress
    from probevo_paper.table_i import trainings

    ways = trainings(arguments.settings)
    models = {}
    for drive, (name, settings) in product(plan.trainings, ways.items()):
        file = arguments.out / "models" / f"{drive.name}-{name.replace(', ', '-')}.safetensors"
        train_with_progress((arguments.kitti / drive.folder,), settings, file)
        models[drive, name] = file
    return models


def _table_i_jobs(
    plan: Plan, models: dict[tuple[Drive, str], Path], arguments: TableIArguments
) -> list[Job]:
    """The runs, those of PROBE only where its model is there."""
    from probevo.cli import compare
    from probevo.sequences import open_sequence
    from probevo_paper.table_i import AGGRESSIVE, NOMINAL, OURS, PROBE, STUDENT_T, probe_settings

    settings = arguments.settings
    classical = [
        compare.Estimator(NOMINAL, "fixed", settings),
        compare.Estimator(AGGRESSIVE, "fixed", compare.aggressive(settings)),
        compare.Estimator(STUDENT_T, "student-t", settings),
    ]
    jobs = []
    for trial in plan.trials:
        sequence = open_sequence(arguments.kitti / trial.drive.folder, "kitti-raw")
        estimators = list(classical)
        for name, chosen in ((PROBE, probe_settings(settings)), (OURS, settings)):
            if (trial.training, name) in models:
                estimators.append(
                    compare.Estimator(name, str(models[trial.training, name]), chosen)
                )
        jobs += compare.plan(
            [compare.Recording(trial.drive.name, sequence)], estimators, arguments.out
        )
    return jobs


def _trials_text(trials: TrialTable) -> str:
    return command_gk.table_text(trials, "ARMSE / final error, m.")
