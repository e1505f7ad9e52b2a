"""``probevo compare``: several estimators on several recordings, side by side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.run import settings_of
from probevo.cli.text import table
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.run_config import RunConfig, SharedConfig, run_config

if TYPE_CHECKING:
    from probevo import sequences
    from probevo.output.comparison import Comparison, Entry

AGGRESSIVE = "aggressive"
AGGRESSIVE_CONFIDENCE = 0.9999


@dataclass(frozen=True)
class CompareArguments:
    """Runs every estimator over every recording, and compares them.

    Writes comparison.html with tables and figures, comparison.csv and .json with all metrics,
    table.tex in the form of PROBE Table I, and runs/ with the files of each run. Settings hold for
    all runs: defaults < the file of --config, whose recording and noise model are left aside <
    flags.
    """

    sequences: Annotated[
        tyro.conf.Positional[tuple[Path, ...]],
        tyro.conf.arg(metavar="SEQUENCE…", help_behavior_hint=""),
    ]
    """Folders of the recordings, or tracks files (.npz)."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. Files of the same names are replaced; runs of earlier comparisons
    stay."""
    noise: Annotated[tuple[str, ...], tyro.conf.arg(metavar="ESTIMATOR…")] = ("fixed", "student-t")
    """The estimators: fixed, student-t, and model files (.safetensors), as in `probevo run`;
    aggressive is fixed with RANSAC at a confidence of 0.9999. With the defaults, fixed and
    aggressive are what PROBE was compared with."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Settings as YAML, such as the config.yaml of an earlier run."""
    threads: int = 1
    """Threads of OpenCV. Two save a tenth of the time, no more; the results are the same."""
    settings: Annotated[SharedConfig, tyro.conf.arg(name="")] = field(default_factory=SharedConfig)


@dataclass(frozen=True)
class Recording:
    """A recording to run over."""

    name: str
    """Unlike that of any other."""
    sequence: sequences.Sequence


@dataclass(frozen=True)
class Estimator:
    """A way to run over a recording."""

    name: str
    """Unlike that of any other."""
    noise: str
    settings: OdometryConfig


@dataclass(frozen=True)
class Job:
    """One run of a comparison."""

    recording: Recording
    estimator: Estimator
    config: RunConfig
    out: Path
    """Folder for its files."""
    learned_from_it: bool
    """Whether the noise model was learned from a recording of this name."""


def main(words: list[str]) -> None:
    """Parse, check everything, run, compare."""
    given = settings_of(words)
    shared = SharedConfig.model_validate(
        {name: getattr(given, name) for name in SharedConfig.model_fields}
    )
    default = CompareArguments(sequences=tyro.MISSING, out=tyro.MISSING, settings=shared)
    arguments = parse(CompareArguments, words, "compare", default=default)
    settings = checked(arguments.settings)
    if arguments.threads < 1:
        raise InputError("--threads", f"is {arguments.threads}.", "It must be at least 1.")
    from probevo.files import check_folder

    check_folder(arguments.out, "--out")
    recordings = open_recordings(arguments.sequences, settings.format)
    jobs = plan(recordings, estimators_of(arguments.noise, settings), arguments.out)
    comparison = run_all(
        jobs, arguments.threads, lambda done: _write(arguments.out, done), out=arguments.out
    )
    print("\n".join(_summary(comparison, arguments.out)))


def open_recordings(paths: Sequence[Path], layout: str | None) -> list[Recording]:
    """Open the recordings and name them.

    Raises:
        InputError: there is none, one is there twice, is too short, or cannot be opened.
    """
    from probevo.output.comparison import distinct_labels
    from probevo.sequences import open_sequence

    _refuse_twice("SEQUENCE", [(str(path), str(path.resolve())) for path in paths])
    if not paths:
        raise InputError(
            "SEQUENCE",
            "no recording is named.",
            "Give one or more: `probevo compare SEQUENCE --out DIR`.",
        )
    opened = [open_sequence(path, layout) for path in paths]
    for sequence in opened:
        if len(sequence) < 2:
            raise InputError(
                sequence.path, "has one frame only, and so no motion to compare.", "Leave it out."
            )
    return [
        Recording(name, sequence)
        for name, sequence in zip(distinct_labels(paths), opened, strict=True)
    ]


def estimators_of(specs: Sequence[str], settings: SharedConfig) -> list[Estimator]:
    """The estimators that --noise names.

    Raises:
        InputError: there is none, or one is there twice.
    """
    from probevo.noise.named import portable
    from probevo.noise.registry import untrained_names
    from probevo.output.comparison import distinct_labels

    names = (*untrained_names(), AGGRESSIVE)
    _refuse_twice("--noise", [(spec, spec if spec in names else portable(spec)) for spec in specs])
    if not specs:
        raise InputError(
            "--noise",
            "no estimator is named.",
            f"Give one or more of {', '.join(names)}, or model files.",
        )
    files = [Path(spec) for spec in specs if spec not in names]
    labels = dict(zip(map(str, files), distinct_labels(files, taken=names), strict=True))
    return [
        Estimator(AGGRESSIVE, "fixed", aggressive(settings))
        if spec == AGGRESSIVE
        else Estimator(spec if spec in names else labels[str(Path(spec))], spec, settings)
        for spec in specs
    ]


