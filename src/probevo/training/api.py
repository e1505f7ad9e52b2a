"""The whole training: recordings → drives → iterations → K and γ → a model. ``probevo train`` is this and a bar."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.likeness import difference
from probevo.errors import InputError
from probevo.noise import Fixed, StudentT
from probevo.noise.metric import Metric
from probevo.noise.model_io import save_model
from probevo.noise.nearest_neighbors import NearestNeighbors
from probevo.output.files import check_folder
from probevo.predictors import PredictionSpace, Predictor, prediction_space
from probevo.runner import check_imu
from probevo.sequences.base import Sequence
from probevo.training.checkpoint import Checkpoint
from probevo.training.drive import Drive, record_drive
from probevo.training.samples import Samples, fold_of_step, gather
from probevo.training.selection import Search, choose_exponent, choose_neighbors, out_of_fold
from probevo.training.settings import TrainSettings
from probevo.training.subsets import Learner
from probevo.training.supervision import Supervision, supervision_of

BASES = {"fixed": Fixed, "student-t": StudentT}
Progress = Callable[[int, int], None]
"""Takes how many frames have been looked at, those of all iterations counted, and how many will be."""


@dataclass(frozen=True)
class _Lesson:
    """A recording, and what is known of it."""

    sequence: Sequence
    num_frames: int
    supervision: Supervision


def train_model(
    sequences: Collection[Sequence],
    settings: TrainSettings,
    out: Path,
    on_progress: Progress | None = None,
    own_predictors: Collection[Predictor] = (),
) -> Path:
    """Learn a noise model from recordings and write it (PROBE Fig. 2).

    What is done is kept in a folder beside ``out`` until the end, so that a training that was stopped goes on from
    there: after the last recording that was through, and the last iteration. The same recordings and settings give the
    same bytes, however often it was stopped.

    Args:
        sequences: the recordings, of one camera.
        settings: all settings.
        out: the model file.
        on_progress: called after each frame and iteration.
        own_predictors: taken beside those of the settings.

    Returns:
        ``out``.

    Raises:
        InputError: a recording is faulty, lacks what the supervision or a predictor needs, or has another camera; K is
            larger than the data; or ``out`` cannot be written to.
    """
    space = PredictionSpace((*prediction_space(settings.predictors).predictors, *own_predictors))
    lessons = _lessons(sequences, settings)
    check_folder(out.parent, "--out")
    if out.is_dir():
        raise InputError("--out", f"{out} is a folder.", "Give the model file another name.")
    work = Checkpoint.opened(out, sequences, settings, space.columns)
    frames = sum(lesson.num_frames for lesson in lessons)

    def show(done: int) -> None:
        if on_progress is not None:
            on_progress(done, frames * (1 + settings.iterations))

    drives = _record(lessons, space, settings, work, show)
    if not any(len(drive.phi) for drive in drives):
        raise InputError("training data", "no recording shows a single feature.", "Give other recordings.")
    metric = Metric.fitted(np.concatenate([drive.phi for drive in drives]), space.columns, space.may_be_undefined)
    learners = [_learner(n, lesson, drives[n], metric, settings) for n, lesson in enumerate(lessons)]
    iterations = []
    for number in range(settings.iterations):
        done = work.iteration(number)
        if done is None:
            done = [learner.iterate(number) for learner in learners]
            work.keep_iteration(number, done)
        iterations.append(done)
        show(frames * (2 + number))
    model = _fit(gather(iterations, learners, settings), learners, metric, settings, lessons)
    save_model(model, out)
    work.remove()
    return out


def _lessons(sequences: Collection[Sequence], settings: TrainSettings) -> list[_Lesson]:
    """The recordings and what is known of them; refuses before the long work what would only show after it."""
    if not sequences:
        raise InputError("SEQUENCE", "no recording is named.", "Give the folder of at least one.")
    lessons = []
    for sequence in sequences:
        unlike = difference(sequence.camera, sequences[0].camera)
        if unlike:
            what = f"its camera is not that of {sequences[0].path}: {unlike}."
            raise InputError(sequence.path, what, "Train one model for each camera.")
        num_frames = min(len(sequence), settings.max_frames or len(sequence))
        if num_frames < 2:
            raise InputError(sequence.path, "it has one frame, and so no motion to learn from.", "Give a longer one.")
        check_imu(sequence, settings.odometry)
        supervision = supervision_of(sequence, settings.supervision, settings.every_s, num_frames)
        lessons.append(_Lesson(sequence, num_frames, supervision))
    return lessons


def _record(
    lessons: list[_Lesson],
    space: PredictionSpace,
    settings: TrainSettings,
    work: Checkpoint,
    show: Callable[[int], None],
) -> list[Drive]:
    drives: list[Drive] = []
    before = 0
    for number, lesson in enumerate(lessons):
        drive = work.drive(number)
        if drive is None:
            on_frame = lambda done, before=before: show(before + done)  # noqa: E731
            drive = record_drive(lesson.sequence, space, settings.odometry, lesson.num_frames, on_frame)
            work.keep_drive(number, drive)
        drives.append(drive)
        before += lesson.num_frames
        show(before)
    return drives


def _learner(number: int, lesson: _Lesson, drive: Drive, metric: Metric, settings: TrainSettings) -> Learner:
    return Learner(
        drive=drive,
        coordinates=metric.coordinates(drive.phi),
        supervision=lesson.supervision.completed(drive.T_curr_prev),
        camera=lesson.sequence.camera,
        base=BASES[settings.base](),
        solver=settings.odometry.solver,
        subset=settings.subset,
        contrast=settings.contrast,
        relative=settings.relative,
        seed=(settings.odometry.seed, number),
    )


def _fit(
    samples: Samples, learners: list[Learner], metric: Metric, settings: TrainSettings, lessons: list[_Lesson]
) -> NearestNeighbors:
    """The model of all samples, with K and γ given or chosen."""
    searches: dict[str, Search] = {}
    neighbors, exponent = settings.neighbors, settings.exponent
    coordinates = np.concatenate([learner.coordinates for learner in learners])[samples.features]
    logarithmic = settings.average == "geometric"
    values = np.log(samples.alphas) if logarithmic else samples.alphas
    if neighbors is None:
        searches["neighbors"] = choose_neighbors(coordinates, values, samples.fold)
        neighbors = int(searches["neighbors"].chosen)
    if exponent is None:
        relative = [
            _log_relative(learner, number, coordinates, values, samples.fold, neighbors, logarithmic)
            for number, learner in enumerate(learners)
        ]
        searches["exponent"] = choose_exponent(learners, relative)
        exponent = searches["exponent"].chosen
    training = {
        "settings": settings.model_dump(mode="json"),
        "recordings": [
            {"name": lesson.sequence.path.resolve().name, "frames": lesson.num_frames, "sha256": learner.drive.digest}
            for lesson, learner in zip(lessons, learners, strict=True)
        ],
        "searches": {name: search.as_dict() for name, search in searches.items()},
    }
    model = NearestNeighbors(
        neighbors, exponent, settings.average, BASES[settings.base](), learners[0].camera, training
    )
    predictors = np.concatenate([learner.drive.phi for learner in learners])[samples.features]
    return model.fit(predictors, samples.alphas, metric=metric)


def _log_relative(
    learner: Learner,
    number: int,
    coordinates: FloatArray,
    values: FloatArray,
    fold: IntArray,
    neighbors: int,
    logarithmic: bool,
) -> FloatArray:
    """ln(mean of the K nearest α / ᾱ) of every feature of a drive, [n], as learned from other blocks of time."""
    own = fold_of_step(learner.drive.step_of_feature, len(learner.drive.T_curr_prev), number)
    means, overall = out_of_fold(coordinates, values, fold, neighbors, learner.coordinates, own), float(values.mean())
    return means - overall if logarithmic else np.log(means / overall)
