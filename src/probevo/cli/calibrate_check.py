"""``probevo calibrate-check``: check a calibration against the images and the IMU of a
recording."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.info import print_reader_warnings
from probevo.cli.text import table
from probevo.errors import InputError
from probevo.sequences.read_settings import ReadSettings

if TYPE_CHECKING:
    from probevo.runs.calibration_check import CalibrationCheck

MAX_FRAMES = 300
NOTICEABLE_PX = 0.05
"""Smallest remaining distortion of the lenses that is mentioned."""


@dataclass(frozen=True)
class CalibrateCheckArguments:
    """Says what a recording itself tells of its calibration: of rows and disparity of the rectified
    pair, of the delay of its right image, of the scale if the truth is known, and of the IMU.

    Each quantity is zero for a flawless calibration, and comes with its standard deviation σ and
    z, its distance from zero in σ. Lines that start with ! are further from zero than chance would
    have it (once in a hundred flawless recordings); below the table stands how to mend them.
    """

    sequence: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="SEQUENCE")]
    """Folder of the recording, a bag, or a tracks file (.npz)."""
    max_frames: int = MAX_FRAMES
    """Frames that are looked at, from the start."""
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """Picture of the errors to write, .png, .svg or .pdf: rows and lens distortion over the image,
    disparity over its width, and how far each quantity is from zero."""
    settings: Annotated[ReadSettings, tyro.conf.arg(name="")] = field(default_factory=ReadSettings)


def main(words: list[str]) -> None:
    """Parse the arguments, open the recording, and print what it says of its calibration."""
    arguments = parse(CalibrateCheckArguments, words, "calibrate-check")
    settings = checked(arguments.settings)
    from probevo.runs.calibration_check import MIN_FRAMES, check_calibration

    if arguments.max_frames < MIN_FRAMES:
        what = f"is {arguments.max_frames}."
        raise InputError("--max-frames", what, f"It must be at least {MIN_FRAMES}.")
    if arguments.out is not None:
        from probevo.output.calibration_picture import check_picture_path

        check_picture_path(arguments.out)
    from probevo.cli.first_use import say_if_compiling
    from probevo.sequences import open_sequence

    sequence = open_sequence(arguments.sequence, settings.format, **settings.format_options())
    print_reader_warnings(sequence)
    say_if_compiling()
    check = check_calibration(sequence, arguments.max_frames)
    print("\n".join(report_lines(sequence.path, check)), flush=True)
    if arguments.out is not None:
        from probevo.evaluation.calibration_quantities import largest_z
        from probevo.output.calibration_picture import write_calibration_picture

        write_calibration_picture(
            arguments.out,
            check.rig,
            check.quantities,
            marked=check.marked,
            camera=sequence.camera,
            largest_z=largest_z(len(check.quantities)),
        )
        print(f"picture: {arguments.out}", flush=True)


def report_lines(recording: Path, check: CalibrationCheck) -> list[str]:
    """Say what a recording tells of its calibration: a table, how to mend what is marked, and
    notes."""
    from probevo.evaluation.calibration_quantities import SELF_CALIBRATED

    marked = check.marked
    cells = [quantity.texts(is_marked=quantity in marked) for quantity in check.quantities]
    lines = [
        f"recording: {recording}, {check.num_frames} frames, {check.num_solved} solved",
        "",
        *table(("quantity", "value", "σ", "unit", "z"), cells).splitlines(),
        "z: the distance from zero in σ, reduced where σ is itself uncertain.",
        "",
    ]
    lines += [f"! {quantity.name}: {quantity.cure}" for quantity in marked]
    if any(quantity.name.startswith(("rows", "disparity")) for quantity in marked):
        lines.append(SELF_CALIBRATED)
    if not marked:
        lines.append("Nothing is further from zero than chance would have it.")
    return [*lines, *_imu_notes(check), *_camera_notes(check)]


def _imu_notes(check: CalibrationCheck) -> list[str]:
    if not check.has_imu:
        return ["IMU: none whose samples are read at their own rate."]
    if check.C_cam_imu is None:
        return ["IMU: its samples cover too few solved steps."]
    if not any(quantity.name.startswith("gyro, mounting") for quantity in check.marked):
        return []
    matrix = "; ".join(" ".join(f"{value:+.6f}" for value in row) for row in check.C_cam_imu)
    return [f"The rotation in T_cam_imu that agrees with the images: {matrix}."]


def _camera_notes(check: CalibrationCheck) -> list[str]:
    """Say what the lenses do, whether anything tells the scale, and how high the camera is."""
    from probevo.camera.distortion_field import root_mean_square_px

    notes = []
    common_px, disparity_px = root_mean_square_px(check.rig.image.distortion)
    if max(common_px, disparity_px) > NOTICEABLE_PX:
        notes.append(
            f"Lenses: they move both views of a point by {common_px:.2f} px, and disparities by"
            f" {disparity_px:.2f} px beyond the bend above (rms over the image). This is corrected."
        )
    if not any(quantity.name.startswith("scale") for quantity in check.quantities):
        notes.append("Scale: neither true poses nor an accelerometer tell it.")
    if check.height is not None:
        notes.append(
            f"Height: the left camera is {check.height.height_m:.3f} ± {check.height.sigma_m:.3f} m"
            " above the ground that it drives over. Measure it: if that is wrong, baseline_m is"
            " wrong by the same factor."
        )
    return notes
