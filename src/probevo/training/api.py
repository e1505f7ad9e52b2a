"""The whole training: recordings → drives → iterations → K and γ → a model. ``probevo train`` is this and a bar."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.camera.likeness import difference
from probevo.errors import InputError
from probevo.noise.metric import Metric
from probevo.noise.model_io import save_model
from probevo.noise.named import BASES
from probevo.noise.nearest_neighbors import NearestNeighbors
from probevo.output.files import check_folder
from probevo.predictors import Needs, PredictionSpace, Predictor, prediction_space
from probevo.runner import check_imu
from probevo.sequences.base import Sequence
from probevo.training.checkpoint import Checkpoint
from probevo.training.drive import Drive, record_drive
from probevo.training.expectation_maximization import Lesson as TrackedLesson
from probevo.training.expectation_maximization import learn_kernel, learn_student_t, num_turns
from probevo.training.fitting import fit_model
from probevo.training.samples import gather
from probevo.training.settings import DEFAULT, KERNEL, TrainSettings
from probevo.training.settings_check import check_settings
from probevo.training.subsets import Learner
from probevo.training.supervision import Supervision, supervision_of

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
    """Learn a noise model from recordings and write it (PROBE Fig. 2; PROBE-GK Algs. 1 and 3).

    What is done is kept in a folder beside ``out`` until the end, so that a training that was stopped goes on from
    there: after the last recording that was through, and the last iteration of PROBE; EM, which takes a minute or two,
    starts anew. The same recordings and settings give the same bytes on one machine, however often it was stopped.

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
            larger than the data; settings do not go together; or ``out`` cannot be written to.
    """
    if not sequences:
        raise InputError("SEQUENCE", "no recording is named.", "Give the folder of at least one.")
    check_settings(settings)
    space = PredictionSpace((*_known_predictors(settings, sequences), *own_predictors))
    lessons = _lessons(sequences, settings, space)
    check_folder(out.parent, "--out")
    if out.is_dir():
        raise InputError("--out", f"{out} is a folder.", "Give the model file another name.")
    work = Checkpoint.opened(out, sequences, settings, space.columns)
    frames = sum(lesson.num_frames for lesson in lessons)

    def show(done: int) -> None:
        if on_progress is not None:
            on_progress(done, frames * (1 + (settings.iterations if settings.kind == "knn" else num_turns(settings))))

    drives = _record(lessons, space, settings, work, show)
    if not any(len(drive.phi) for drive in drives):
        raise InputError("training data", "no recording shows a single feature.", "Give other recordings.")
    metric = Metric.fitted(np.concatenate([drive.phi for drive in drives]), space.columns, space.may_be_undefined)
    recordings = [
        {"name": lesson.sequence.path.resolve().name, "frames": lesson.num_frames, "sha256": drive.digest}
        for lesson, drive in zip(lessons, drives, strict=True)
    ]
    turns = 0

    def next_turn() -> None:
        nonlocal turns
        turns += 1
        show(frames * (1 + turns))

    def within_turn(done: int, total: int) -> None:
        show(frames * (1 + turns) + frames * done // max(total, 1))

    if settings.kind == "knn":
        save_model(_learn_neighbors(lessons, drives, metric, settings, work, recordings, next_turn), out)
    else:
        known = [
            TrackedLesson(drive, lesson.sequence.camera, lesson.supervision)
            for lesson, drive in zip(lessons, drives, strict=True)
        ]
        if settings.kind == "gk":
            model = learn_kernel(known, metric, settings, recordings, next_turn, within_turn)
            save_model(model.kept(_of_use(space, model.metric_.weight)), out)
        else:
            save_model(learn_student_t(known, settings, recordings, next_turn), out)
    work.remove()
    return out


def _learn_neighbors(
    lessons: list[_Lesson],
    drives: list[Drive],
    metric: Metric,
    settings: TrainSettings,
    work: Checkpoint,
    recordings: list[dict[str, Any]],
    next_turn: Callable[[], None],
) -> NearestNeighbors:
    learners = [_learner(n, lesson, drives[n], metric, settings) for n, lesson in enumerate(lessons)]
    iterations = []
    for number in range(settings.iterations):
        done = work.iteration(number)
        if done is None:
            done = [learner.iterate(number) for learner in learners]
            work.keep_iteration(number, done)
        iterations.append(done)
        next_turn()
    return fit_model(gather(iterations, learners, settings), learners, metric, settings, recordings)


def _known_predictors(settings: TrainSettings, sequences: Collection[Sequence]) -> tuple[Predictor, ...]:
    """Those that are named, or those that suit the kind and that every recording can serve."""
    if settings.kind == "student-t":
        return ()
    if settings.predictors is not None:
        return prediction_space(settings.predictors).predictors
    images = all(sequence.camera.size_px is not None for sequence in sequences)
    suited = prediction_space(DEFAULT if settings.kind == "knn" else KERNEL).predictors
    return tuple(p for p in suited if images or not p.needs & (Needs.LEFT | Needs.PREVIOUS_LEFT))


def _of_use(space: PredictionSpace, weight: FloatArray) -> IntArray:
    """Columns of the predictors that have a say, as a whole or in part; a run need not compute the others."""
    owner = np.repeat(np.arange(len(space.predictors)), [len(predictor.columns) for predictor in space.predictors])
    return np.flatnonzero(np.isin(owner, owner[weight > 0.0]))


def _lessons(sequences: Collection[Sequence], settings: TrainSettings, space: PredictionSpace) -> list[_Lesson]:
    """The recordings and what is known of them; refuses before the long work what would only show after it."""
    lessons: list[_Lesson] = []
    for sequence in sequences:
        if any(sequence.path.resolve() == lesson.sequence.path.resolve() for lesson in lessons):
            raise InputError(sequence.path, "this recording is named twice.", "Name each once: it would count double.")
        space.check_recording(sequence)
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
