"""``probevo run``: from a recording to a trajectory, a covariance for every step, and a report."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.errors import InputError
from probevo.run_config import RunConfig, read_config

if TYPE_CHECKING:
    from probevo.runner import Run
    from probevo.sequences import Sequence


@dataclass(frozen=True)
class RunArguments:
    """Stereo odometry over a recording.

    Writes trajectory.tum, trajectory.kitti.txt, motions.npz, config.yaml, report.html and, where
    truth is known, metrics.json. Settings: defaults < the file of --config < flags.
    """

    sequence: Annotated[
        tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="SEQUENCE", help_behavior_hint="")
    ]
    """Folder of the recording, or a tracks file (.npz). It may be left out where --config names it.
    """
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier run left there is replaced."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Settings as YAML, such as the config.yaml of an earlier run."""
    threads: int = 1
    """Threads of OpenCV. Two save a tenth of the time, no more; the results are the same."""
    settings: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)


def main(words: list[str]) -> None:
    """Parse and run."""
    arguments = parse(RunArguments, words, "run", default=_defaults(words))
    settings = checked(arguments.settings)
    if arguments.sequence is None:
        raise InputError(
            "SEQUENCE",
            "no recording is named.",
            "Give its folder: `probevo run SEQUENCE --out DIR`.",
        )
    if arguments.threads < 1:
        raise InputError("--threads", f"is {arguments.threads}.", "It must be at least 1.")
    settings = settings.model_copy(update={"sequence": arguments.sequence})
    from probevo.output.run_warnings import status_warning
    from probevo.sequences import open_sequence

    sequence = open_sequence(arguments.sequence, settings.format)
    run = run_with_progress(sequence, settings, arguments.out, threads=arguments.threads)
    print("\n".join(summary(run, arguments.out)), flush=True)
    if warning := status_warning(run.result.status):
        print(f"probevo: warning: {warning}", file=sys.stderr)


def _defaults(words: list[str]) -> RunArguments:
    settings = settings_of(words)
    return RunArguments(sequence=settings.sequence, out=tyro.MISSING, settings=settings)


def settings_of(words: list[str]) -> RunConfig:
    """What holds where no flag is given; it may come from the file, so that --config is looked for
    first."""
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--config", nargs="?")
    path = finder.parse_known_args(words)[0].config
    return RunConfig() if path is None else read_config(Path(path))


def run_with_progress(
    sequence: Sequence, config: RunConfig, out: Path, threads: int, name: str = ""
) -> Run:
    """Run over a recording, and show on stderr how far it is; ``name``, if not the recording's,
    says what is run."""
    import cv2

    from probevo.allocator import keep_freed_memory
    from probevo.cli.first_use import getting_ready
    from probevo.cli.progress import progress_bar
    from probevo.runner import run_sequence

    cv2.setNumThreads(threads)
    keep_freed_memory()
    total = min(len(sequence), config.max_frames or len(sequence))
    with progress_bar(name or sequence.path.name, getting_ready()) as show:
        done = count(1)
        return run_sequence(sequence, config, out, on_step=lambda _: show(next(done), total))


def summary(run: Run, out: Path) -> list[str]:
    """A few lines on how a run went."""
    import numpy as np

    from probevo.estimation.motion_estimate import Status
    from probevo.output.domain import domain_text, domain_warning
    from probevo.output.table import readable

    result = run.result
    metrics = run.metrics
    steps = Counter(Status(status).name.lower().replace("_", " ") for status in result.status)
    how = ", ".join(f"{count} {name}" for name, count in steps.most_common())
    lines = [f"{len(result)} frames; steps: {how}" if steps else "1 frame, and so no motion"]
    if len(result.total_ms):
        lines.append(
            f"{readable(float(np.median(result.total_ms)))} ms a frame (median, without decoding)"
        )
    if metrics and metrics.short_t_percent is not None and metrics.short_r_deg_per_m is not None:
        drift = f"{readable(metrics.short_t_percent)} %, {readable(metrics.short_r_deg_per_m)} °/m"
        lines.append(f"drift {drift} over pieces of 10 to 50 m")
    if metrics and metrics.final_error_m is not None and metrics.path_length_m is not None:
        lines.append(
            f"end error {readable(metrics.final_error_m)} m after"
            f" {readable(metrics.path_length_m)} m"
        )
    if result.out_of_domain is not None:
        warning = domain_warning(result.out_of_domain)
        lines.append(
            f"warning: {warning}"
            if warning
            else f"out of domain: {domain_text(result.out_of_domain)}"
        )
    return [*lines, f"report: {out / 'report.html'}" if len(result) > 1 else f"results: {out}"]
