"""``probevo compare``: run several estimators on several recordings and compare them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.run import default_common_settings
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.output.run_files import REPORT
from probevo.run_config import CommonRunSettings, RunConfig, run_config
from probevo.sequences.read_settings import ReadSettings

if TYPE_CHECKING:
    from probevo import sequences
    from probevo.output.comparison.comparison import Comparison, Entry

AGGRESSIVE = "aggressive"
AGGRESSIVE_CONFIDENCE = 0.9999
"""Confidence of RANSAC in the aggressive estimator of PROBE; that of the nominal one is 0.99."""


@dataclass(frozen=True)
class CompareArguments:
    """Runs every estimator on every recording, and compares them.

    Writes comparison.html with tables and figures, comparison.csv and .json with all metrics,
    table.tex in the form of PROBE Table I, and runs/ with the files of each run. The settings are
    the same for all runs. Flags override the file given by --config, whose recording, noise model
    and learned sensors are ignored, and that overrides the defaults.
    """

    sequences: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="SEQUENCE…", help_behavior_hint=""),
    ]
    """Folders of the recordings, bags, or tracks files (.npz). How to open them holds for all."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. Files of the same name are replaced; runs of earlier comparisons are
    kept."""
    noise: Annotated[tuple[str, ...], tyro.conf.arg(metavar="MODEL…")] = ("fixed", "student-t")
    """The estimators: fixed, student-t and model files (.safetensors), as in `probevo run`, and
    aggressive, which is fixed with RANSAC at a confidence of 0.9999. With the default settings,
    fixed and aggressive are the nominal and the aggressive estimator of PROBE."""
    sensor: Annotated[tuple[Path, ...], tyro.conf.arg(metavar="MODEL…", help_behavior_hint="")] = ()
    """Learned sensors, as in `probevo run`: each estimator runs without them, and with all of
    them."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Settings as YAML, such as the config.yaml of an earlier run."""
    threads: int = 1
    """Threads of OpenCV. Two save a tenth of the time, more save nothing. Results do not change."""
    settings: Annotated[CommonRunSettings, tyro.conf.arg(name="")] = field(
        default_factory=CommonRunSettings
    )


@dataclass(frozen=True)
class Recording:
    """A recording to run on."""

    name: str
    """Unique within the comparison."""
    sequence: sequences.Sequence


@dataclass(frozen=True)
class Estimator:
    """A noise model with the settings of its runs."""

    name: str
    """Unique within the comparison."""
    noise: str
    """A name or a model file, as for --noise of ``probevo run``."""
    settings: OdometryConfig
    sensors: tuple[Path, ...] = ()
    """Files of learned sensors."""


@dataclass(frozen=True)
class Job:
    """One run of a comparison."""

    recording: Recording
    estimator: Estimator
    config: RunConfig
    out: Path
    """Folder for its files."""
    learned_from_it: bool
    """Whether the noise model or a sensor was learned from this recording."""


def main(words: list[str]) -> None:
    """Parse the arguments, check everything, run, and write the comparison."""
    common = default_common_settings(words)
    default = CompareArguments(sequences=tyro.MISSING, out=tyro.MISSING, settings=common)
    arguments = parse(CompareArguments, words, "compare", default=default)
    settings = checked(arguments.settings)
    if arguments.threads < 1:
        raise InputError("--threads", f"is {arguments.threads}.", "It must be at least 1.")
    from probevo.storage.lock import locked

    with locked(arguments.out):
        recordings = open_recordings(arguments.sequences, settings)
        estimators = estimators_of(arguments.noise, settings)
        if arguments.sensor:
            estimators = with_sensors(estimators, arguments.sensor)
        jobs = plan(recordings, estimators, arguments.out)
        comparison = run_all(
            jobs, arguments.threads, lambda done: _write(arguments.out, done), out=arguments.out
        )
    print("\n".join(_summary(comparison, arguments.out)))


