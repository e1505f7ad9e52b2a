"""``probevo run``: estimate the trajectory of a recording, with covariances and a report."""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import count, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.info import print_reader_warnings
from probevo.errors import InputError
from probevo.output.run_files import MOTIONS, REPORT, TRAJECTORY_TUM, VIEWER_SUFFIX
from probevo.run_config import CommonRunSettings, RunConfig, read_config

if TYPE_CHECKING:
    from probevo.evaluation.metrics import Metrics
    from probevo.runs.runner import Run
    from probevo.sequences import Sequence


@dataclass(frozen=True)
class RunArguments:
    """Runs the stereo odometry over a recording.

    Writes trajectory.tum, trajectory.kitti.txt, motions.npz, config.yaml, report.html and, if the
    truth is known, metrics.json; with --estimator window also the smoothed path,
    trajectory.smoothed.tum and .kitti.txt. Flags override the file given by --config, and that
    overrides the defaults.
    """

    sequence: Annotated[
        tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="SEQUENCE", help_behavior_hint="")
    ]
    """Folder of the recording, a bag, or a tracks file (.npz). Optional if --config names it."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. Those of an earlier run are replaced."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Settings as YAML, such as the config.yaml of an earlier run."""
    threads: int = 1
    """Threads of OpenCV. Two save a tenth of the time, more save nothing. Results do not change."""
    strict: bool = False
    """Exit with code 2 if less than half of the steps are OK; the results are written."""
    settings: Annotated[RunConfig, tyro.conf.arg(name="")] = field(default_factory=RunConfig)


def main(words: list[str]) -> None:
    """Parse the arguments and run."""
    words = with_viewer_window(words)
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
    if arguments.out.resolve() == arguments.sequence.resolve():
        raise InputError(
            "--out", "is the folder of the recording itself.", "Name another one for the results."
        )
    refuse_recording(arguments.out)
    settings = settings.model_copy(update={"sequence": arguments.sequence})

    # Only now, after the arguments are known to be good: these imports take time.
    from probevo.output.run_warnings import run_warnings, status_warning
    from probevo.sequences import open_sequence

    sequence = open_sequence(arguments.sequence, settings.format, **settings.format_options())
    print_reader_warnings(sequence)
    run = run_with_progress(sequence, settings, arguments.out, threads=arguments.threads)
    lines = summary(run, arguments.out, extra_outputs(settings))
    print("\n".join(lines), flush=True)
    if settings.camera_height_m is not None and run.result.ground_height is None:
        print("height above the ground: not known, so that --camera-height-m was not checked")
    for warning in run_warnings(run.result, run.truth).values():
        print(f"probevo: warning: {warning}", file=sys.stderr)
    if arguments.strict and status_warning(run.result.status):
        what = "less than half of the steps are OK, which --strict refuses."
        raise InputError(arguments.sequence, what, f"The results are in {arguments.out}.")


def refuse_recording(out: Path) -> None:
    """Refuse a folder of results that is another recording.

    Raises:
        InputError: it is one.
    """
    from probevo.sequences.registry import sequence_formats

    if not out.is_dir() or (out / MOTIONS).exists():
        return
    for known in sequence_formats().values():
        if known.folder_signs and known.recognises(out):
            raise InputError(
                "--out",
                f"{out} is a recording, by its format {known.name}.",
                "Name another folder for the results.",
            )


def _defaults(words: list[str]) -> RunArguments:
    settings = default_settings(words)
    return RunArguments(sequence=settings.sequence, out=tyro.MISSING, settings=settings)


def with_viewer_window(words: list[str]) -> list[str]:
    """Return the words with the value "window" after a --viewer that has none."""
    extended = []
    for word, following in pairwise([*words, "--"]):
        extended.append(word)
        if word == "--viewer" and following.startswith("--"):
            extended.append("window")
    return extended


def default_common_settings(words: list[str]) -> CommonRunSettings:
    """Return those of ``default_settings`` that several commands have."""
    given = default_settings(words)
    return CommonRunSettings.model_validate(
        {name: getattr(given, name) for name in CommonRunSettings.model_fields}
    )


def default_settings(words: list[str]) -> RunConfig:
    """Return the settings without any flags: those of the file given by --config, or the defaults.

    Raises:
        InputError: the file is missing or has a fault.
    """
    finder = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    finder.add_argument("--config", nargs="?")
    path = finder.parse_known_args(words)[0].config
    return RunConfig() if path is None else read_config(Path(path))


