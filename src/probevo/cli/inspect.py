"""``probevo inspect``: show what a noise model learned, and its prediction for a frame.

PROBE Figs. 6 and 7.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.sensor_kinds import is_sensor_file, kind_of_file, recordings_of_file, resolve
from probevo.sequences.read_settings import ReadSettings

if TYPE_CHECKING:
    from probevo.noise.base import LearnedNoiseModel
    from probevo.output.inspection.subject import FrameView, Subject
    from probevo.predictors import PredictionSpace
    from probevo.sequences import Sequence


@dataclass(frozen=True)
class InspectArguments:
    """What a noise model learned, and how it sees the features of a frame.

    Writes inspection.html and, of a recording, frame-K/ with a picture for each predictor and for
    what the model makes of them, weights or σ and ν: the features of frame K in the colour of their
    values. Without MODEL, it shows the predictors alone; without SEQUENCE, the model alone. The
    recording is run from its start up to frame K, with the model, since features are followed.

    If MODEL is a learned sensor, the page shows its errors on SEQUENCE, which has true poses,
    against the σ that it claims.
    """

    sequence: Annotated[
        tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="SEQUENCE", help_behavior_hint="")
    ]
    """Folder of the recording, a bag, or a tracks file (.npz)."""
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder for the results. What an earlier inspection of the same frame left there is replaced.
    """
    model: Annotated[Path | None, tyro.conf.arg(metavar="MODEL", help_behavior_hint="")] = None
    """The model file (.safetensors)."""
    frame: Annotated[int | None, tyro.conf.arg(metavar="K", help_behavior_hint="")] = None
    """Index of the frame, from 1, as the first has nothing before it; the one in the middle if left
    out."""
    predictors: Annotated[
        tuple[str, ...], tyro.conf.arg(metavar="NAME…", help_behavior_hint="")
    ] = ()
    """Without a model, or with one that takes none, the predictors to show; if left out, those that
    `probevo train` takes by default, as far as the recording has what they need."""
    settings: Annotated[OdometryConfig, tyro.conf.arg(name="")] = field(
        default_factory=OdometryConfig
    )
    reading: Annotated[ReadSettings, tyro.conf.arg(name="")] = field(default_factory=ReadSettings)


def main(words: list[str]) -> None:
    """Parse the arguments, inspect, and write the page."""
    default = InspectArguments(None, tyro.MISSING)
    arguments = parse(InspectArguments, words, "inspect", default=default)
    settings = checked(arguments.settings)
    _check(arguments)
    if arguments.model is not None and is_sensor_file(arguments.model):
        _inspect_sensor(arguments, arguments.model)
        return
    from probevo.noise.model_io import load_model
    from probevo.output.inspection.subject import Subject
    from probevo.storage.lock import locked

    model = load_model(arguments.model) if arguments.model else None
    if model is not None and model.columns and arguments.predictors:
        raise InputError(
            "--predictors", "the model says which predictors it takes.", "Leave out one of the two."
        )
    frame = None
    name = arguments.model.name if arguments.model else ""
    with locked(arguments.out):
        if arguments.sequence is not None:
            frame = frame_view(arguments.sequence, arguments, settings, model=model)
        subject = Subject(name=name, model=model, frame=frame, units=known_units())
        print(write(arguments.out, subject))


def _inspect_sensor(arguments: InspectArguments, model: Path) -> None:
    """Write the page on a learned sensor, from its errors on a recording with truth.

    Raises:
        InputError: no recording is named, or a frame or predictors are.
    """
    if arguments.sequence is None:
        cure = "Name one with true poses: `probevo inspect SEQUENCE --model MODEL --out DIR`."
        raise InputError("SEQUENCE", "a sensor is inspected on a recording.", cure)
    if arguments.frame is not None or arguments.predictors:
        what = "a sensor has neither a frame nor predictors."
        raise InputError("--frame and --predictors", what, "Leave them out.")
    from probevo.output.inspection.sensor import write_sensor_inspection
    from probevo.sequences import open_sequence
    from probevo.sequences.content import is_among
    from probevo.storage.lock import locked

    reading = checked(arguments.reading)
    sequence = open_sequence(arguments.sequence, reading.format, **reading.format_options())
    recording = sequence.path.resolve().name
    with locked(arguments.out):
        errors = resolve(kind_of_file(model).errors)(model, sequence)
        lines = write_sensor_inspection(
            arguments.out,
            model.name,
            recording,
            errors=errors,
            learned_from_it=is_among(sequence, recordings_of_file(model)),
        )
    print("\n".join(lines))


def _check(arguments: InspectArguments) -> None:
    """Refuse arguments that contradict each other.

    Raises:
        InputError: neither a recording nor a model is named, or a frame of no recording.
    """
    if arguments.sequence is None and arguments.model is None:
        cure = (
            "Give a recording, a model, or both: `probevo inspect SEQUENCE --model MODEL --out"
            " DIR`."
        )
        raise InputError("SEQUENCE and --model", "neither a recording nor a model is named.", cure)
    if arguments.frame is not None and arguments.sequence is None:
        raise InputError(
            "--frame",
            "there is no recording to take it from.",
            "Name its folder, or leave --frame out.",
        )


