"""``probevo simulate``: record a simulated world with its truth."""

from __future__ import annotations

import shlex
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import tyro

from probevo.cli.arguments import checked, parse_one_of
from probevo.errors import InputError
from probevo.sequences.read_settings import ReadSettings
from probevo_sim.point_config import PointConfig
from probevo_sim.scene.config import SceneConfig
from probevo_sim.spoiling.config import SpoilConfig


@dataclass(frozen=True)
class PointArguments:
    """Landmarks with known noise, seen from a circle, as tracks: train.npz and test.npz.

    These are tracks files that `probevo run` reads. They also hold the truth about each
    observation: its covariance (covariance), whether it is an inlier (inlier), and its place
    without error (true_uv).
    """

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the recordings. Those of an earlier simulation there are replaced."""
    settings: Annotated[PointConfig, tyro.conf.arg(name="")] = field(default_factory=PointConfig)


@dataclass(frozen=True)
class SceneArguments:
    """Rendered stereo images and IMU of a drive through a place, as a folder sequence."""

    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the recording. An interrupted simulation there is resumed."""
    pixel_truth: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    """Also write disparity, optical flow and the mask of moving objects of each image."""
    jobs: int = 0
    """Threads that render; 0 takes all cores. The images do not depend on it."""
    settings: Annotated[SceneConfig, tyro.conf.arg(name="")] = field(default_factory=SceneConfig)


@dataclass(frozen=True)
class SpoilArguments:
    """A real recording with bursts of blur, darkness, occluders and so on, as a folder sequence.

    The file spoiled.json says what was done to each frame. A run of the recording itself is the
    reference.
    """

    sequence: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """Folder of the recording, or a bag."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the spoiled recording, which appears when complete; missing or empty before."""
    settings: Annotated[SpoilConfig, tyro.conf.arg(name="")] = field(default_factory=SpoilConfig)
    reading: Annotated[ReadSettings, tyro.conf.arg(name="")] = field(default_factory=ReadSettings)


@dataclass(frozen=True)
class SimulateArguments:
    """Record a simulated world with its truth, or spoil a real recording.

    `probevo simulate WORLD --help` shows the options of a world.
    """

    world: Annotated[
        Annotated[PointArguments, tyro.conf.subcommand("point")]
        | Annotated[SceneArguments, tyro.conf.subcommand("scene")]
        | Annotated[SpoilArguments, tyro.conf.subcommand("spoil")],
        tyro.conf.arg(name=""),
    ]


WORLDS: dict[str, type[PointArguments | SceneArguments | SpoilArguments]] = {
    "point": PointArguments,
    "scene": SceneArguments,
    "spoil": SpoilArguments,
}


def main(words: list[str]) -> None:
    """Parse the arguments, simulate, and print what to do with the result."""
    arguments = parse_one_of(WORLDS, words, "simulate", SimulateArguments)
    from probevo.storage.lock import locked

    if isinstance(arguments, SpoilArguments):  # its folder has to be empty
        print("\n".join(_spoil(arguments)))
        return
    with locked(arguments.out):
        lines = _point(arguments) if isinstance(arguments, PointArguments) else _scene(arguments)
    print("\n".join(lines))


def _point(arguments: PointArguments) -> list[str]:
    """Simulate the point world, and return the lines to print."""
    settings = checked(arguments.settings)
    from probevo_sim.point_world import write_training_and_test

    train, test = write_training_and_test(settings, arguments.out)
    lines = []
    for name, world in (("train.npz", train), ("test.npz", test)):
        path_m = settings.speed_m_s * float(world.stamps_ns[-1]) * 1e-9
        seen = len(world.ids) / len(world)
        lines.append(
            f"{arguments.out / name}: {len(world)} frames, {path_m:.0f} m,"
            f" {seen:.0f} landmarks a frame"
        )
    return [*lines, _next_command(arguments.out / "test.npz", arguments.out / "run")]


def _scene(arguments: SceneArguments) -> list[str]:
    """Render a scene, and return the lines to print."""
    settings = checked(arguments.settings)
    if arguments.jobs < 0:
        raise InputError(
            "--jobs", f"is {arguments.jobs}.", "Give the number of threads, or 0 for all cores."
        )
    from probevo.sequences import open_sequence

    out = render_with_progress(
        settings, arguments.out, pixel_truth=arguments.pixel_truth, jobs=arguments.jobs
    )
    frames = len(open_sequence(out))
    return [f"{out}: {frames} frames", _next_command(out, out.with_name(f"{out.name}-run"))]


def _spoil(arguments: SpoilArguments) -> list[str]:
    """Spoil a recording, and return the lines to print."""
    settings = checked(arguments.settings)
    reading = checked(arguments.reading)
    from probevo.cli.progress import progress_bar
    from probevo.output.recording_folder import check_new_folder, left_out_text
    from probevo.sequences import open_sequence
    from probevo.storage.work_folder import as_only_writer, moved_when_complete
    from probevo_sim.spoiling.recording import SpoiledRecording, write_spoiled

    out = arguments.out
    check_new_folder(out)
    original = open_sequence(arguments.sequence, reading.format, **reading.format_options())
    recording = SpoiledRecording.of(original, settings)
    num_frames = len(recording)
    with (
        as_only_writer(out, check_new_folder) as work,
        progress_bar(f"spoiling {original.path.resolve().name}", "reading") as show,
        moved_when_complete(work, out) as partial,
    ):
        num_left_out = write_spoiled(
            partial, recording, on_frame=lambda index: show(index + 1, num_frames)
        )
    effects = Counter(plan.effect or "clean" for plan in recording.plans)
    counts = ", ".join(f"{count} {name.replace('_', ' ')}" for name, count in effects.most_common())
    return [
        f"{out}: {num_frames} of {len(original)} frames; {counts}",
        *_changes_all_along(settings.effective()),
        *([left_out_text(num_left_out)] if num_left_out else []),
        _next_command(out, out.with_name(f"{out.name}-run")),
    ]


def _changes_all_along(settings: SpoilConfig) -> list[str]:
    """Return what was done to all frames alike, in words."""
    changes = []
    if settings.right_late_frames:
        changes.append(f"all right images late, by {settings.right_late_frames} of the frames")
    if settings.focal_error:
        changes.append(f"a focal length that is wrong by {100.0 * settings.focal_error:g} %")
    if settings.radial_distortion:
        changes.append(f"a radial distortion, k1 = {settings.radial_distortion:g}")
    return [f"besides: {'; '.join(changes)}"] if changes else []


def render_with_progress(
    config: SceneConfig, out: Path, *, pixel_truth: bool = False, jobs: int = 0
) -> Path:
    """Render a scene, or what is missing of it, into a folder, with a progress bar on stderr."""
    from probevo.cli.progress import progress_bar
    from probevo_sim.scene.writer import write_scene

    title = f"rendering {out.name}"
    with progress_bar(title, "starting (compiling, if this is the first time)") as show:
        return write_scene(config, out, pixel_truth=pixel_truth, jobs=jobs, on_frame=show)


def _next_command(recording: Path, out: Path) -> str:
    return f"next: probevo run {shlex.quote(str(recording))} --out {shlex.quote(str(out))}"
