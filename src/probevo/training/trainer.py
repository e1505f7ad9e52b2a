"""The interface of all trainers: drives in, a noise model out.

Each kind of noise model names its trainer in ``probevo.noise.registry``; nothing in ``training``
asks which kind it is.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from probevo.config.training import TrainSettings
from probevo.entry_points import imported
from probevo.errors import InputError
from probevo.noise.base import LearnedNoiseModel
from probevo.noise.metric import Metric
from probevo.noise.registry import noise_kinds
from probevo.predictors import PredictionSpace
from probevo.sensor_kinds import SENSOR_KINDS
from probevo.training.checkpoint import Checkpoint, NoCheckpoint
from probevo.training.progress import TrainingProgress
from probevo.training.supervised_drive import SupervisedDrive
from probevo.training.workers import Workers

OTHER_KIND = "Leave it out, or choose another --kind."
"""The cure of a setting that the chosen kind does not have."""


@dataclass(frozen=True)
class TrainingContext:
    """What a trainer learns from, and who does the work."""

    drives: Sequence[SupervisedDrive]
    """The recorded drives, each with the truth about its motion."""
    metric: Metric
    """Standardisation of the prediction space over all drives."""
    settings: TrainSettings
    recordings: Sequence[Mapping[str, Any]] = ()
    """Name, number of frames and digest of each recording, for the metadata of the model."""
    space: PredictionSpace = field(default_factory=lambda: PredictionSpace(()))
    """The predictors behind the columns of the metric."""
    checkpoint: Checkpoint | NoCheckpoint = field(default_factory=NoCheckpoint)
    """Iterations that are stored here need not be computed again."""
    progress: TrainingProgress = field(default_factory=TrainingProgress)
    workers: Workers = field(default_factory=Workers)
    """Processes that go through the drives; the model is fitted in this process."""


def _accept_all(settings: TrainSettings) -> None:
    """Accept all settings."""


@dataclass(frozen=True)
class Trainer:
    """A trainer, and what distinguishes its kind from others before and around the training."""

    learn: Callable[[TrainingContext], LearnedNoiseModel]
    """Learns the model."""
    num_iterations: Callable[[TrainSettings], int]
    """Gives the number of iterations over all drives, for the progress bar."""
    default_predictors: tuple[str, ...] = ()
    """Predictors where the settings name none; empty for a model that uses no predictors."""
    learns_from_positions: bool = False
    """Whether true positions without attitudes suffice (``--supervision position``)."""
    thins_steps: bool = False
    """Whether a share of the steps suffices where there are many and no truth links them."""
    unused_settings: Mapping[str, str] = field(default_factory=dict)
    """Settings that it does not use, e.g. ``gk.centers``, and for each the cure that is offered to
    whoever sets it."""
    check: Callable[[TrainSettings], None] = _accept_all
    """Refuses combinations of its own settings with an InputError."""


def trainer_of(kind: str) -> Trainer:
    """Look up the trainer of a kind of noise model.

    Raises:
        InputError: there is no such kind, it is not trained, or its trainer is no ``Trainer``.
    """
    kinds = noise_kinds()
    if kind not in kinds or not kinds[kind].trainer:
        trained = ", ".join(name for name, known in kinds.items() if known.trainer)
        sensors = ", ".join(SENSOR_KINDS)
        cure = f"Noise models are {trained}; networks that serve as sensors, {sensors}."
        raise InputError("--kind", f"{kind} cannot be trained.", cure)
    trainer = imported(kinds[kind].trainer)
    if not isinstance(trainer, Trainer):
        raise InputError(
            "--kind",
            f"{kinds[kind].trainer}, which learns {kind}, is not a Trainer.",
            "Name a probevo.training.trainer.Trainer in its NoiseKind.",
        )
    return trainer
