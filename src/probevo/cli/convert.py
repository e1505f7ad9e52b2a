"""``probevo convert``: write a recording in another format, or a run as a bag of its odometry."""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.errors import InputError
from probevo.output.run_files import MOTIONS, SETTINGS, VIEWER_SUFFIX
from probevo.run_config import RosSettings
from probevo.sequences.format_options import BAG_SUFFIXES
from probevo.sequences.read_settings import ReadSettings

if TYPE_CHECKING:
    from probevo.output.run_result import RunResult
    from probevo.sequences import Sequence


@dataclass(frozen=True)
class ConvertArguments:
    """Writes a recording in another format: a folder of images, or a bag of ROS 1 or ROS 2.

    Images are written rectified, without loss. Of the --out folder of `probevo run`, it writes a
    bag of the odometry, or a file .rrd for the Rerun viewer.
    """

    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """Folder of the recording, a bag, or the folder of a run."""
    out: Annotated[Path, tyro.conf.arg(metavar="PATH")]
    """What to write: a file .bag (ROS 1), .mcap or .db3 (ROS 2), or else a folder of images; of a
    run also .rrd."""
    compressed: bool = False
    """Write the images of a bag as PNG: half the size, slower, and nothing is lost."""
    max_frames: int | None = None
    """Stop after this many frames."""
    ros: RosSettings = field(default_factory=RosSettings)
    """Frames of the odometry of a run."""
    settings: Annotated[ReadSettings, tyro.conf.arg(name="")] = field(default_factory=ReadSettings)


def main(words: list[str]) -> None:
    """Parse the arguments and convert.

    Raises:
        InputError: the source is faulty, it cannot be written in that format, or the file exists.
    """
    arguments = parse(ConvertArguments, words, "convert")
    from probevo.storage.work_folder import as_only_writer, work_folder_of

    settings = checked(arguments.settings)
    ros = checked(arguments.ros)
    if arguments.max_frames is not None and arguments.max_frames < 1:
        raise InputError("--max-frames", f"is {arguments.max_frames}.", "It must be at least 1.")
    if arguments.out.is_file() and work_folder_of(arguments.out).is_dir():
        # This refuses the file, once what a kill has left is gone.
        with as_only_writer(arguments.out, _check_new):
            pass
    _check_new(arguments.out)
    is_run = (arguments.source / MOTIONS).is_file()
    _check_flags(arguments, ros, settings, is_run=is_run)
    if is_run:
        with as_only_writer(arguments.out, _check_new):
            _convert_run(arguments, ros)
        return
    is_bag = arguments.out.suffix in BAG_SUFFIXES
    if arguments.compressed and not is_bag:
        cure = "Images in a folder are PNG files anyway."
        raise InputError("--compressed", f"{arguments.out} is not a bag.", cure)
    if is_bag:
        from probevo.output.ros.bag_writer import check_bag_path

        check_bag_path(arguments.out, "--out")

    from probevo.sequences import open_sequence
    from probevo.sequences.masked import MaskedRecording

    sequence = open_sequence(arguments.source, settings.format, **settings.format_options())
    num_frames = min(len(sequence), arguments.max_frames or len(sequence))
    with as_only_writer(arguments.out, _check_new) as work:
        num_left_out = _write(sequence, arguments, work, num_frames=num_frames, is_bag=is_bag)
    print(f"{num_frames} frames written: {arguments.out}")
    if num_left_out:
        from probevo.output.recording_folder import left_out_text

        print(left_out_text(num_left_out))
    if is_bag and sequence.imu is not None:
        print("The noise of the IMU has no place in a bag: give it with --imu-noise.")
    if is_bag and isinstance(sequence, MaskedRecording):
        print("Masks have no place in a bag: give them with --mask-left and --mask-right.")
    if is_bag and sequence.camera.readout_s:
        print(
            "The readout time of the shutter has no place in a bag: give a Kalibr camchain with"
            " line_delay as --calibration."
        )


