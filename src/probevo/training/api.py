"""The whole training: recordings → drives → iterations → noise model (``probevo train``)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from functools import reduce
from operator import add
from pathlib import Path
from typing import Any

from probevo.config.training import TrainSettings
from probevo.config.validation import checked_settings
from probevo.errors import InputError, brief
from probevo.noise.metric import Metric
from probevo.noise.model_io import save_model
from probevo.predictors import PredictionSpace, Predictor
from probevo.python_arguments import as_path
from probevo.storage.files import check_folder, name_as_text
from probevo.storage.lock import locked
from probevo.training.checkpoint import Checkpoint, checkpoint_folder
from probevo.training.gk.thinning import thinned
from probevo.training.progress import OnProgress, TrainingProgress
from probevo.training.recording import record_all
from probevo.training.settings_check import check_settings
from probevo.training.sources import (
    Recording,
    RecordingAt,
    Source,
    checked_sources,
    known_predictors,
)
from probevo.training.trainer import Trainer, TrainingContext, trainer_of
from probevo.training.workers import Workers

HERE = Workers()


def train_model(
    recordings: Sequence[Recording | str],
    settings: TrainSettings | Mapping[str, Any] | None,
    out: Path | str,
    on_progress: OnProgress | None = None,
    own_predictors: Sequence[Predictor] = (),
    *,
    workers: Workers = HERE,
) -> Path:
    """Learn a noise model from recordings and write it (PROBE Fig. 2; PROBE-GK Algs. 1 and 3).

    All intermediate results are kept in a folder beside ``out`` until the end, so that a training
    that was stopped resumes after the last complete recording, and after the last iteration of
    PROBE or of EM. The same recordings and settings give the same bytes on machines of one kind,
    however often the training was stopped, and whatever the workers are.

    Args:
        recordings: recordings of one camera. Paths are opened when they are needed, so that many
            need not be open at a time.
        settings: all settings, or a dictionary of those that differ from the defaults.
        out: the model file.
        on_progress: called after each frame and iteration; with other workers, from time to time by
            another thread.
        own_predictors: predictors besides the ones of the settings.
        workers: processes that go through the recordings; by default this one.

    Returns:
        ``out``.

    Raises:
        InputError: a recording is faulty, lacks what the supervision or a predictor needs, or has
            another camera; K is larger than the data; settings do not go together; ``out`` cannot
            be written to, or another process is learning it; or workers are lost.
    """
    # Refuse before the long work what would only show after it.
    recordings = _as_recordings(recordings)
    settings = checked_settings(settings, TrainSettings, example='{"kind": "gk"}', name="settings")
    out = as_path(out, "out")
    check_settings(settings)
    trainer = trainer_of(settings.kind)
    space = PredictionSpace((*known_predictors(settings, recordings), *own_predictors))
    sources = checked_sources(recordings, settings, space)
    check_folder(out.parent, "--out")
    try:
        is_folder = out.is_dir()
    except OSError as error:  # such as a name that is too long
        raise InputError("--out", f"{error.strerror}.", "Give the model another name.") from error
    if is_folder:
        raise InputError("--out", f"{out} is a folder.", "Give the model file another name.")

    # Each frame is gone through once for the recording, and once in each iteration.
    progress = TrainingProgress(
        frames=sum(source.num_frames for source in sources),
        iterations=trainer.num_iterations(settings),
        on_progress=on_progress,
    )
    # The lock keeps other processes from learning the same file.
    folder = checkpoint_folder(out)
    with locked(folder):
        _train(
            sources,
            settings,
            out,
            trainer=trainer,
            space=space,
            workers=workers,
            progress=progress,
        )
    with suppress(OSError):  # it holds files of others
        folder.rmdir()
    return out


def _as_recordings(recordings: object) -> list[Recording]:
    """Return recordings, some of which may be named by a ``str``.

    Raises:
        InputError: these are no recordings, or there are none.
    """
    cure = 'Give a list of recordings or of their folders, such as ["drive"].'
    if isinstance(recordings, str | Path) or not isinstance(recordings, Iterable):
        raise InputError("recordings", f"is {brief(recordings)}.", cure)
    named = [Path(each) if isinstance(each, str) else each for each in recordings]
    if not named:
        raise InputError("SEQUENCE", "no recording is named.", "Give the folder of at least one.")
    for each in named:
        if not isinstance(each, Path | RecordingAt) and not hasattr(each, "camera"):
            raise InputError("recordings", f"holds {brief(each)}.", cure)
    return named


def _train(
    sources: Sequence[Source],
    settings: TrainSettings,
    out: Path,
    *,
    trainer: Trainer,
    space: PredictionSpace,
    workers: Workers,
    progress: TrainingProgress,
) -> None:
    """Learn the model, while no other process does."""
    # Take up an earlier training of the same recordings and settings, if there is one.
    checkpoint = Checkpoint.opened(
        out,
        [source.facts for source in sources],
        [source.truth for source in sources],
        settings=settings,
        columns=space.columns,
    )

    # Track and solve each recording once; afterwards no image is needed.
    drives = [checkpoint.drive(number, source.camera) for number, source in enumerate(sources)]
    record_all(
        sources,
        drives,
        space,
        settings=settings,
        workers=workers,
        on_frames=progress.frames_recorded,
    )
    facts = [drive.facts for drive in drives]
    if not any(fact.features for fact in facts):
        raise InputError(
            "training data", "no recording shows a single feature.", "Give other recordings."
        )

    # Standardise the prediction space over the features of all drives.
    moments = reduce(add, (fact.moments for fact in facts))
    try:
        metric = Metric.of_moments(moments, space.columns, space.may_be_undefined)
    except InputError as error:
        if settings.predictors is not None:
            raise
        # Such as the last residual of two frames: whoever named no predictor can leave out none.
        cure = "Give a longer recording, or name other predictors with --predictors."
        raise InputError(error.where, error.what, cure) from error
    # Describe the recordings, for the model file.
    described = [
        {
            "name": name_as_text(source.path),
            "frames": source.num_frames,
            "sha256": fact.digest,
            "view": source.view,
        }
        for source, fact in zip(sources, facts, strict=True)
    ]
    # Where there are more steps than a training without truth can use, take a share of them.
    if trainer.thins_steps and settings.supervision == "none":
        drives = thinned(drives, settings.odometry.seed, workers)

    # Learn the model.
    context = TrainingContext(
        drives=drives,
        metric=metric,
        settings=settings,
        recordings=described,
        space=space,
        checkpoint=checkpoint,
        progress=progress,
        workers=workers,
    )
    save_model(trainer.learn(context), out)
    checkpoint.remove()
