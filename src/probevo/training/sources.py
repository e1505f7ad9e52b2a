"""The recordings that a training is given: checked before the work, and opened only when needed."""

from __future__ import annotations

from collections import abc
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from probevo.camera.likeness import difference_text
from probevo.camera.stereo import StereoCamera
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.predictors import Needs, PredictionSpace, Predictor, prediction_space
from probevo.run_checks import check_imu
from probevo.sequences import open_sequence
from probevo.sequences.base import Sequence
from probevo.sequences.content import digests_of_first_frames, show_the_same
from probevo.training.supervision import supervision_of
from probevo.training.trainer import trainer_of


@dataclass(frozen=True)
class RecordingAt:
    """A recording by its path, and how ``open_sequence`` is to open it."""

    path: Path
    format: str | None = None
    """Name of its format; recognised if None."""
    options: Mapping[str, Any] = field(default_factory=dict)
    """Options of the format, such as ``rate_hz``."""


Recording = Sequence | Path | RecordingAt
"""An open recording, or its path; a path is opened by whoever needs the recording, and closed
again."""


@dataclass(frozen=True)
class Source:
    """A recording that can be learned from."""

    recording: Recording
    path: Path
    camera: StereoCamera
    num_frames: int
    """Number of its frames that are used."""
    facts: list[Any]
    """Facts that identify the recording, in plain values that JSON can hold: its path, number of
    frames, first and last time, calibration, a digest of its first frames, and the options that it
    was opened with, if any."""
    view: str
    """Digest of what its first frames show (``sequences.content``)."""
    truth: str
    """Digest of the part of its ground truth that is used."""

    def open(self) -> Sequence:
        """Open the recording."""
        return opened(self.recording)


def opened(recording: Recording) -> Sequence:
    """Open a recording that is given by its path; return any other as it is."""
    if isinstance(recording, RecordingAt):
        return open_sequence(recording.path, recording.format, **recording.options)
    return open_sequence(recording) if isinstance(recording, Path) else recording


def checked_sources(
    recordings: abc.Sequence[Recording], settings: TrainSettings, space: PredictionSpace
) -> list[Source]:
    """Check the recordings, so that what is wrong shows before the long work.

    Raises:
        InputError: a recording is faulty, lacks what the supervision or a predictor needs, is named
            twice or shows the same as another one, or has another camera than the first.
    """
    sources: list[Source] = []
    seen: set[tuple[Path, str, str]] = set()
    for recording in recordings:
        sequence = opened(recording)

        # Named twice, it would weigh twice.
        path = sequence.path.resolve()
        # A folder may hold several, such as scenes, which an option chooses from.
        chosen = sorted(recording.options.items()) if isinstance(recording, RecordingAt) else []
        identity = (path, sequence.format, repr(chosen))
        if identity in seen:
            raise InputError(
                sequence.path,
                "this recording is named twice.",
                "Name each once: it would count double.",
            )
        seen.add(identity)

        # It must serve the predictors, and have the camera of the others: noise in pixels depends
        # on the camera.
        space.check_recording(sequence)
        unlike = difference_text(sequence.camera, sources[0].camera) if sources else ""
        if unlike:
            raise InputError(
                sequence.path,
                f"its camera is not that of {sources[0].path}: {unlike}.",
                "Train one model for each camera.",
            )

        # Frames, IMU and truth must suffice.
        num_frames = min(len(sequence), settings.max_frames or len(sequence))
        if num_frames < 2:
            raise InputError(
                sequence.path,
                "it has one frame, and so no motion to learn from.",
                "Give a longer one.",
            )
        first = digests_of_first_frames(sequence)
        for source in sources:
            if source.view != first.view or source.num_frames != num_frames:
                continue
            if show_the_same(sequence, source.open(), num_frames):
                raise InputError(
                    sequence.path,
                    f"its frames are those of {source.path}.",
                    "Give one of them: it would count double.",
                )
        check_imu(sequence, settings.odometry)
        supervision = supervision_of(
            sequence, settings.supervision, settings.every_s, num_frames=num_frames
        )

        # A resumed training must find the same recording again.
        facts = [
            str(path),
            len(sequence),
            sequence.stamps_ns[[0, -1]].tolist(),
            calibration(sequence),
            first.given,
        ]
        if isinstance(recording, RecordingAt):
            options = {name: str(value) for name, value in sorted(recording.options.items())}
            facts += [recording.format, options]
        source = Source(
            recording=recording,
            path=sequence.path,
            camera=sequence.camera,
            num_frames=num_frames,
            facts=facts,
            view=first.view,
            truth=supervision.digest,
        )
        sources.append(source)
    return sources


def calibration(sequence: Sequence) -> list[Any]:
    """Return the calibration of camera and IMU in plain values."""
    values = [*vars(sequence.camera).values()]
    if sequence.imu is not None:
        values += vars(sequence.imu).values()
    return [np.asarray(value).tolist() for value in values]


def known_predictors(
    settings: TrainSettings, recordings: abc.Sequence[Recording]
) -> tuple[Predictor, ...]:
    """Return the predictors that the settings name, or else the defaults of the kind of model.

    Of the defaults, those that need images are left out unless every recording has images.
    """
    default = trainer_of(settings.kind).default_predictors
    if not default:
        return ()
    if settings.predictors is not None:
        return prediction_space(settings.predictors).predictors
    has_images = all(opened(recording).camera.size_px is not None for recording in recordings)
    return tuple(
        predictor
        for predictor in prediction_space(default).predictors
        if has_images or not predictor.needs & Needs.IMAGES
    )
