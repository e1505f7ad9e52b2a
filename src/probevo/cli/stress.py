"""``probevo stress``: run the odometry on degraded versions of a recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.run import default_common_settings
from probevo.errors import InputError
from probevo.run_config import CommonRunSettings, run_config
from probevo_sim.spoiling.config import CLEAN_START_FRAMES, StressConfig

if TYPE_CHECKING:
    from probevo.run_config import RunConfig
    from probevo.sequences import Sequence
    from probevo_sim.spoiling.stress import Stress

MAX_FRAMES = 200
"""Frames that are looked at by default."""


@dataclass(frozen=True)
class StressArguments:
    """Runs the odometry on bursts of blur, darkness, occluders and so on, put into a recording.

    The run on the clean images is the reference, so that no truth is needed. Writes stress.html and
    stress.png with the error and the claimed σ of a step against the severity, metrics.json, and
    runs/, from which an interrupted command goes on. Flags override the file given by --config,
    whose recording, noise model and learned sensors are ignored, and that overrides the defaults.
    """

    sequence: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """Folder of the recording, or a bag. Its first 200 frames, unless --max-frames is given."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. Those of an earlier command are replaced, or taken up if the
    settings are the same."""
    noise: str = "student-t"
    """Noise of the features, as in `probevo run`."""
    config: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint="")] = None
    """Settings as YAML, such as the config.yaml of an earlier run."""
    stress: Annotated[StressConfig, tyro.conf.arg(name="")] = field(default_factory=StressConfig)
    settings: Annotated[CommonRunSettings, tyro.conf.arg(name="")] = field(
        default_factory=CommonRunSettings
    )


def main(words: list[str]) -> None:
    """Parse the arguments, check everything, run, and write the results."""
    common = default_common_settings(words)
    default = StressArguments(sequence=tyro.MISSING, out=tyro.MISSING, settings=common)
    arguments = parse(StressArguments, words, "stress", default=default)
    grid = checked(arguments.stress)
    settings = checked(arguments.settings)
    from probevo.noise.named import noise_model, portable
    from probevo.run_checks import check_run
    from probevo.sequences import open_sequence
    from probevo.sequences.without_imu import WithoutImu
    from probevo.storage.lock import locked

    sequence: Sequence = open_sequence(
        arguments.sequence, settings.format, **settings.format_options()
    )
    config = run_config(settings, sequence.path.resolve(), portable(arguments.noise))
    config = config.model_copy(update={"max_frames": config.max_frames or MAX_FRAMES})
    num_frames = min(len(sequence), config.max_frames or MAX_FRAMES)
    if num_frames <= CLEAN_START_FRAMES:
        what = (
            f"{num_frames} frames; the first {CLEAN_START_FRAMES} stay clean, so that nothing would"
            " be spoiled."
        )
        raise InputError(sequence.path, what, "Take a longer recording, or more --max-frames.")
    if not config.imu:
        sequence = WithoutImu.of(sequence)
    check_run(sequence, config, noise_model(config.noise))
    with locked(arguments.out):
        stress = _run_with_progress(sequence, config, grid, out=arguments.out)
        _write(arguments.out, sequence, config, grid=grid, stress=stress)
    print("\n".join(_summary(stress, arguments.out)))


def _run_with_progress(
    sequence: Sequence, config: RunConfig, grid: StressConfig, *, out: Path
) -> Stress:
    """Run with a progress bar on stderr over the frames of all runs."""
    import cv2

    from probevo.allocator import keep_freed_memory
    from probevo.cli.first_use import getting_ready
    from probevo.cli.progress import progress_bar
    from probevo_sim.spoiling.stress import stress

    cv2.setNumThreads(1)
    keep_freed_memory()
    with progress_bar(sequence.path.resolve().name, getting_ready()) as show:
        return stress(sequence, config, grid, out=out, on_frame=show)


def _write(
    out: Path, sequence: Sequence, config: RunConfig, *, grid: StressConfig, stress: Stress
) -> None:
    """Write all files: all or none."""
    from probevo import __version__
    from probevo.output.json_file import write_json
    from probevo.output.run_facts import camera_text
    from probevo.run_config import config_text
    from probevo.storage.files import write_atomically, written_together
    from probevo_sim.spoiling.stress_page import write_picture, write_stress_page

    num_frames = min(len(sequence), config.max_frames or len(sequence))
    facts = {
        "Recording": str(sequence.path),
        "Frames": f"{num_frames:,} of {len(sequence):,}",
        "Camera": camera_text(sequence.camera),
        "Noise model": config.noise,
        "Clean images": f"{100.0 * stress.clean_ok:.1f} % of the steps OK",
        "Left clean": f"{100.0 * grid.clean:g} % of the frames",
        "Runs of each": str(grid.repeats),
        "probevo": __version__,
    }
    with written_together(out) as folder:
        write_atomically(
            folder / "config.yaml", f"# by probevo {__version__}\n{config_text(config)}"
        )
        metrics = {"grid": grid.model_dump(), "frames": num_frames} | stress.as_dict()
        write_json(folder / "metrics.json", metrics)
        write_picture(folder / "stress.png", stress)
        title = f"{sequence.path.resolve().name} under stress"
        write_stress_page(folder / "stress.html", stress, title, facts)


def _summary(stress: Stress, out: Path) -> list[str]:
    """Return the lines to print."""
    from probevo_sim.spoiling.stress_page import stress_notes, stress_table

    lines = [stress_table(stress).as_text(), "", *stress_notes(stress)]
    if stress.num_resumed:
        num_runs = f"{stress.num_resumed} of {stress.num_runs}"
        lines.append(f"{num_runs} runs were there already.")
    return [*lines, f"page: {out / 'stress.html'}"]
