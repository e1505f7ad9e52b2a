"""PROBE from drives: motions of random subsets of their features, iteration after iteration, then K
and γ."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from probevo.arrays import FloatArray, IntArray
from probevo.noise.metric import Metric
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.noise.registry import untrained_model
from probevo.training.checkpoint import Checkpoint
from probevo.training.drive import joined
from probevo.training.probe.fitting import fit_model
from probevo.training.probe.samples import gather
from probevo.training.probe.subsets import Learner
from probevo.training.settings import TrainSettings
from probevo.training.supervised_drive import SupervisedDrive
from probevo.training.workers import Workers


@dataclass(frozen=True)
class _Task:
    """A drive in an iteration."""

    number: int
    drive: SupervisedDrive
    metric: Metric
    settings: TrainSettings
    iteration: int


def learn_neighbors(
    drives: Sequence[SupervisedDrive],
    metric: Metric,
    settings: TrainSettings,
    recordings: Sequence[Mapping[str, Any]],
    work: Checkpoint,
    on_turn: Callable[[], None],
    workers: Workers,
) -> NearestNeighbors:
    """The model of the drives.

    Args:
        drives: the drives, and what is known of them. In the end all are held in memory: the model
            is made of them.
        metric: of the prediction space.
        settings: all settings.
        recordings: what the model should remember of each recording.
        work: what is done so far.
        on_turn: called after each iteration.
        workers: who goes through the drives.
    """
    names = [recording["name"] for recording in recordings]
    iterations = []
    for iteration in range(settings.iterations):
        done = work.iteration(iteration)
        if done is None:
            tasks = [
                _Task(n, drive, metric, settings=settings, iteration=iteration)
                for n, drive in enumerate(drives)
            ]
            done = workers.map(_iterate, tasks, names)
            work.keep_iteration(iteration, done)
        iterations.append(done)
        on_turn()
    learners = [_learner(n, drive, metric, settings=settings) for n, drive in enumerate(drives)]
    return fit_model(
        gather(iterations, learners, settings),
        learners,
        metric,
        settings=settings,
        recordings=recordings,
    )


def _iterate(task: _Task) -> tuple[IntArray, FloatArray]:
    return _learner(task.number, task.drive, task.metric, settings=task.settings).iterate(
        task.iteration
    )


def _learner(
    number: int, supervised: SupervisedDrive, metric: Metric, settings: TrainSettings
) -> Learner:
    drive = joined(supervised.parts())
    return Learner(
        drive=drive,
        coordinates=metric.coordinates(drive.phi),
        supervision=supervised.supervision.completed(drive.T_curr_prev),
        camera=supervised.camera,
        base=untrained_model(settings.base),
        solver=settings.odometry.solver,
        subset=settings.subset,
        contrast=settings.contrast,
        relative=settings.relative,
        seed=(settings.odometry.seed, number),
    )