def open_recordings(paths: Sequence[Path], settings: ReadSettings | None = None) -> list[Recording]:
    """Open the recordings and give each a unique name.

    Raises:
        InputError: none is given, or one is given twice, is too short, or cannot be opened, or one
            truth is given for several.
    """
    from probevo.output.comparison.comparison import distinct_labels
    from probevo.sequences import open_sequence

    _refuse_twice("SEQUENCE", [(str(path), str(path.resolve())) for path in paths])
    if not paths:
        raise InputError(
            "SEQUENCE",
            "no recording is named.",
            "Give one or more: `probevo compare SEQUENCE --out DIR`.",
        )
    settings = settings or ReadSettings()
    if settings.truth is not None and len(paths) > 1:
        what = f"{settings.truth} would be the truth of {len(paths)} recordings."
        cure = "Put a poses.txt into the folder of each, or compare on one at a time."
        raise InputError("--truth", what, cure)
    opened = [open_sequence(path, settings.format, **settings.format_options()) for path in paths]
    for sequence in opened:
        if len(sequence) < 2:
            what = "has only one frame, and so no motion to compare."
            raise InputError(sequence.path, what, "Leave it out.")
    names = distinct_labels(paths)
    return [Recording(name, sequence) for name, sequence in zip(names, opened, strict=True)]


def estimators_of(specs: Sequence[str], settings: CommonRunSettings) -> list[Estimator]:
    """Return the estimators that --noise names.

    Raises:
        InputError: none is given, or one is given twice.
    """
    from probevo.noise.named import portable
    from probevo.noise.registry import untrained_names
    from probevo.output.comparison.comparison import distinct_labels

    names = (*untrained_names(), AGGRESSIVE)
    _refuse_twice("--noise", [(spec, spec if spec in names else portable(spec)) for spec in specs])
    if not specs:
        raise InputError(
            "--noise",
            "no estimator is named.",
            f"Give one or more of {', '.join(names)}, or model files.",
        )
    # Model files are called by their names, and by as much of their paths as tells them apart.
    files = [Path(spec) for spec in specs if spec not in names]
    labels = dict(zip(files, distinct_labels(files, taken=names), strict=True))
    estimators = []
    for spec in specs:
        if spec == AGGRESSIVE:
            estimators.append(Estimator(AGGRESSIVE, "fixed", aggressive(settings)))
        elif spec in names:
            estimators.append(Estimator(spec, spec, settings))
        else:
            estimators.append(Estimator(labels[Path(spec)], spec, settings))
    return estimators


def with_sensors(estimators: Sequence[Estimator], sensors: tuple[Path, ...]) -> list[Estimator]:
    """Return each estimator without and with the sensors."""
    names = " + ".join(path.stem for path in sensors)
    pairs = []
    for estimator in estimators:
        fused = replace(estimator, name=f"{estimator.name} + {names}", sensors=sensors)
        pairs += [estimator, fused]
    return pairs


def aggressive(settings: OdometryConfig) -> OdometryConfig:
    """Return the settings with the RANSAC confidence of PROBE's aggressive estimator."""
    ransac = settings.ransac.model_copy(update={"confidence": AGGRESSIVE_CONFIDENCE})
    return settings.model_copy(update={"ransac": ransac})


def plan(recordings: Sequence[Recording], estimators: Sequence[Estimator], out: Path) -> list[Job]:
    """Return one job for every estimator on every recording; all of them are checked.

    Args:
        recordings: the recordings.
        estimators: the estimators.
        out: folder of the comparison; each job writes into a folder of its own in ``out/runs``.

    Raises:
        InputError: a noise model is unknown or cannot be loaded, or a model or a setting does not
            fit a recording; a sensor cannot be loaded, or does not fit the camera.
    """
    from probevo.noise.named import noise_model, portable
    from probevo.noise.origin import learned_from
    from probevo.output.comparison.comparison import numbered
    from probevo.run_checks import check_run
    from probevo.sensor_kinds import load_sensors, recordings_of_file
    from probevo.sequences.content import is_among

    models = {
        estimator.name: noise_model(estimator.noise, others=(AGGRESSIVE,))
        for estimator in estimators
    }
    seen = {
        estimator.name: (
            *learned_from(models[estimator.name]),
            *chain.from_iterable(map(recordings_of_file, estimator.sensors)),
        )
        for estimator in estimators
    }
    pairs = [(recording, estimator) for recording in recordings for estimator in estimators]
    folders = numbered([f"{recording.name}-{estimator.name}" for recording, estimator in pairs])
    jobs = []
    for (recording, estimator), folder in zip(pairs, folders, strict=True):
        path = recording.sequence.path.resolve()
        config = run_config(estimator.settings, path, portable(estimator.noise))
        if estimator.sensors:
            load_sensors(estimator.sensors, recording.sequence)
            absolute = tuple(sensor.resolve() for sensor in estimator.sensors)
            config = config.model_copy(update={"sensor": absolute})
        check_run(recording.sequence, config, models[estimator.name])
        jobs.append(
            Job(
                recording,
                estimator,
                config,
                out=out / "runs" / folder,
                learned_from_it=is_among(recording.sequence, seen[estimator.name]),
            )
        )
    return jobs