def known_units() -> dict[str, str]:
    """Collect the unit of every column of every predictor, by its name."""
    from probevo.predictors import all_predictors

    return {
        column: unit
        for predictor in all_predictors().values()
        for column, unit in predictor.columns.items()
    }


def frame_view(
    path: Path,
    arguments: InspectArguments,
    settings: OdometryConfig,
    model: LearnedNoiseModel | None,
) -> FrameView:
    """Run over a recording up to a frame, and take its features; progress is shown on stderr.

    Args:
        path: the recording.
        arguments: which frame and, without a model, which predictors.
        settings: settings of the odometry.
        model: the noise model to run with; None for the default.

    Raises:
        InputError: the model belongs to another camera, the recording lacks what a predictor needs,
            there is no such frame, or it has no features.
    """
    from probevo.config.training import TrainSettings
    from probevo.noise.named import check_model_camera
    from probevo.predictors import PredictionSpace, prediction_space, space_for
    from probevo.sequences import open_sequence
    from probevo.training.sources import known_predictors

    reading = checked(arguments.reading)
    sequence = open_sequence(path, reading.format, **reading.format_options())
    if model is not None and not settings.any_camera:
        check_model_camera(str(arguments.model), model, sequence.camera)
    index = _frame_index(arguments.frame, len(sequence), path)
    if model is not None and model.columns:
        space = space_for(model.columns)
    elif arguments.predictors:
        space = prediction_space(arguments.predictors)
    else:
        space = PredictionSpace(known_predictors(TrainSettings(kind="knn"), [sequence]))
    return _view_of_frame(sequence, index, space, model=model, settings=settings)


def _frame_index(wanted: int | None, num_frames: int, path: Path) -> int:
    """Check the index of a frame; the frame in the middle by default."""
    if num_frames < 2:
        raise InputError(
            path, "it has one frame, and so no feature that was followed.", "Give a longer one."
        )
    if wanted is not None and not 1 <= wanted < num_frames:
        cure = (
            "The first frame, 0, has none before it from which features could be followed."
            if wanted == 0
            else ""
        )
        raise InputError(
            "--frame", f"is {wanted}; the recording has frames 1 to {num_frames - 1}.", cure
        )
    return num_frames // 2 if wanted is None else wanted


def _view_of_frame(
    sequence: Sequence,
    index: int,
    space: PredictionSpace,
    model: LearnedNoiseModel | None,
    settings: OdometryConfig,
) -> FrameView:
    """Run over a recording up to the frame of that index, and take its features."""
    from itertools import islice

    import cv2
    import numpy as np

    from probevo.cli.first_use import getting_ready
    from probevo.cli.progress import progress_bar
    from probevo.odometry import StereoOdometry
    from probevo.output.inspection.subject import FrameView
    from probevo.tracking.left_right import LeftRightCheck

    cv2.setNumThreads(1)
    odometry = StereoOdometry(
        sequence.camera, model, sequence.imu, config=settings, predictors=space
    )
    # Features are tracked, so that the odometry has to see all frames up to this one.
    farthest_px = np.zeros(2)
    left = None
    name = sequence.path.resolve().name
    left_right = LeftRightCheck(sequence.path, index + 1)
    with progress_bar(f"{name} up to frame {index}", getting_ready()) as show:
        for frame in islice(sequence, index + 1):
            odometry.step(frame)
            left_right.see(frame, odometry.tracks)
            seen_px = odometry.tracks.curr_px[:, :2].max(axis=0, initial=0.0)
            farthest_px = np.maximum(farthest_px, seen_px)
            left = frame.left
            show(frame.index + 1, index + 1)
    tracks = odometry.tracks
    if len(tracks) == 0:
        raise InputError(
            "--frame", f"frame {index} has no feature that was followed.", "Choose another one."
        )
    # Without an image, and without a known image size, the area in which features were seen.
    if left is not None:
        size_px = (left.shape[1], left.shape[0])
    elif sequence.camera.size_px is not None:
        size_px = sequence.camera.size_px
    else:
        width_px, height_px = (np.floor(farthest_px).astype(int) + 1).tolist()
        size_px = (width_px, height_px)
    return FrameView(
        recording=name,
        index=index,
        left=left,
        size_px=size_px,
        uv=tracks.curr_px[:, :2],
        columns={
            column: unit
            for predictor in space.predictors
            for column, unit in predictor.columns.items()
        },
        phi=odometry.phi,
    )


def write(out: Path, subject: Subject) -> str:
    """Write the page and the pictures of a subject; returns what to print."""
    from probevo.output.inspection.page import PAGE, write_inspection

    findings = write_inspection(out, subject)
    lines = [findings.text, ""]
    if findings.notes:
        lines += [*findings.notes, ""]
    if subject.frame is not None:
        lines.append(f"pictures: {out / f'frame-{subject.frame.index}'}")
    lines.append(f"page: {out / PAGE}")
    return "\n".join(lines)
