"""All iterations together, as samples: which feature took part in a motion, and how wrong that was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.errors import InputError
from probevo.training.checkpoint import Iteration
from probevo.training.probe.subsets import Learner
from probevo.training.settings import TrainSettings

FOLDS = 5
BLOCKS_A_DRIVE = 10


@dataclass(frozen=True)
class Samples:
    """N samples of all drives."""

    features: IntArray
    """Index of the feature among those of all drives, one drive after another, [N]."""
    alphas: FloatArray
    """Error α, [N]: in metres, or relative to what other subsets reached over the same stretch."""
    fold: IntArray
    """Fold of each sample, 0 … FOLDS − 1, [N]: blocks of time take turns, so that neighbours in
    time stay together."""
    left_out: IntArray
    """Another division, in which no two folds hold samples of one and the same α, [N]: that by
    time, or, of a drive with one α for all of its steps, that by iterations."""


def gather(
    iterations: Sequence[Iteration], learners: Sequence[Learner], settings: TrainSettings
) -> Samples:
    """The samples of all iterations, [iteration][drive].

    Raises:
        InputError: no subset of any step has a known error.
    """
    features = []
    alphas = []
    folds = []
    left_out = []
    before = 0
    for number, learner in enumerate(learners):
        taken = np.concatenate([iteration[number][0] for iteration in iterations])
        alpha = np.concatenate([iteration[number][1] for iteration in iterations])
        step = learner.drive.step_of_feature[taken]
        if settings.relative and len(alpha):
            stretch = learner.supervision.stretch_of_step(len(learner.drive.T_curr_prev))[step]
            alpha = _relative(alpha, stretch, logarithmic=settings.average == "geometric")
        features.append(before + taken)
        alphas.append(alpha)
        folds.append(folds_of_steps(learner, number)[step])
        turn = np.repeat(
            np.arange(len(iterations)), [len(iteration[number][0]) for iteration in iterations]
        )
        left_out.append(turn % FOLDS if len(learner.supervision.stretches) == 1 else folds[-1])
        before += len(learner.drive.phi)
    if not sum(map(len, alphas)):
        what = f"no step has {settings.subset} features to learn from and a true motion."
        raise InputError("training data", what, "Give other recordings, or a smaller --subset.")
    return Samples(
        np.concatenate(features),
        np.concatenate(alphas),
        np.concatenate(folds),
        left_out=np.concatenate(left_out),
    )


def folds_of_steps(learner: Learner, number: int) -> IntArray:
    """Fold of each of the K − 1 steps of the drive of that number: blocks of time, which part no
    stretch."""
    num_steps = len(learner.drive.T_curr_prev)
    stretches = learner.supervision.stretches
    start = np.arange(num_steps)
    if len(stretches) > 1:
        owner = learner.supervision.stretch_of_step(num_steps)
        start = np.where(owner >= 0, stretches[owner, 0], start)
    return fold_of_step(start, num_steps, number)


def fold_of_step(step: IntArray, num_steps: int, drive: int) -> IntArray:
    """Fold of each of some steps of a drive, given its number: [n] to [n]."""
    fold: IntArray = (step * BLOCKS_A_DRIVE // num_steps + drive) % FOLDS
    return fold


def _relative(alpha: FloatArray, stretch: IntArray, *, logarithmic: bool) -> FloatArray:
    """α over the mean of all α of the same stretch, [N]."""
    values = np.log(alpha) if logarithmic else alpha
    mean = np.bincount(stretch, values) / np.maximum(np.bincount(stretch), 1)
    relative: FloatArray = np.exp(values - mean[stretch]) if logarithmic else values / mean[stretch]
    return relative
