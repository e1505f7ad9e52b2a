"""Choice of the hyperparameters of PROBE (PROBE IV-B).

K is chosen by cross-validation over blocks of time, γ by the error of the training drives.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from probevo.arrays import BoolArray, FloatArray, IntArray, evenly
from probevo.estimation.two_frame import TwoFrameEstimator
from probevo.noise.probe.nearest_neighbors import MAX_BETA
from probevo.noise.probe.neighbor_index import NeighborIndex
from probevo.training.probe.subsets import Stream, SubsetSampler
from probevo.training.supervision import MIN_ALPHA_M, from_step_to_step

NEIGHBORS = (10, 25, 50, 100, 200, 400, 800)
"""Candidates for K."""
EXPONENTS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0, 24.0, 32.0)
"""Candidates for γ."""
MAX_QUERIES = 20_000
"""Samples of all drives together on which values of K are compared; more would not change which is
best."""
MAX_LOG_WEIGHT = np.log(MAX_BETA)
MIN_ERRORS = 10
"""Minimum number of errors for a standard error of their mean: with ten, the mean is off by more
than its standard error in 34 % of cases, with infinitely many in 32 %, with three in 42 %."""


@dataclass(frozen=True)
class Search:
    """Candidates for a hyperparameter, the error of each, and the one that was chosen."""

    candidates: tuple[float, ...]
    errors: tuple[float, ...]
    chosen: float

    def as_dict(self) -> dict[str, Any]:
        """Return the search in plain values."""
        return {
            "candidates": list(self.candidates),
            "errors": list(self.errors),
            "chosen": self.chosen,
        }


def choose_neighbors(coordinates: FloatArray, values: FloatArray, fold: IntArray) -> Search:
    """Choose K by cross-validation: the mean of the K nearest from other folds predicts best.

    Args:
        coordinates: points of N samples, [N, M].
        values: α of each, or its logarithm, [N].
        fold: fold of each, [N].
    """
    # No candidate may exceed the samples that any cross-validation step has.
    folds = np.unique(fold)
    fewest = min(int((fold != k).sum()) for k in folds)
    candidates = np.array([k for k in NEIGHBORS if k <= fewest] or [max(1, fewest)])

    # Sum the squared error of each candidate, predicting each fold from the others.
    queries = evenly(len(values), MAX_QUERIES)
    squared_error = np.zeros(len(candidates))
    for k in folds:
        is_other = fold != k
        queries_in_fold = queries[fold[queries] == k]
        if is_other.any() and len(queries_in_fold):
            index = NeighborIndex.build(coordinates[is_other], values[is_other])
            means = index.mean_of_nearest(coordinates[queries_in_fold], candidates)
            squared_error += np.sum((means - values[queries_in_fold, None]) ** 2, axis=0)
    errors = squared_error / max(len(queries), 1)
    return Search(
        candidates=_plain(candidates),
        errors=_plain(errors),
        chosen=float(candidates[np.argmin(errors)]),
    )


def out_of_fold(
    coordinates: FloatArray,
    values: FloatArray,
    fold: IntArray,
    *,
    neighbors: int,
    queries: FloatArray,
    fold_of_query: IntArray,
) -> FloatArray:
    """Predict the value at each query from the K nearest samples of other folds, [n].

    Args:
        coordinates: points of N samples, [N, M].
        values: value of each sample, [N].
        fold: fold of each sample, [N].
        neighbors: K.
        queries: points at which to predict, [n, M].
        fold_of_query: fold of each query, whose samples are left out, [n].
    """
    means = np.empty(len(queries))
    for k in np.unique(fold_of_query):
        is_other = fold != k
        index = NeighborIndex.build(coordinates[is_other], values[is_other])
        is_in_fold = fold_of_query == k
        num_neighbors = min(neighbors, int(is_other.sum()))
        nearest = index.mean_of_nearest(queries[is_in_fold], np.array([num_neighbors]))
        means[is_in_fold] = nearest[:, 0]
    return means


def choose_exponent(
    samplers: Sequence[SubsetSampler], log_relative_alphas: Sequence[FloatArray]
) -> Search:
    """Choose the least γ whose mean α over the drives is within a standard error of the best.

    Where a drive has no known error, or a single one, as a closed loop has, the disagreement
    between the motions of two random halves of its features counts instead, step by step: one loop
    that by chance closes better must not decide. So it is for all drives if these have fewer than
    ``MIN_ERRORS`` together. With fewer steps than that as well, γ is the least candidate.

    Args:
        samplers: one for each drive.
        log_relative_alphas: ln(mean of the K nearest α / ᾱ) of every feature of each drive, [n]
            each, learned from other folds than the feature's own.
    """
    has_errors = sum(map(_num_errors, samplers)) >= MIN_ERRORS
    # α of every stretch or step of all drives, for each candidate: [candidates, n].
    rows = []
    for gamma in EXPONENTS:
        alphas_of_drives = []
        for sampler, log_alpha in zip(samplers, log_relative_alphas, strict=True):
            # β = (ᾱ_K/ᾱ)^γ, bounded as in the model
            beta = np.exp(np.clip(gamma * log_alpha, -MAX_LOG_WEIGHT, MAX_LOG_WEIGHT))
            compares_halves = not (has_errors and _num_errors(sampler))
            alphas_of_drives.append(_alphas(sampler, beta, compares_halves=compares_halves))
        rows.append(np.concatenate(alphas_of_drives))
    alphas = np.array(rows)

    # Where no half of a step can be solved, both keep the same motion: this says nothing of γ.
    is_solved = (alphas > MIN_ALPHA_M).all(axis=0)
    if is_solved.any():
        alphas = alphas[:, is_solved]

    # The one-standard-error rule. Differences from the best γ are taken pair by pair: how hard a
    # stretch is affects all candidates alike. The first index that passes is the least γ.
    errors = alphas.mean(axis=1)
    excess = alphas - alphas[np.argmin(errors)]
    chosen = 0
    count = alphas.shape[1]
    if count >= MIN_ERRORS:
        standard_error = excess.std(axis=1, ddof=1) / np.sqrt(count)
        chosen = int(np.argmax(excess.mean(axis=1) <= standard_error))
    return Search(candidates=EXPONENTS, errors=_plain(errors), chosen=EXPONENTS[chosen])


def _num_errors(sampler: SubsetSampler) -> int:
    """Return the number of known errors of a drive that γ may be chosen by.

    A single one does not count: see ``choose_exponent``.
    """
    supervision = sampler.supervision
    count = len(supervision.stretches)
    return count if supervision.kind != "none" and count > 1 else 0


def _alphas(sampler: SubsetSampler, beta: FloatArray, *, compares_halves: bool) -> FloatArray:
    """Return the errors α of a drive that is solved with these β, [n].

    There is one a stretch, or one a step where two halves of the features are compared.
    """
    used = sampler.drive.used
    if not compares_halves:
        return sampler.supervision.errors(weighted_motions(sampler, beta, used))
    # Compare two random halves, the same for all candidates.
    rng = np.random.default_rng([*sampler.seed, Stream.HALVES])
    half = rng.random(len(beta)) < 0.5
    first_half = weighted_motions(sampler, beta, used & half)
    second_half = weighted_motions(sampler, beta, used & ~half)
    return from_step_to_step(second_half).errors(first_half)


def weighted_motions(sampler: SubsetSampler, beta: FloatArray, used: BoolArray) -> FloatArray:
    """Solve all steps with the noise of the features scaled by β.

    Args:
        sampler: the drive of K − 1 steps and n features.
        beta: factor of the noise of each feature, [n].
        used: which features to solve with, [n].

    Returns:
        T_curr_prev of each step, [K − 1, 4, 4]; a step with too few features, or whose features fix
        no motion, keeps its own.
    """
    drive = sampler.drive
    motions = drive.T_curr_prev.copy()
    estimator = TwoFrameEstimator(sampler.camera, sampler.solver)
    for step in range(len(motions)):
        rows = drive.rows(step)
        chosen = np.flatnonzero(used[rows])
        if len(chosen) < sampler.solver.min_tracks:
            continue
        # The covariance of each feature is the static model's times β.
        base = sampler.base.predict(np.zeros((len(chosen), 0)))
        solution = estimator.solve(
            drive.tracks(step).subset(chosen),
            base.scaled(beta[rows][chosen]),
            guess=drive.T_curr_prev[step],
        )
        # Converged or not: weights that keep a solve from converging are bad ones, and would seem
        # harmless if the step kept the motion of equal weights.
        if np.isfinite(solution.cov).all():
            motions[step] = solution.T_curr_prev
    return motions


def _plain(values: FloatArray | IntArray) -> tuple[float, ...]:
    """Return the values as Python floats."""
    return tuple(float(value) for value in values)