def run_all(
    jobs: Sequence[Job], threads: int, write: Callable[[Comparison], None], out: Path
) -> Comparison:
    """Run all jobs, one after another, and write their comparison.

    If anything stops a job, the comparison of the finished ones is written, and the exception is
    raised again with a note that tells where it is.

    Args:
        jobs: the runs.
        threads: threads of OpenCV.
        write: writes the comparison into ``out``.
        out: folder of the comparison, for the note.
    """
    from probevo.output.comparison.comparison import Comparison

    entries: list[Entry] = []
    try:
        for number, job in enumerate(jobs, start=1):
            entries.append(_run(job, threads, f"{number} of {len(jobs)}: "))
    except BaseException as stop:  # whatever it is, such as Ctrl-C or a damaged image
        if entries:
            write(Comparison(tuple(entries)))
            stop.add_note(
                f"{len(entries)} of {len(jobs)} runs were finished; they are compared in {out}."
            )
        raise
    comparison = Comparison(tuple(entries))
    write(comparison)
    return comparison


def _run(job: Job, threads: int, prefix: str) -> Entry:
    """Run one job; the prefix says which of all jobs it is."""
    from probevo.cli.run import run_with_progress
    from probevo.output.comparison.comparison import Entry

    done = run_with_progress(
        job.recording.sequence,
        job.config,
        job.out,
        threads=threads,
        name=f"{prefix}{job.recording.name} {job.estimator.name}",
    )
    return Entry(
        job.recording.name,
        job.estimator.name,
        done.result,
        truth=done.truth,
        metrics=done.metrics,
        pictures=done.pictures,
        report=job.out / REPORT,
        config=job.config,
        learned_from_it=job.learned_from_it,
    )


def _write(out: Path, comparison: Comparison) -> None:
    from probevo import __version__
    from probevo.output.comparison.comparison_files import (
        document,
        flat_record,
        ranking_records,
        write_csv,
    )
    from probevo.output.comparison.comparison_page import write_comparison
    from probevo.output.json_file import write_json
    from probevo.output.trial_table import trial_table, trials_latex
    from probevo.storage.files import write_atomically, written_together

    trials = trial_table(comparison)
    noise_of = {entry.estimator: entry.config.noise for entry in comparison.entries if entry.config}
    model_files = {name: noise for name, noise in noise_of.items() if Path(noise).is_absolute()}
    facts = model_files | {"probevo": __version__}
    # All files or none: part of them beside those of an earlier comparison would pass for one.
    with written_together(out) as folder:
        write_csv(folder / "comparison.csv", map(flat_record, comparison.entries))
        rankings = {"rankings": ranking_records(comparison)}
        write_json(folder / "comparison.json", document(comparison.entries, out) | rankings)
        write_atomically(folder / "table.tex", trials_latex(trials))
        write_comparison(
            folder / "comparison.html",
            comparison,
            "Estimators side by side",
            facts=facts,
            trials=trials,
            links_from=out,
        )


def _summary(comparison: Comparison, out: Path) -> list[str]:
    from probevo.output.comparison.comparison import column_notes, comparison_table, verdicts
    from probevo.output.comparison.without_truth import without_truth

    return [
        comparison_table(comparison).as_text(),
        "",
        *verdicts(comparison),
        *without_truth(comparison),
        "Drift and rotation: over segments of 10 to 50 m.",
        *column_notes(comparison),
        f"comparison: {out / 'comparison.html'}",
    ]


def _refuse_twice(option: str, given: Sequence[tuple[str, str]]) -> None:
    """Refuse what is given twice: pairs of the user's spelling and of what it stands for."""
    seen: set[str] = set()
    for spelling, meaning in given:
        if meaning in seen:
            raise InputError(option, f"{spelling} is given twice.", "Name it once.")
        seen.add(meaning)
