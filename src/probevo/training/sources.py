"""The recordings that a training is given: looked at, checked, and not held."""

from __future__ import annotations

from collections.abc import Sequence as Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from probevo.camera.likeness import difference
from probevo.camera.stereo import StereoCamera
from probevo.errors import InputError
from probevo.predictors import Needs, PredictionSpace, Predictor, prediction_space
from probevo.run_checks import check_imu
from probevo.sequences import open_sequence
from probevo.sequences.base import Sequence
from probevo.training.settings import DEFAULT, KERNEL, TrainSettings
from probevo.training.supervision import supervision_of

Recording = Sequence | Path
"""Open, or where it lies: then it is opened when it is needed, by whoever needs it, and closed
again."""


@dataclass(frozen=True)
class Source:
    """A recording that can be learned from."""

    recording: Recording
    path: Path
    camera: StereoCamera
    num_frames: int
    """Those that are used."""
    facts: list[Any]
    """By which it is known again, in plain values that JSON can hold: where it lies, how many
    frames it has, when it begins and ends, and its calibration."""
    truth: str
    """Digest of what is used of its truth."""

    def open(self) -> Sequence:
        """The recording."""
        return opened(self.recording)


def opened(recording: Recording) -> Sequence:
    """The recording."""
    return open_sequence(recording) if isinstance(recording, Path) else recording


def checked_sources(
    recordings: Collection[Recording], settings: TrainSettings, space: PredictionSpace
) -> list[Source]:
    """The recordings; refuses before the long work what would only show after it.

    Raises:
        InputError: a recording is faulty, lacks what the supervision or a predictor needs, is named
            twice, or has another camera than the first.
    """
    sources: list[Source] = []
    named: set[Path] = set()
    for recording in recordings:
        sequence = opened(recording)
        path = sequence.path.resolve()
        if path in named:
            raise InputError(
                sequence.path,
                "this recording is named twice.",
                "Name each once: it would count double.",
            )
        named.add(path)
        space.check_recording(sequence)
        unlike = difference(sequence.camera, sources[0].camera) if sources else ""
        if unlike:
            what = f"its camera is not that of {sources[0].path}: {unlike}."
            raise InputError(sequence.path, what, "Train one model for each camera.")
        num_frames = min(len(sequence), settings.max_frames or len(sequence))
        if num_frames < 2:
            raise InputError(
                sequence.path,
                "it has one frame, and so no motion to learn from.",
                "Give a longer one.",
            )
        check_imu(sequence, settings.odometry)
        truth = supervision_of(
            sequence, settings.supervision, settings.every_s, num_frames=num_frames
        ).digest
        facts = [
            str(path),
            len(sequence),
            sequence.stamps_ns[[0, -1]].tolist(),
            calibration(sequence),
        ]
        sources.append(
            Source(
                recording,
                sequence.path,
                sequence.camera,
                num_frames=num_frames,
                facts=facts,
                truth=truth,
            )
        )
    return sources


def calibration(sequence: Sequence) -> list[Any]:
    """Of camera and IMU, in plain values."""
    parts = [sequence.camera, *([] if sequence.imu is None else [sequence.imu])]
    return [np.asarray(value).tolist() for part in parts for value in vars(part).values()]


def known_predictors(
    settings: TrainSettings, recordings: Collection[Recording]
) -> tuple[Predictor, ...]:
    """Those that are named, or those that suit the kind and that every recording can serve."""
    if settings.kind == "student-t":
        return ()
    if settings.predictors is not None:
        return prediction_space(settings.predictors).predictors
    images = all(opened(recording).camera.size_px is not None for recording in recordings)
    suited = prediction_space(DEFAULT if settings.kind == "knn" else KERNEL).predictors
    return tuple(p for p in suited if images or not p.needs & (Needs.LEFT | Needs.PREVIOUS_LEFT))
