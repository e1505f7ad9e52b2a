"""The trainer of PROBE (PROBE Fig. 2): motions of random subsets of features, and their errors.

In each iteration, every step of every drive is solved with a random subset of its features. The
error α of that motion becomes a sample at the point of each feature of the subset. A model predicts
the mean α of the nearest neighbours in the prediction space.
"""

from __future__ import annotations

from dataclasses import dataclass

from probevo.config.training import PROBE_PREDICTORS, KernelSettings, TrainSettings
from probevo.noise.metric import Metric
from probevo.noise.probe.nearest_neighbors import NearestNeighbors
from probevo.noise.registry import untrained_model
from probevo.training.drive import joined
from probevo.training.probe.fitting import fit_model
from probevo.training.probe.samples import gather_samples
from probevo.training.probe.subsets import SubsetErrors, SubsetSampler
from probevo.training.supervised_drive import SupervisedDrive
from probevo.training.trainer import OTHER_KIND, Trainer, TrainingContext


@dataclass(frozen=True)
class _Task:
    """One iteration over one drive."""

    number: int
    drive: SupervisedDrive
    metric: Metric
    settings: TrainSettings
    iteration: int


def learn_nearest_neighbors(context: TrainingContext) -> NearestNeighbors:
    """Learn the model of PROBE (PROBE Fig. 2, ``TrainPROBEModel``).

    In the end all drives are held in memory: the model consists of their features.
    """
    names = [recording["name"] for recording in context.recordings]
    iterations = []
    for iteration in range(context.settings.iterations):
        # Solve each step with a random subset of its features, unless this iteration is stored.
        subsets = context.checkpoint.iteration(iteration)
        if subsets is None:
            tasks = [
                _Task(
                    number=number,
                    drive=drive,
                    metric=context.metric,
                    settings=context.settings,
                    iteration=iteration,
                )
                for number, drive in enumerate(context.drives)
            ]
            subsets = context.workers.map(_iterate, tasks, names)
            context.checkpoint.keep_iteration(iteration, subsets)
        iterations.append(subsets)
        context.progress.iteration_done()

    # Pair the errors α with the points φ of the features, and fit K and γ.
    samplers = [
        _sampler(number, drive, context.metric, context.settings)
        for number, drive in enumerate(context.drives)
    ]
    samples = gather_samples(iterations, samplers, context.settings)
    return fit_model(samples, samplers, context)


def _iterate(task: _Task) -> SubsetErrors:
    """Do one iteration over one drive."""
    sampler = _sampler(task.number, task.drive, task.metric, task.settings)
    return sampler.iterate(task.iteration)


def _sampler(
    number: int, supervised: SupervisedDrive, metric: Metric, settings: TrainSettings
) -> SubsetSampler:
    """Read a drive into memory and prepare its iterations."""
    # Subsets lean in directions of the whole prediction space, so that the drive is read whole.
    drive = joined(supervised.parts())
    return SubsetSampler(
        drive=drive,
        coordinates=metric.coordinates(drive.phi),
        supervision=supervised.supervision.completed(drive.T_curr_prev),
        camera=supervised.camera,
        base=untrained_model(settings.base),
        solver=settings.odometry.solver,
        subset=settings.subset,
        contrast=settings.contrast,
        divides_by_predicted=settings.relative,
        seed=(settings.odometry.seed, number),
    )


def num_iterations(settings: TrainSettings) -> int:
    """Return how often each step is solved with a random subset."""
    return settings.iterations


KNN_TRAINER = Trainer(
    learn=learn_nearest_neighbors,
    num_iterations=num_iterations,
    default_predictors=PROBE_PREDICTORS,
    learns_from_positions=True,
    unused_settings={f"gk.{name}": OTHER_KIND for name in KernelSettings.model_fields},
)