def aggressive(settings: OdometryConfig) -> OdometryConfig:
    """The same with as many samples of RANSAC as PROBE's aggressive estimator takes."""
    ransac = settings.ransac.model_copy(update={"confidence": AGGRESSIVE_CONFIDENCE})
    return settings.model_copy(update={"ransac": ransac})


def plan(recordings: Sequence[Recording], estimators: Sequence[Estimator], out: Path) -> list[Job]:
    """Every estimator on every recording, all of it checked before the first one runs.

    Raises:
        InputError: a noise model is not known, cannot be loaded, or does not fit a recording, or a
            setting does not.
    """
    from probevo.noise.named import noise_model, portable
    from probevo.noise.origin import learned_from
    from probevo.output.comparison import numbered
    from probevo.runner import check_run

    models = {
        estimator.name: noise_model(estimator.noise, others=(AGGRESSIVE,))
        for estimator in estimators
    }
    pairs = [(recording, estimator) for recording in recordings for estimator in estimators]
    folders = numbered([f"{recording.name}-{estimator.name}" for recording, estimator in pairs])
    jobs = []
    for (recording, estimator), folder in zip(pairs, folders, strict=True):
        config = run_config(
            estimator.settings, recording.sequence.path.resolve(), portable(estimator.noise)
        )
        check_run(recording.sequence, config, models[estimator.name])
        seen = recording.sequence.path.resolve().name in learned_from(models[estimator.name])
        jobs.append(
            Job(recording, estimator, config, out=out / "runs" / folder, learned_from_it=seen)
        )
    return jobs


def run_all(
    jobs: Sequence[Job], threads: int, write: Callable[[Comparison], None], out: Path
) -> Comparison:
    """Run one after another, and write the comparison of all; or, whatever stops it, that of those
    that are done."""
    from probevo.output.comparison import Comparison

    entries: list[Entry] = []
    try:
        for number, job in enumerate(jobs, start=1):
            entries.append(_run(job, threads, f"{number} of {len(jobs)}: "))
    except (
        BaseException
    ) as stop:  # Ctrl-C, a damaged image: it goes on, but not without what was computed
        if entries:
            write(Comparison(tuple(entries)))
            stop.add_note(f"The {len(entries)} finished of {len(jobs)} runs are compared in {out}.")
        raise
    comparison = Comparison(tuple(entries))
    write(comparison)
    return comparison


def _run(job: Job, threads: int, before: str) -> Entry:
    from probevo.cli.run import run_with_progress
    from probevo.output.comparison import Entry

    name, estimator, report = job.recording.name, job.estimator.name, job.out / "report.html"
    done = run_with_progress(
        job.recording.sequence,
        job.config,
        job.out,
        threads=threads,
        name=f"{before}{name} {estimator}",
    )
    files = done.pictures, report, job.config
    return Entry(
        name, estimator, done.result, done.truth, done.metrics, *files, job.learned_from_it
    )


def _write(out: Path, comparison: Comparison) -> None:
    from probevo import __version__
    from probevo.files import write_atomically
    from probevo.output.comparison_files import document, flat_record, write_csv
    from probevo.output.comparison_page import write_comparison
    from probevo.output.files import write_json
    from probevo.output.trial_table import trial_table, trials_latex

    trials = trial_table(comparison)
    models = {entry.estimator: entry.config.noise for entry in comparison.entries if entry.config}
    facts = {name: noise for name, noise in models.items() if Path(noise).is_absolute()} | {
        "probevo": __version__
    }
    write_csv(out / "comparison.csv", map(flat_record, comparison.entries))
    write_json(out / "comparison.json", document(comparison.entries, out))
    write_atomically(out / "table.tex", trials_latex(trials))
    write_comparison(
        out / "comparison.html", comparison, "Estimators side by side", facts=facts, trials=trials
    )


def _summary(comparison: Comparison, out: Path) -> list[str]:
    from probevo.output.comparison import column_notes, comparison_rows, truth_note

    head, *rows = comparison_rows(comparison)
    notes = [
        "Drift and rotation: over pieces of 10 to 50 m.",
        *column_notes(comparison),
        *truth_note(comparison),
    ]
    return [table(head, rows), "", *notes, f"comparison: {out / 'comparison.html'}"]


def _refuse_twice(option: str, given: Sequence[tuple[str, str]]) -> None:
    """Given: as the user names each, and what it means."""
    meant: set[str] = set()
    for name, meaning in given:
        if meaning in meant:
            raise InputError(option, f"{name} is given twice.", "Name it once.")
        meant.add(meaning)