def run_with_progress(
    sequence: Sequence, config: RunConfig, out: Path, threads: int, name: str = ""
) -> Run:
    """Run the odometry over a recording with a progress bar on stderr.

    Args:
        sequence: the recording.
        config: all settings.
        out: folder for the files.
        threads: threads of OpenCV.
        name: label of the progress bar; by default the name of the recording.
    """
    import cv2

    from probevo.allocator import keep_freed_memory
    from probevo.cli.first_use import getting_ready
    from probevo.cli.progress import progress_bar
    from probevo.runs.runner import run_sequence

    cv2.setNumThreads(threads)
    keep_freed_memory()
    num_frames = min(len(sequence), config.max_frames or len(sequence))
    num_done = count(1)
    with progress_bar(name or sequence.path.resolve().name, getting_ready()) as show:
        return run_sequence(
            sequence, config, out, on_step=lambda _: show(next(num_done), num_frames)
        )


def extra_outputs(settings: RunConfig) -> list[tuple[str, Path]]:
    """Return what the user asked for besides the folder of results, with its file."""
    written = []
    if settings.write is not None:
        written.append(("odometry", settings.write))
    if settings.viewer is not None and settings.viewer.suffix == VIEWER_SUFFIX:
        written.append(("for the viewer", settings.viewer))
    return written


def summary(run: Run, out: Path, written: Iterable[tuple[str, Path]] = ()) -> list[str]:
    """Return a few lines on the results of a run.

    Args:
        run: the run.
        out: the folder of its results.
        written: other files that were written: what they are, and their paths.
    """
    import numpy as np

    from probevo.camera.exposure_delay import is_noticeable
    from probevo.estimation.motion_estimate import Status
    from probevo.output.domain_warning import domain_text
    from probevo.output.run_facts import (
        delay_text,
        focal_text,
        height_text,
        jitter_text,
        readout_text,
        unused_imu_text,
    )
    from probevo.output.table import readable

    result = run.result
    if len(result) < 2:
        lines = ["1 frame, and so no motion"]
    else:
        steps = Counter(Status(status).name.lower().replace("_", " ") for status in result.status)
        counts = ", ".join(f"{number} {name}" for name, number in steps.most_common())
        lines = [f"{len(result)} frames; steps: {counts}"]
    if len(result.total_ms):
        median_ms = readable(float(np.median(result.total_ms)))
        lines.append(f"{median_ms} ms per frame (median, without decoding)")

    if run.metrics is not None:
        lines += _error_lines(run.metrics)
    unused_imu = unused_imu_text(result)
    if unused_imu:
        lines.append(f"IMU: {unused_imu}")
    if result.jitter_sigma_rad is not None and Status.OK in result.status:
        lines.append(f"the right camera {jitter_text(result.jitter_sigma_rad)}")
    if is_noticeable(result.right_delay_s):
        lines.append(delay_text(result.right_delay_s))
    if result.readout_s != 0.0:
        lines.append(readout_text(result.readout_s))
    if result.focal_length is not None and result.focal_length.is_noticeable:
        lines.append(f"focal length: {focal_text(result.focal_length)}")
    if result.ground_height is not None:
        lines.append(f"height above the ground: {height_text(result.ground_height)}")
    if result.out_of_domain is not None:
        lines.append(f"out of domain: {domain_text(result.out_of_domain)}")
    lines += [f"{what}: {path}" for what, path in written]
    if len(result) > 1:
        lines.append(f"trajectory: {out / TRAJECTORY_TUM}; covariances: {out / MOTIONS}")
        lines.append(f"report: {out / REPORT}")
    else:
        lines.append(f"results: {out}")
    return lines


def _error_lines(metrics: Metrics) -> list[str]:
    """Return what the truth says of the path, as far as it is known."""
    from probevo.output.headline import headline_drift
    from probevo.output.table import readable

    lines = []
    drift = headline_drift(metrics)
    if drift is not None:
        translation = readable(drift.translation_percent)
        rotation = readable(drift.rotation_deg_per_m)
        lines.append(f"drift {translation} %, {rotation} °/m over segments of {drift.segments} m")
    if metrics.final_error_m is not None and metrics.path_length_m is not None:
        error_m = readable(metrics.final_error_m)
        lines.append(f"end error {error_m} m after {readable(metrics.path_length_m)} m")
    return lines
