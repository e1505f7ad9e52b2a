"""The whole training: recordings → drives → iterations → K and γ → a model. ``probevo train`` is
this and a bar."""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Collection
from functools import reduce
from operator import add
from pathlib import Path

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.files import check_folder
from probevo.noise.metric import Metric
from probevo.noise.model_io import save_model
from probevo.predictors import PredictionSpace, Predictor
from probevo.training.checkpoint import Checkpoint
from probevo.training.gk.expectation_maximization import (
    Course,
    learn_kernel,
    learn_student_t,
    num_turns,
)
from probevo.training.gk.thinning import thinned
from probevo.training.probe.learn import learn_neighbors
from probevo.training.recording import record_all
from probevo.training.settings import TrainSettings
from probevo.training.settings_check import check_settings
from probevo.training.sources import Recording, checked_sources, known_predictors
from probevo.training.workers import Workers

Progress = Callable[[int, int], None]
"""Takes how many frames have been looked at, those of all iterations counted, and how many will be.
"""


HERE = Workers()


def train_model(
    recordings: Collection[Recording],
    settings: TrainSettings,
    out: Path,
    on_progress: Progress | None = None,
    own_predictors: Collection[Predictor] = (),
    workers: Workers = HERE,
) -> Path:
    """Learn a noise model from recordings and write it (PROBE Fig. 2; PROBE-GK Algs. 1 and 3).

    What is done is kept in a folder beside ``out`` until the end, so that a training that was
    stopped goes on from there: after the last recording that was through, and the last iteration of
    PROBE or turn of EM. The same recordings and settings give the same bytes on machines of one
    kind, however often it was stopped, and whoever and how many the workers are.

    Args:
        recordings: of one camera; paths are opened when they are needed, so that many need not be
            held at a time.
        settings: all settings.
        out: the model file.
        on_progress: called after each frame and iteration; with other workers, from time to time by
            another thread.
        own_predictors: taken beside those of the settings.
        workers: who goes through the recordings; this process alone by default.

    Returns:
        ``out``.

    Raises:
        InputError: a recording is faulty, lacks what the supervision or a predictor needs, or has
            another camera; K is larger than the data; settings do not go together; ``out`` cannot
            be written to; or workers are lost.
    """
    if not recordings:
        raise InputError("SEQUENCE", "no recording is named.", "Give the folder of at least one.")
    check_settings(settings)
    space = PredictionSpace((*known_predictors(settings, recordings), *own_predictors))
    sources = checked_sources(recordings, settings, space)
    check_folder(out.parent, "--out")
    if out.is_dir():
        raise InputError("--out", f"{out} is a folder.", "Give the model file another name.")
    known_by = [source.facts for source in sources]
    truths = [source.truth for source in sources]
    work = Checkpoint.opened(out, known_by, truths, settings=settings, columns=space.columns)
    drives = [work.drive(number, source.camera) for number, source in enumerate(sources)]
    bar = _Bar(sum(source.num_frames for source in sources), settings, on_progress)
    record_all(sources, drives, space, settings=settings, workers=workers, on_frames=bar.show)
    facts = [drive.facts for drive in drives]
    if not any(fact.features for fact in facts):
        raise InputError(
            "training data", "no recording shows a single feature.", "Give other recordings."
        )
    metric = Metric.of_moments(
        reduce(add, (f.moments for f in facts)), space.columns, space.may_be_undefined
    )
    known = [
        {"name": source.path.resolve().name, "frames": source.num_frames, "sha256": fact.digest}
        for source, fact in zip(sources, facts, strict=True)
    ]
    if settings.kind != "knn" and settings.supervision == "none":
        drives = thinned(drives, settings.odometry.seed, workers)
    course = Course(workers, work, bar.next_turn, on_part=bar.within_turn)
    if settings.kind == "knn":
        save_model(
            learn_neighbors(
                drives,
                metric,
                settings,
                recordings=known,
                work=work,
                on_turn=bar.next_turn,
                workers=workers,
            ),
            out,
        )
    elif settings.kind == "gk":
        model = learn_kernel(drives, metric, settings, recordings=known, course=course)
        save_model(model.kept(_of_use(space, model.metric_.weight)), out)
    else:
        save_model(learn_student_t(drives, settings, known, course=course), out)
    work.remove()
    return out


class _Bar:
    """Progress in frames: each iteration or turn counts as once through all recordings."""

    def __init__(self, frames: int, settings: TrainSettings, on_progress: Progress | None) -> None:
        turns = settings.iterations if settings.kind == "knn" else num_turns(settings)
        self.frames, self.total, self.turns, self.on_progress = (
            frames,
            frames * (1 + turns),
            0,
            on_progress,
        )

    def show(self, done: int) -> None:
        if self.on_progress is not None:
            self.on_progress(done, self.total)

    def next_turn(self) -> None:
        self.turns += 1
        self.show(self.frames * (1 + self.turns))

    def within_turn(self, share: float) -> None:
        self.show(round(self.frames * (1 + self.turns + share)))


def _of_use(space: PredictionSpace, weight: FloatArray) -> IntArray:
    """Columns of the predictors that contribute, as a whole or in part; a run need not compute the
    others."""
    owner = np.repeat(
        np.arange(len(space.predictors)), [len(predictor.columns) for predictor in space.predictors]
    )
    return np.flatnonzero(np.isin(owner, owner[weight > 0.0]))
