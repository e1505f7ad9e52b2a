"""``probevo paper``: reads the command line, and repeats the experiment that it names."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from probevo.cli.arguments import checked, parse_one_of
from probevo.errors import InputError
from probevo_paper.dpc_net_config import DpcNetConfig
from probevo_paper.figure_5_config import BlurConfig
from probevo_paper.hydranet_config import HydranetConfig
from probevo_paper.sun_config import SunConfig
from probevo_paper.table_1_2_config import Table12Config
from probevo_paper.table_1_3_config import Table13Config
from probevo_paper.table_i_config import TableIConfig


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
    """PROBE-GK trained with and without truth at four kinds of place: thesis Table 1.2.

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
    """PROBE-GK trained by EM on one loop without truth, run on others: thesis Table 1.3.

    Writes table_1_3 with the published figures beside ours, as .html, which also shows likelihood
    and loop closure error over the iterations of EM (thesis Fig. 1.20), .csv, .json, .tex and .txt,
    the recordings/, which a second call does not render again, the trained models/, and runs/ with
    the files of each run.
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
class SunArguments:
    """What a simulated sun sensor takes off the drift: thesis section 5.7.

    With 0°, 10°, 20° and 30° of noise in every first, fifth and tenth frame, beside the Cramér–Rao
    bound, and with sensors that lie. Writes sun.csv, sun.json and sun.txt.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run of the experiment left there is replaced."""
    settings: Annotated[SunConfig, tyro.conf.arg(name="")] = field(default_factory=SunConfig)


@dataclass(frozen=True)
class HydranetArguments:
    """Networks that know how wrong they are, beside dropout and ensembles: thesis chapter 7.

    Needs the extra nets. Writes hydranet with both tables as .txt, each repetition as .csv and
    .json, and the networks into models/; a second call goes on where the first was stopped.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run of the experiment left there is replaced."""
    settings: Annotated[HydranetConfig, tyro.conf.arg(name="")] = field(
        default_factory=HydranetConfig
    )


@dataclass(frozen=True)
class DpcNetArguments:
    """Motions corrected by a network, with a right and a wrong calibration: thesis chapter 6.

    Beside the mean correction, a linear regression, and the ablation that corrects rotations alone.
    Needs the extra nets. Writes dpc_net as .txt, .csv and .json, recordings/ and models/, which a
    second call takes as they are.
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run of the experiment left there is replaced."""
    settings: Annotated[DpcNetConfig, tyro.conf.arg(name="")] = field(default_factory=DpcNetConfig)


@dataclass(frozen=True)
class PaperArguments:
    """Repeat an experiment of the papers. `probevo paper EXPERIMENT --help` shows its options."""

    experiment: Annotated[
        Annotated[BlurArguments, tyro.conf.subcommand("blur")]
        | Annotated[TableIArguments, tyro.conf.subcommand("table-i")]
        | Annotated[Table12Arguments, tyro.conf.subcommand("table-1.2")]
        | Annotated[Table13Arguments, tyro.conf.subcommand("table-1.3")]
        | Annotated[SunArguments, tyro.conf.subcommand("sun")]
        | Annotated[HydranetArguments, tyro.conf.subcommand("hydranet")]
        | Annotated[DpcNetArguments, tyro.conf.subcommand("dpc-net")],
        tyro.conf.arg(name=""),
    ]


Experiment = (
    BlurArguments
    | TableIArguments
    | Table12Arguments
    | Table13Arguments
    | SunArguments
    | HydranetArguments
    | DpcNetArguments
)
EXPERIMENTS: dict[str, type[Experiment]] = {
    "blur": BlurArguments,
    "table-i": TableIArguments,
    "table-1.2": Table12Arguments,
    "table-1.3": Table13Arguments,
    "sun": SunArguments,
    "hydranet": HydranetArguments,
    "dpc-net": DpcNetArguments,
}


def main(words: list[str]) -> None:
    """Parse the words after ``probevo paper``, repeat the experiment, and print its results."""
    arguments = parse_one_of(EXPERIMENTS, words, "paper", PaperArguments)
    from probevo.storage.lock import locked

    with locked(arguments.out):
        lines = _repeat(arguments)
    print("\n".join(lines))


def _repeat(arguments: Experiment) -> list[str]:
    """Repeat the experiment, and return the lines to print."""
    # The experiments are imported here, since help and mistakes should not wait for OpenCV.
    if isinstance(arguments, BlurArguments):
        return _figure_5(arguments)
    if isinstance(arguments, TableIArguments):
        return _table_i(arguments)
    if isinstance(arguments, Table12Arguments):
        return _table_1_2(arguments)
    if isinstance(arguments, SunArguments):
        return _sun(arguments)
    if isinstance(arguments, HydranetArguments):
        return _hydranet(arguments)
    if isinstance(arguments, DpcNetArguments):
        return _dpc_net(arguments)
    return _table_1_3(arguments)


def _hydranet(arguments: HydranetArguments) -> list[str]:
    settings = checked(arguments.settings)
    from probevo_paper.command_hydranet import repeat_experiments

    return repeat_experiments(settings, arguments.out)


def _dpc_net(arguments: DpcNetArguments) -> list[str]:
    settings = checked(arguments.settings)
    from probevo.nets.extra import require_nets

    require_nets("paper dpc-net")  # before what needs it is imported
    from probevo_paper.command_dpc_net import repeat_experiment

    return repeat_experiment(settings, arguments.out)


def _sun(arguments: SunArguments) -> list[str]:
    settings = checked(arguments.settings)
    from probevo_paper.command_sun import repeat_experiment

    return repeat_experiment(settings, arguments.out)


def _figure_5(arguments: BlurArguments) -> list[str]:
    settings = checked(arguments.settings)
    from probevo_paper.command_figure_5 import repeat_figure

    return repeat_figure(settings, arguments.out)


def _table_i(arguments: TableIArguments) -> list[str]:
    settings = checked(arguments.settings)
    from probevo_paper.command_table_i import repeat_table

    return repeat_table(settings, arguments.kitti, arguments.out)


def _table_1_2(arguments: Table12Arguments) -> list[str]:
    settings = checked(arguments.settings)
    own = None
    if arguments.train is not None and arguments.test is not None:
        own = arguments.train, arguments.test
    elif arguments.train is not None:
        raise InputError("--train", "is given without --test.", "A row of your own needs both.")
    elif arguments.test is not None:
        raise InputError("--test", "is given without --train.", "A row of your own needs both.")
    from probevo_paper.command_table_1_2 import repeat_table

    return repeat_table(settings, own, arguments.out)


def _table_1_3(arguments: Table13Arguments) -> list[str]:
    settings = checked(arguments.settings)
    from probevo_paper.command_table_1_3 import repeat_table

    return repeat_table(settings, arguments.loops, arguments.out)