def _check_flags(
    arguments: ConvertArguments, ros: RosSettings, settings: ReadSettings, *, is_run: bool
) -> None:
    """Refuse flags that would have no effect.

    Raises:
        InputError: names the flag.
    """
    if is_run:
        is_given = {
            "--compressed": arguments.compressed,
            "--max-frames": arguments.max_frames is not None,
        }
        for name, default in ReadSettings():
            is_given[f"--{name.replace('_', '-')}"] = getattr(settings, name) != default
        whose = "a recording"
    else:
        is_given = {"--ros": ros != RosSettings()}
        whose = "the folder of a run"
    for flag, is_there in is_given.items():
        if is_there:
            what = f"is for {whose}, which {arguments.source} is not."
            raise InputError(flag, what, "Leave it out.")


def _check_new(out: Path) -> None:
    """Refuse to replace a file: it may be a recording, even the source.

    Raises:
        InputError: it exists, or is the root of all.
    """
    if not out.absolute().name:
        raise InputError("--out", f"{out} cannot be written to.", "Name a folder below it.")
    if out.is_file():
        raise InputError("--out", f"{out} exists.", "Name another file, or remove that one.")


def _write(
    sequence: Sequence,
    arguments: ConvertArguments,
    work: Path,
    *,
    num_frames: int,
    is_bag: bool,
) -> int:
    """Write the recording with a progress bar; a folder appears when it is complete.

    Returns:
        The number of IMU samples that were left out.
    """
    from probevo.cli.progress import progress_bar
    from probevo.output.recording_folder import check_new_folder, write_recording_folder
    from probevo.output.ros.recording_bag import write_recording_bag
    from probevo.storage.work_folder import moved_when_complete

    num_done = count(1)
    with progress_bar(sequence.path.resolve().name, "reading") as show:

        def on_frame(index: int) -> None:
            """Count a frame that is written."""
            show(next(num_done), num_frames)

        if is_bag:
            write_recording_bag(
                arguments.out,
                sequence,
                num_frames=num_frames,
                is_compressed=arguments.compressed,
                on_frame=on_frame,
            )
            return 0
        check_new_folder(arguments.out)
        with moved_when_complete(work, arguments.out) as partial:
            return write_recording_folder(
                partial, sequence, num_frames=num_frames, on_frame=on_frame
            )


def _convert_run(arguments: ConvertArguments, ros: RosSettings) -> None:
    """Write the odometry of a finished run as a bag, or for the viewer.

    Raises:
        InputError: its motions are damaged, or the file cannot be written.
    """
    from probevo.output.ros.bag_writer import check_bag_path
    from probevo.output.ros.odometry_bag import write_odometry_bag
    from probevo.output.run_folder import read_run

    if arguments.out.suffix != VIEWER_SUFFIX:
        check_bag_path(arguments.out, "--out")
    result = read_run(arguments.source)
    if arguments.out.suffix == VIEWER_SUFFIX:
        _write_for_viewer(result, arguments)
    else:
        write_odometry_bag(arguments.out, result, ros)
    print(f"odometry of {len(result)} frames written: {arguments.out}")


def _write_for_viewer(result: RunResult, arguments: ConvertArguments) -> None:
    """Write a run for the viewer, with images and features if its recording is still there.

    Raises:
        InputError: the recording is damaged, or the file cannot be written.
    """
    from probevo.cli.progress import progress_bar
    from probevo.output.viewer_file import check_viewer_path, write_viewer_file
    from probevo.run_config import read_config
    from probevo.runs.replay import write_viewer_file_again
    from probevo.sequences import open_sequence

    check_viewer_path(arguments.out, "--out")
    settings_file = arguments.source / SETTINGS
    config = read_config(settings_file) if settings_file.is_file() else None
    if config is None or config.sequence is None or not config.sequence.exists():
        write_viewer_file(arguments.out, result)
        print("Its recording is not there any more: without images and features.")
        return
    sequence = open_sequence(config.sequence, config.format, **config.format_options())
    if len(sequence) < len(result):
        what = f"the run has {len(result)} frames, and {config.sequence} only {len(sequence)}."
        raise InputError(settings_file, what, "Put the recording back as it was, or elsewhere.")
    num_done = count(1)
    with progress_bar(sequence.path.resolve().name, "reading") as show:
        is_same = write_viewer_file_again(
            arguments.out,
            result,
            sequence,
            config,
            on_frame=lambda: show(next(num_done), len(result)),
        )
    if not is_same:
        print("The recording or probevo has changed since: features are not exactly those.")
