"""``probevo inspect``: what a noise model learned, and how it sees the features of a frame (PROBE
Figs. 6, 7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from probevo.cli.arguments import checked, parse
from probevo.cli.text import table
from probevo.config import OdometryConfig
from probevo.errors import InputError
from probevo.run_config import FORMAT_HELP

if TYPE_CHECKING:
    from probevo.noise.base import LearnedNoiseModel
    from probevo.noise.gk.generalized_kernel import GeneralizedKernel
    from probevo.output.inspection_data import FrameView
    from probevo.predictors import PredictionSpace
    from probevo.sequences import Sequence

PAGE = "inspection.html"


@dataclass(frozen=True)
class InspectArguments:
    """What a noise model learned, and how it sees the features of a frame.

    Writes inspection.html and, of a recording, frame-K/ with a picture for each predictor and for
    what the model makes of them, weights or σ and ν: the features of frame K in the colour of their
    values. Without MODEL, it shows the predictors alone; without SEQUENCE, the model alone. The
    recording is run from its start up to frame K, with the model, since features are followed.
    """

    sequence: Annotated[
        tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="SEQUENCE", help_behavior_hint="")
    ]
    """Folder of the recording, or a tracks file (.npz)."""
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
    format: Annotated[str | None, tyro.conf.arg(help=FORMAT_HELP, help_behavior_hint="")] = None
    settings: Annotated[OdometryConfig, tyro.conf.arg(name="")] = field(
        default_factory=OdometryConfig
    )


def main(words: list[str]) -> None:
    """Parse, look, write."""
    arguments = parse(
        InspectArguments, words, "inspect", default=InspectArguments(None, tyro.MISSING)
    )
    settings = checked(arguments.settings)
    _check(arguments)
    from probevo.files import check_folder
    from probevo.noise.model_io import load_model

    check_folder(arguments.out, "--out")
    model = load_model(arguments.model) if arguments.model else None
    if model is not None and model.columns and arguments.predictors:
        raise InputError(
            "--predictors", "the model says which predictors it takes.", "Leave out one of the two."
        )
    frame = (
        frame_view(arguments.sequence, arguments, settings, model=model)
        if arguments.sequence
        else None
    )
    print(write(arguments.out, arguments.model.name if arguments.model else "", model, frame=frame))


def _check(arguments: InspectArguments) -> None:
    """Refuse words that do not go together."""
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
    """Unit of every column of every predictor."""
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
    """Run over the recording up to the frame; shows on stderr how far it is.

    Raises:
        InputError: the model belongs to another camera, the recording lacks what a predictor needs,
            there is no such frame, or it has no features.
    """
    from probevo.noise.named import check_model_camera
    from probevo.predictors import PredictionSpace, prediction_space, space_for
    from probevo.sequences import open_sequence
    from probevo.training.settings import TrainSettings
    from probevo.training.sources import known_predictors

    sequence = open_sequence(path, arguments.format)
    if model is not None:
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
    from itertools import islice

    import cv2
    import numpy as np

    from probevo.cli.first_use import getting_ready
    from probevo.cli.progress import progress_bar
    from probevo.noise.gk.generalized_kernel import GeneralizedKernel
    from probevo.noise.probe.nearest_neighbors import NearestNeighbors
    from probevo.odometry import StereoOdometry
    from probevo.output.inspection_data import FrameView, neighbor_radius

    cv2.setNumThreads(1)
    odometry = StereoOdometry(
        sequence.camera, model, sequence.imu, config=settings, predictors=space
    )
    corner_px = np.zeros(2)
    left = None
    name = sequence.path.resolve().name
    with progress_bar(f"{name} up to frame {index}", getting_ready()) as show:
        for frame in islice(sequence, index + 1):
            odometry.step(frame)
            corner_px = np.maximum(
                corner_px, odometry.tracks.curr_px[:, :2].max(axis=0, initial=0.0)
            )
            left = frame.left
            show(frame.index + 1, index + 1)
    tracks = odometry.tracks
    phi = odometry.phi
    if len(tracks) == 0:
        raise InputError(
            "--frame", f"frame {index} has no feature that was followed.", "Choose another one."
        )
    seen_px = tuple((np.floor(corner_px).astype(int) + 1).tolist())
    return FrameView(
        recording=name,
        index=index,
        left=left,
        size_px=(
            (left.shape[1], left.shape[0])
            if left is not None
            else sequence.camera.size_px or seen_px
        ),
        uv=tracks.curr_px[:, :2],
        columns={
            column: unit
            for predictor in space.predictors
            for column, unit in predictor.columns.items()
        },
        phi=phi,
        beta=model.weights(phi) if isinstance(model, NearestNeighbors) else None,
        radius=neighbor_radius(model, phi) if isinstance(model, NearestNeighbors) else None,
        noise=model.predict(phi) if isinstance(model, GeneralizedKernel) else None,
    )


def write(out: Path, name: str, model: LearnedNoiseModel | None, frame: FrameView | None) -> str:
    """Write pictures and page of the model of that name; returns what to print."""
    from probevo.noise.gk.generalized_kernel import GeneralizedKernel
    from probevo.noise.probe.nearest_neighbors import NearestNeighbors
    from probevo.noise.student_t import StudentT
    from probevo.output.inspection_data import ModelView, column_summaries
    from probevo.output.inspection_page import write_inspection
    from probevo.output.inspection_pictures import frame_pictures
    from probevo.output.inspection_sections import SUMMARY_HEAD, summary_rows

    if isinstance(model, GeneralizedKernel):
        return _write_kernel(out, name, model, frame=frame)
    view = ModelView.of(name, model, known_units()) if isinstance(model, NearestNeighbors) else None
    pictures = frame_pictures(view, frame) if frame is not None else {}
    _write_pictures(out, frame, pictures)
    summaries = column_summaries(view, frame)
    if isinstance(model, StudentT):
        from probevo.output.inspection_student_page import write_student_inspection
        from probevo.output.model_facts import SCALE_HEAD, scale_rows

        write_student_inspection(
            out / PAGE, name, model, frame=frame, pictures=pictures, summaries=summaries
        )
        lines = [table(SCALE_HEAD, scale_rows(model.scale_)), f"ν = {model.dof_:.3g}"]
    else:
        write_inspection(out / PAGE, view, frame, pictures=pictures, summaries=summaries)
        lines = [table(SUMMARY_HEAD, summary_rows(summaries))]
    return _said(out, frame, lines)


def _write_kernel(out: Path, name: str, model: GeneralizedKernel, frame: FrameView | None) -> str:
    from probevo.output.inspection_kernel_data import KernelView
    from probevo.output.inspection_kernel_page import (
        KERNEL_HEAD,
        kernel_rows,
        share_out_of_domain,
        write_kernel_inspection,
    )
    from probevo.output.inspection_kernel_pictures import kernel_pictures
    from probevo.output.inspection_sections import percent

    view = KernelView.of(name, model, known_units())
    pictures = kernel_pictures(view, frame) if frame is not None else {}
    _write_pictures(out, frame, pictures)
    write_kernel_inspection(out / PAGE, view, frame, pictures=pictures)
    lines = [table(KERNEL_HEAD, kernel_rows(view, frame))]
    if frame is not None:
        lines += ["", f"out of domain: {percent(share_out_of_domain(frame))} of the features"]
    return _said(out, frame, lines)


def _write_pictures(
    out: Path, frame: FrameView | None, pictures: Mapping[str, tuple[str, bytes]]
) -> None:
    from probevo.files import remove_stale, write_atomically

    if frame is None:
        return
    folder = out / f"frame-{frame.index}"
    for name in {"weight", "distance", "sigma", "dof", *known_units()} - set(pictures):
        remove_stale(folder / f"{name}.jpg")
    for name, (_, jpeg) in pictures.items():
        write_atomically(folder / f"{name}.jpg", jpeg)


def _said(out: Path, frame: FrameView | None, lines: list[str]) -> str:
    pictures = [f"pictures: {out / f'frame-{frame.index}'}"] if frame is not None else []
    return "\n".join([*lines, "", *pictures, f"page: {out / PAGE}"])
