"""``probevo train``: learn a noise model, or a sensor, from recordings."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.train_summary import few_frames_warning, summary
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.sensor_kinds import SENSOR_KINDS, SensorKind, trainer_of_sensor
from probevo.sequences.read_settings import ReadSettings

if TYPE_CHECKING:
    from probevo.noise.base import LearnedNoiseModel
    from probevo.training.sources import Recording


@dataclass(frozen=True)
class TrainArguments:
    """Learn a noise model for the features from recordings (PROBE, PROBE-GK).

    Writes one file, the model. `probevo run … --noise MODEL` uses it, `probevo inspect` shows it.
    Training can be interrupted at any moment. The same command then continues after the last
    finished recording, and after the last finished iteration; the work so far is in MODEL.work.

    --kind chooses the model. The options from --base to --exponent are only for knn, those of the
    section gk for the other two kinds; an option that a kind does not use is refused.

    --kind rotation, correction and sun learn a sensor instead, for `probevo run … --sensor MODEL`
    (extra nets). Its options are those of the section nets, and for correction those of the
    odometry. The recordings named last are left out, to calibrate it.
    """

    sequences: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="SEQUENCE…", help_behavior_hint=""),
    ]
    """Recordings to learn from, all of one camera: folders, bags, or tracks files (.npz)."""
    out: Annotated[Path, tyro.conf.arg(metavar="MODEL")]
    """The model file, *.safetensors; an existing one is replaced."""
    jobs: int = 1
    """Processes, each of which takes one recording at a time; 0 uses all cores. The model does not
    depend on it."""
    cluster: Annotated[str, tyro.conf.arg(metavar="ADDRESS")] = ""
    """Address of the scheduler of a Dask cluster, such as tcp://10.0.0.1:8786, whose workers take
    the place of the processes. They must see the recordings and MODEL.work under the same paths."""
    settings: Annotated[TrainSettings, tyro.conf.arg(name="")] = field(
        default_factory=TrainSettings
    )
    reading: Annotated[ReadSettings, tyro.conf.arg(name="")] = field(default_factory=ReadSettings)


def main(words: list[str]) -> None:
    """Parse the arguments and train."""
    arguments = parse(TrainArguments, words, "train")
    settings = checked(arguments.settings)
    reading = checked(arguments.reading)
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
            "has no meaning with --cluster, which uses all workers of the cluster.",
            "Remove one of the two flags.",
        )
    recordings = recordings_of(arguments.sequences, reading)
    if settings.kind in SENSOR_KINDS:
        if arguments.jobs != 1 or arguments.cluster:
            what = f"--kind {settings.kind} is trained in one process."
            raise InputError("--jobs and --cluster", what, "Leave them out.")
        kind = SENSOR_KINDS[settings.kind]
        lines = train_sensor_with_progress(kind, recordings, settings, arguments.out)
        print("\n".join(lines))
        return
    model = train_with_progress(
        recordings, settings, arguments.out, jobs=arguments.jobs, cluster=arguments.cluster
    )
    print("\n".join(summary(model, arguments.out)))
    warning = few_frames_warning(model)
    if warning:
        print(f"probevo: warning: {warning}", file=sys.stderr)


def recordings_of(paths: tuple[Path, ...], reading: ReadSettings) -> tuple[Recording, ...]:
    """Return the recordings at these paths, all of them to be opened with the same options."""
    from probevo.training.sources import RecordingAt

    options = reading.format_options()
    if reading.format is None and not options:
        return paths
    return tuple(RecordingAt(path, reading.format, options) for path in paths)


def train_sensor_with_progress(
    kind: SensorKind, recordings: tuple[Recording, ...], settings: TrainSettings, out: Path
) -> list[str]:
    """Learn a sensor from recordings with a progress bar on stderr; return the lines to print."""
    import cv2

    from probevo.cli.progress import progress_bar
    from probevo.training.settings_check import check_sensor_settings
    from probevo.training.sources import opened

    check_sensor_settings(settings)
    train = trainer_of_sensor(kind)
    further = {name: getattr(settings, name) for name in kind.settings}
    cv2.setNumThreads(1)
    sequences = [opened(recording) for recording in recordings]
    try:
        with progress_bar(f"training {out.name}", "reading the recordings") as show:
            lines: list[str] = train(
                sequences,
                settings.nets,
                out,
                max_frames=settings.max_frames,
                on_progress=show,
                **further,
            )
    except KeyboardInterrupt as stop:
        stop.add_note(
            f"What was done is kept in {out}.work; the same command continues from there."
        )
        raise
    # What was learned from the steps of an estimator is for the steps of the same.
    estimator = f"--estimator {settings.odometry.estimator} " if "odometry" in further else ""
    following = f"next: probevo run SEQUENCE --sensor {out} {estimator}--out DIR"
    return [*lines, "", f"sensor: {out}", following]


def train_with_progress(
    recordings: tuple[Recording, ...],
    settings: TrainSettings,
    out: Path,
    jobs: int = 1,
    cluster: str = "",
) -> LearnedNoiseModel:
    """Learn a noise model from recordings with a progress bar on stderr."""
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
            path = train_model(recordings, settings, out, on_progress=show, workers=workers)
            return load_model(path)
    except KeyboardInterrupt as stop:
        stop.add_note(
            f"Finished recordings and iterations are kept in {out}.work; the same command continues"
            " from there."
        )
        raise
