"""Samples of PROBE: which feature took part in a motion, and how wrong that motion was."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from probevo.arrays import FloatArray, IntArray
from probevo.config.training import TrainSettings
from probevo.errors import InputError
from probevo.training.checkpoint import Iteration
from probevo.training.probe.subsets import SubsetSampler

FOLDS = 5
BLOCKS_A_DRIVE = 10


@dataclass(frozen=True)
class Samples:
    """The N samples of all drives."""

    features: IntArray
    """Index of the feature among the features of all drives, one drive after another, [N]."""
    alphas: FloatArray
    """Error α of each sample, [N]: in metres, or relative to the mean over the same stretch."""
    fold_by_time: IntArray
    """Fold of each sample, 0 … FOLDS − 1, [N]: blocks of time alternate, so that samples that are
    close in time share a fold."""
    fold_by_error: IntArray
    """Folds of which no two hold samples of one and the same α, [N]: those by time, or, of a drive
    with one α for all its steps, those by iteration."""


def gather_samples(
    iterations: Sequence[Iteration], samplers: Sequence[SubsetSampler], settings: TrainSettings
) -> Samples:
    """Gather the samples of all iterations, [iteration][drive].

    Raises:
        InputError: no subset of any step has a known error.
    """
    features = []
    alphas = []
    folds_by_time = []
    folds_by_error = []
    first_feature = 0
    for number, sampler in enumerate(samplers):
        # All iterations over this drive, one after another.
        sampled = np.concatenate([iteration[number].features for iteration in iterations])
        # One entry for each feature of each subset, whose motion gave it its α.
        alpha = np.concatenate([iteration[number].alphas for iteration in iterations])
        step = sampler.drive.step_of_feature[sampled]
        # An error that all subsets of a stretch share says nothing about single features.
        if settings.relative and len(alpha):
            stretch = sampler.supervision.stretch_of_step(len(sampler.drive.T_curr_prev))[step]
            alpha = _relative(alpha, stretch, is_logarithmic=settings.average == "geometric")
        features.append(first_feature + sampled)
        alphas.append(alpha)

        # Folds by time; samples of one α that covers the whole drive are divided by iterations.
        fold_by_time = folds_of_steps(sampler, number)[step]
        folds_by_time.append(fold_by_time)
        if len(sampler.supervision.stretches) == 1:
            counts = [len(iteration[number].features) for iteration in iterations]
            folds_by_error.append(np.repeat(np.arange(len(iterations)), counts) % FOLDS)
        else:
            folds_by_error.append(fold_by_time)
        first_feature += len(sampler.drive.phi)
    if not sum(map(len, alphas)):
        raise InputError(
            "training data",
            f"no step has {settings.subset} features to learn from and a true motion.",
            "Give other recordings, or a smaller --subset.",
        )
    return Samples(
        features=np.concatenate(features),
        alphas=np.concatenate(alphas),
        fold_by_time=np.concatenate(folds_by_time),
        fold_by_error=np.concatenate(folds_by_error),
    )


def folds_of_steps(sampler: SubsetSampler, number: int) -> IntArray:
    """Return the fold of each of the K − 1 steps of a drive, given its number.

    Folds are blocks of time, and no stretch of the supervision is divided between two. With fewer
    stretches than blocks, each is a block: of two stretches, the second begins half-way, where the
    blocks of time have the same fold as at the start.
    """
    num_steps = len(sampler.drive.T_curr_prev)
    stretches = sampler.supervision.stretches
    start = np.arange(num_steps)
    if 1 < len(stretches) < BLOCKS_A_DRIVE:
        # Steps before the first stretch belong to it, and those behind the last to that one.
        last_begun = np.searchsorted(stretches[:, 0], start, side="right") - 1
        return fold_of_step(np.maximum(last_begun, 0), len(stretches), number)
    # A step belongs to the fold of the first step of its stretch.
    if len(stretches) > 1:
        stretch = sampler.supervision.stretch_of_step(num_steps)
        start = np.where(stretch >= 0, stretches[stretch, 0], start)
    return fold_of_step(start, num_steps, number)


def fold_of_step(step: IntArray, num_steps: int, drive: int) -> IntArray:
    """Return the fold of each of some steps of a drive, given its number: [n] to [n].

    Of fewer steps than blocks, each is a block.
    """
    block = step * BLOCKS_A_DRIVE // num_steps if num_steps > BLOCKS_A_DRIVE else step
    # The drive's number shifts the folds, so that the first blocks of all drives are not one fold.
    fold: IntArray = (block + drive) % FOLDS
    return fold


def _relative(alpha: FloatArray, stretch: IntArray, *, is_logarithmic: bool) -> FloatArray:
    """Divide each α by the mean of all α of the same stretch, [N]."""
    # The mean of the same kind as that over neighbours, [U]: arithmetic, or geometric as the mean
    # of logarithms.
    values = np.log(alpha) if is_logarithmic else alpha
    mean = np.bincount(stretch, values) / np.maximum(np.bincount(stretch), 1)
    relative: FloatArray = (
        np.exp(values - mean[stretch]) if is_logarithmic else values / mean[stretch]
    )
    return relative
